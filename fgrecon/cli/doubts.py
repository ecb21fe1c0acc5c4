"""Warnings about keypoints that are surely not what they are taken for.

Such a file is solved nevertheless, since each of these can be right in an odd case; but the status of a result alone
does not tell what to look for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.reconstruct_work import Outcome, Task
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation

__all__ = ["about_fits", "about_keypoints"]

_UNITS = "All keypoints of {} lie between 0 and 1, as parts of an image do. Give pixels."
_BESIDE = "Most keypoints of {} lie beside the 2D box. Are u and v swapped, or is the box not x1, y1, x2, y2?"
_BEYOND = "Most keypoints of {} lie far outside of the image. Are u and v swapped, or is it another image?"
_POOR = "Hardly a keypoint of {} fits. Is their order the category's, and are left and right the vehicle's own?"

_NAMED = 3  # vehicles that a warning names
_WIDER = 0.25  # of a box's longer side: so far beside it are keypoints still its vehicle's
_FARTHER = 0.5  # of an image's size: so far beyond its edges may those be of a vehicle that they cut off
_EDGE = 0.02  # of an image's size: so near its edge ends the box of a vehicle that it cuts off
_ENOUGH = 6  # keypoints from which on something can be said of their fit
_FIT = 0.5  # weight from which one fits
_FEW = 0.25  # of a vehicle's keypoints

_Array = NDArray[np.float64]


def about_keypoints(tasks: Sequence[Task]) -> list[str]:
    """What to warn of before vehicles are solved: keypoints in other units, or not where the vehicle is."""
    found: dict[str, list[str]] = {_UNITS: [], _BESIDE: [], _BEYOND: []}
    for task in tasks:
        if (what := _doubt(task)) is not None:
            found[what].append(task.instance.name)
    return [line for what, names in found.items() for line in _told(names, what)]


def about_fits(outcomes: Sequence[Outcome]) -> list[str]:
    """What to warn of once they are solved: in most of the vehicles hardly a keypoint fits."""
    judged, poor = 0, []
    for outcome in outcomes:
        seen = _seen(outcome.task)
        if outcome.result is None or seen is None or np.count_nonzero(_certain(seen)) < _ENOUGH:
            continue
        judged += 1
        if np.mean(outcome.result.weights[_certain(seen)] >= _FIT) < _FEW:
            poor.append(outcome.name)
    return _told(poor, _POOR) if 2 * len(poor) > judged else []


def _told(names: Sequence[str], what: str) -> list[str]:
    if not names:
        return []
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return [what.format(f"{', '.join(names[:_NAMED])}{more}")]


def _doubt(task: Task) -> str | None:
    """What must be wrong with a vehicle's keypoints, if anything."""
    seen, camera = _seen(task), task.camera
    if seen is None or not seen.measured.any():
        return None
    every = seen.keypoints[seen.measured]
    if (camera.matrix[:2, 2] > 1.0).any() and ((every >= 0.0) & (every <= 1.0)).all():
        return _UNITS
    points = seen.keypoints[_certain(seen)]
    size = None if camera.image_size is None else np.array(camera.image_size, dtype=np.float64)
    if seen.box is not None:
        wider = _WIDER * seen.extent
        beside = _outside(points, seen.box[:2] - wider, seen.box[2:] + wider)
        if size is not None and _at_edge(seen.box, size):  # the vehicle goes on outside of the image
            beside &= ~_outside(points, np.zeros(2), size)
        if np.mean(beside) > 0.5:
            return _BESIDE
    if size is not None and np.mean(_outside(points, -_FARTHER * size, (1.0 + _FARTHER) * size)) > 0.5:
        return _BEYOND
    return None


def _at_edge(box: _Array, size: _Array) -> bool:
    """Whether a box reaches an edge of its image."""
    margin = _EDGE * size
    return bool((box[:2] < margin).any() or (box[2:] > size - margin).any())


def _seen(task: Task) -> Observation | None:
    """What was observed; None where its numbers cannot be used, which the solver says."""
    try:
        return task.instance.observation
    except FgreconError:
        return None


def _certain(seen: Observation) -> NDArray[np.bool_]:
    """(K,) the keypoints that are as likely right as wrong, or likelier; all that are measured where none is."""
    certain: NDArray[np.bool_] = seen.measured & (seen.confidence >= seen.confidence_midpoint)
    return certain if certain.any() else seen.measured


def _outside(points: _Array, least: _Array, most: _Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 2) lie outside of a rectangle."""
    outside: NDArray[np.bool_] = np.any((points < least) | (points > most), axis=1)
    return outside
