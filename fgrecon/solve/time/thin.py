"""Which frames a window keeps: few that are spread over seconds tell as much as many.

Frames that follow each other closely err alike; past what stands a wide base line measures how far away it is.
"""

from __future__ import annotations

from collections.abc import Sequence

from fgrecon.solve.time.window import Frame

__all__ = ["thinned"]

_SPAN = 4.0  # seconds: older frames leave, but for the last two


def thinned(frames: Sequence[Frame], most: int) -> list[Frame]:
    """The frames that a window goes on from.

    Motion and evidence of a frame that leaves pass on to the one after it. Where the camera's motion is known between
    some of them only, the oldest leaves, since what is known would be lost in a step of both kinds.

    Args:
        frames: Those of the window, in order.
        most: How many to keep at most.
    """
    now = frames[-1].time
    kept = [frame for frame in frames[:-2] if now - frame.time <= _SPAN]
    kept += frames[-2:]
    while len(kept) > most:
        times = [frame.time for frame in kept]
        inner = range(1, len(times) - 1)
        if not inner or len({frame.known for frame in kept[1:]}) > 1:
            kept.pop(0)
            continue
        nearest = min(inner, key=lambda i: times[i + 1] - times[i - 1])
        kept[nearest : nearest + 2] = [kept[nearest + 1].without(kept[nearest])]
    return kept
