"""Agreement between the 2D boxes of images and their vehicles: boxes of another source than the options say stand out.

A box that is wrong by itself loses its weight in the solve. Boxes that are all wrong alike (loose ones, of what is
visible alone, of the image at another size) pull every vehicle nearer or further away, which no single one tells.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.geometry import transform
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import STATUS

_ERROR = 1.86  # standard error of a median times the root of the count, over the median absolute deviation


def box_excess(problem: Problem, camera_T_object: Array, coefficients: Array, camera: Camera) -> float:
    """By how much a box is larger than its vehicle looks, as a fraction; NaN where it is not wholly in the image.

    Args:
        problem: What was solved.
        camera_T_object: (4, 4) the vehicle's pose.
        coefficients: (N,) its shape.
        camera: The camera that took the image.
    """
    box = problem.energy.box
    if box is None or not box.rows.used.all():
        return float("nan")
    points = transform(camera_T_object, problem.model.box_points(problem.options.box.model).at(coefficients))
    if not points[:, 2].min() > MIN_DEPTH:
        return float("nan")
    projected = points @ camera.matrix.T
    sides: Array = np.ptp(projected[:, :2] / projected[:, 2:], axis=0)
    return float(np.mean((box.rows.edges[2:] - box.rows.edges[:2]) / sides) - 1.0)


def boxes_off(vehicles: Iterable[float]) -> float | None:
    """By how much the boxes of several vehicles are larger than these look: `box_excess` of each.

    Returns:
        The median over those that tell, or None where it is as usual or they are too few.
    """
    known = [excess for excess in vehicles if math.isfinite(excess)]
    if len(known) < STATUS.box_vehicles:
        return None
    middle = float(np.median(known))
    error = _ERROR * float(np.median(np.abs(np.array(known) - middle))) / len(known) ** 0.5
    return middle if abs(middle) > max(STATUS.box_excess, STATUS.box_excess_sigmas * error) else None


def boxes_warning(off: float) -> str:
    """The same in a sentence."""
    return (
        f"The boxes are {100 * abs(off):.0f} % {'larger' if off > 0.0 else 'smaller'} than their vehicles look: "
        "check what they enclose (the box model), and that they are of these images."
    )
