"""Which way the vehicles of a video face by one another: each with all that it knows of itself, by all of its frames.

    frames of a vehicle ---- its own belief ---- alike? ---- belief of another ---- its frames

That two vehicles stand in one row is said once, not in each frame again: it is no frame's evidence. In a frame it is
what the others know by then, and goes on to no later frame; of a whole past it is the mean over its frames.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.detection import half_around
from fgrecon.core.rows import leanings, ties
from fgrecon.solve.time.heading import HEADINGS, Belief
from fgrecon.solve.time.smooth import beliefs, pieces
from fgrecon.solve.time.window import Frame

__all__ = ["neighbours_say", "with_neighbours"]

Array = NDArray[np.float64]

_COUNTS, _NEAR = 0.5, 30.0
"""Share of what two vehicles say of one another that counts, since a row's say much the same; metres up to which."""
_LEAST = 1e-6  # probability that a belief is wrong


def neighbours_say(frames: Sequence[Frame], own: Sequence[Belief]) -> list[Array]:
    """(B,) logarithms of what the others say of the heading of each; those without directions say and hear nothing.

    Args:
        frames: Of several vehicles, at one time.
        own: What each believes by itself.
    """
    says = [np.zeros(len(HEADINGS)) for _ in frames]
    told = [i for i, frame in enumerate(frames) if _directed(frame)]
    if len(told) < 2:
        return says
    headings = np.array([own[i].heading for i in told])
    right = np.array([own[i].facing(heading) for i, heading in zip(told, headings, strict=True)])
    right = np.clip(right, _LEAST, 1.0 - _LEAST)
    places = np.array([frames[i].pose.translation() for i in told])
    between = _COUNTS * ties(headings, places, _NEAR)
    odds = 2.0 * between @ leanings(np.log(right / (1.0 - right)), between)
    for i, heading, one in zip(told, headings, odds, strict=True):
        says[i] = one * half_around(heading, len(HEADINGS))
    return says


def with_neighbours(pasts: Mapping[int, Sequence[Frame]]) -> dict[int, list[Frame]]:
    """The pasts of several vehicles, with beliefs that know of one another.

    Args:
        pasts: The frames of each, in order, with beliefs by those before; they stay as they are.
    """
    found = {name: [replace(f, neighbours=np.zeros(len(HEADINGS))) for f in past] for name, past in pasts.items()}
    parts = [piece for frames in found.values() for piece in pieces(frames)]
    together: dict[float, list[tuple[Frame, Belief, int]]] = defaultdict(list)
    for piece in parts:
        for frame, own in zip(piece, beliefs(piece), strict=True):
            together[frame.time].append((frame, own, len(piece)))
    for at_once in together.values():
        says = neighbours_say([frame for frame, _, _ in at_once], [own for _, own, _ in at_once])
        for (frame, _, count), said in zip(at_once, says, strict=True):
            frame.evidence = frame.evidence + said / count
            frame.belief = frame.belief.told(said / count)
    for piece in parts:  # the first has its belief; the others follow it once more
        for before, frame in pairwise(piece):
            frame.believe(before)
    return found


def _directed(frame: Frame) -> bool:
    problem = frame.problem
    return problem.observation.azimuth is not None
