"""Planes n'X + d = 0 of the object frame: how they are perturbed and initialised.

A plane is a `gtsam.OrientedPlane3`, whose normal has unit length by construction. Its local coordinates are two along
the tangent basis B of the normal and one for d, so that dn = B (xi_0, xi_1) and dd = xi_2 at the linearisation point.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.checks import finite_array, unit_vector
from factors.errors import DegenerateProblemError

_FLATTEST = 1e-6


def make_plane(normal: ArrayLike, d: float) -> gtsam.OrientedPlane3:
    """The plane n'X + d = 0 of a normal of any length; d is scaled with it (GTSAM's constructor scales n alone).

    Raises:
        InvalidInputError: The normal has no length, or a number is not finite.
    """
    vector = finite_array("normal", normal, (3,))
    unit = unit_vector("normal", vector)
    return gtsam.OrientedPlane3(np.append(unit, finite_array("d", d, ()) / np.linalg.norm(vector)))


def fit_plane(points: ArrayLike) -> gtsam.OrientedPlane3:
    """The plane closest to points (M, 3) in the least-squares sense.

    Its normal's largest component is positive, so that the same points give the same sign on every machine.

    Raises:
        InvalidInputError: There are fewer than three points, or one is not finite.
        DegenerateProblemError: The points lie on one line.
    """
    array = finite_array("points", points, (None, 3))
    centre = array.mean(axis=0) if len(array) else np.zeros(3)
    spread, axes = np.linalg.svd(array - centre)[1:] if len(array) >= 3 else (np.zeros(3), np.eye(3))
    if spread[1] <= _FLATTEST * max(float(spread[0]), 1e-12):
        raise DegenerateProblemError("points", f"{len(array)} points on one line", "Give three that span a plane.")
    normal = axes[2] * np.sign(axes[2, np.argmax(np.abs(axes[2]))])
    return gtsam.OrientedPlane3(np.append(normal, -normal @ centre))
