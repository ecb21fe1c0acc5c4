"""Which way the vehicles of a video face by one another: each with all that it knows of itself, by all of its frames.

    frames of a vehicle ---- its own belief ---- alike? ---- belief of another ---- its frames

That two vehicles stand in one row is said once, not in each frame again: it is no frame's evidence. In a frame it is
what the others know by then, and goes on to no later frame; of a whole past it is the mean over its frames.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.detection import half_around
from fgrecon.core.heading_coupling import heading_odds, mean_field
from fgrecon.solve.time.frame import Frame
from fgrecon.solve.time.heading_filter import HEADINGS, Belief
from fgrecon.solve.time.smooth import beliefs, pieces
from fgrecon.solve.time.time_settings import SETTINGS

Array = NDArray[np.float64]


def neighbour_evidence(frames: Sequence[Frame], own: Sequence[Belief]) -> list[Array]:
    """(B,) logarithms of what the others say of the heading of each; those without directions say and hear nothing.

    Args:
        frames: Of several vehicles, at one time.
        own: What each believes by itself.
    """
    says = [np.zeros(len(HEADINGS)) for _ in frames]
    directed = [i for i, frame in enumerate(frames) if frame.problem.observation.azimuth is not None]
    if len(directed) < 2:
        return says
    headings = np.array([own[i].heading for i in directed])
    right = np.array([own[i].facing(heading) for i, heading in zip(directed, headings, strict=True)])
    least = SETTINGS.belief_error_probability
    right = np.clip(right, least, 1.0 - least)
    places = np.array([frames[i].pose.translation() for i in directed])
    between = SETTINGS.neighbour_share * heading_odds(headings, places, SETTINGS.neighbour_distance_m)
    odds = 2.0 * between @ mean_field(np.log(right / (1.0 - right)), between)
    for i, heading, one in zip(directed, headings, odds, strict=True):
        says[i] = one * half_around(heading, len(HEADINGS))
    return says


def beliefs_with_neighbours(pasts: Mapping[int, Sequence[Frame]]) -> dict[int, list[Frame]]:
    """The pasts of several vehicles, with beliefs that know of one another.

    Args:
        pasts: The frames of each, in order, with beliefs by those before.
    """
    names, parts = [], []
    for name, past in pasts.items():
        for piece in pieces([replace(frame, neighbours=np.zeros(len(HEADINGS))) for frame in past]):
            names.append(name)
            parts.append([*piece])
    together: dict[float, list[tuple[int, int, Belief]]] = defaultdict(list)
    for number, part in enumerate(parts):
        for index, (frame, own) in enumerate(zip(part, beliefs(part), strict=True)):
            together[frame.time].append((number, index, own))
    for at_once in together.values():
        says = neighbour_evidence([parts[n][i] for n, i, _ in at_once], [own for _, _, own in at_once])
        for (number, index, _), said in zip(at_once, says, strict=True):
            frame, share = parts[number][index], said / len(parts[number])
            evidence, belief = frame.evidence + share, frame.belief.updated(share)
            parts[number][index] = replace(frame, evidence=evidence, belief=belief)
    found: dict[int, list[Frame]] = {name: [] for name in pasts}
    for name, part in zip(names, parts, strict=True):
        for index in range(1, len(part)):  # the first has its belief; the others follow it once more
            part[index] = part[index].following(part[index - 1])
        found[name] += part
    return found
