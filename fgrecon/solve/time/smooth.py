"""Smoothing of a vehicle's past: the heading of every frame by all of them, and one graph for a stretch of frames.

Long pasts are solved stretch by stretch; they overlap, and of an overlap each gives the half that is further inside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from fgrecon.core.category import MotionModel
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.time.frame import Frame
from fgrecon.solve.time.heading_choice import choose_headings
from fgrecon.solve.time.time_settings import SETTINGS
from fgrecon.solve.time.window import MotionFactors, WindowSolve, solve_single, solve_window

Smoothed = tuple[WindowSolve, Sequence[Frame], range]
"""A stretch: what was solved, its frames, and those of them that it gives, by index."""


def smooth(
    past: Sequence[Frame], shape: ShapeValues, model: MotionModel, extra: MotionFactors | None = None
) -> Iterator[Smoothed]:
    """Solve all frames of a vehicle.

    Args:
        past: The frames, in order, each with a belief by those before. Those without a step begin anew.
        shape: Where the shape begins.
        model: How such vehicles move.
        extra: Makes factors of the caller's own for each step; or None.
    """
    for piece in _pieces(past):
        whole = replace(piece[-1], belief=piece[-1].heading.whole)
        frames = choose_headings([*piece[:-1], whole], shape)
        if len(frames) == 1:
            yield _by_itself(frames[0])
            continue
        for low, high, first, last in _stretches(len(frames)):
            some = frames[low:high]
            solved = solve_window(some, shape, model, extra=extra)
            if solved.failed:
                yield from map(_by_itself, some[first - low : last - low])
                continue
            yield solved, solved.moved(some), range(first - low, last - low)


def _pieces(past: Sequence[Frame]) -> list[Sequence[Frame]]:
    """The frames of a vehicle, parted where one begins anew."""
    begins = [i for i, frame in enumerate(past) if i == 0 or frame.step is None]
    return [past[begin:end] for begin, end in zip(begins, [*begins[1:], len(past)], strict=True)]


def _by_itself(frame: Frame) -> Smoothed:
    return solve_single(frame.problem, frame.start, frame.number), [frame], range(1)


def _stretches(count: int) -> Iterator[tuple[int, int, int, int]]:
    """Beginning and end of each stretch, and of the part that it gives."""
    stretch, overlap = SETTINGS.stretch_frames, SETTINGS.overlap_frames
    if count <= stretch + overlap:
        yield 0, count, 0, count
        return
    first = 0
    for low in range(0, count - overlap, stretch - overlap):
        high = min(low + stretch, count)
        last = count if high == count else high - overlap // 2
        yield low, high, first, last
        if high == count:
            return
        first = last
