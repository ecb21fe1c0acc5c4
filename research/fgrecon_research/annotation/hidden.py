"""Which keypoints of a vehicle other vehicles hide, by rays against the surfaces in their 3D boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import Box3D, box_corners
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.solve.vehicle.model import prepare
from fgrecon.solve.vehicle.visibility import clearance, occluder

Array = NDArray[np.float64]

_TRIANGLES = np.array(
    [
        *([0, 3, 1], [0, 2, 3], [4, 7, 6], [4, 5, 7], [0, 5, 4], [0, 1, 5]),
        *([2, 7, 3], [2, 6, 7], [0, 6, 2], [0, 4, 6], [1, 7, 5], [1, 3, 7]),
    ]
)
"""Of a cuboid whose corners are in the order of `box_corners`, counter-clockwise as seen from outside."""
_SHARE = 0.03  # of a vehicle's own size that is known of each dimension


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface in the camera's frame."""

    vertices: Array  # (V, 3) metres
    faces: NDArray[np.integer]  # (F, 3) triangles, counter-clockwise as seen from outside


def solid_of(box: Box3D, prior: ShapePrior | None) -> Solid:
    """What fills a 3D box: the prior's vehicle of its size, or the box itself without a prior.

    Raises:
        InvalidInputError: The box has no size.
    """
    if box.size is None:
        raise InvalidInputError("box.size", None, "Give the box's length, width and height.")
    if prior is None:
        vertices, faces = box_corners(box.size), _TRIANGLES
    else:
        size = np.round(box.size, 2)  # a vehicle's images share what is prepared for it
        model = prepare(prior, SizePrior("of the box", size, _SHARE * size))
        surface = occluder(model.prior)
        vertices, faces = surface.mean, surface.faces
    return Solid(vertices @ yaw_rotation(box.rotation_y).T + box.location, faces)


def hidden_behind(points: Array, solids: Sequence[Solid]) -> NDArray[np.bool_]:
    """(K,) which points (K, 3) in the camera's frame lie behind one of the solids."""
    hidden = np.zeros(len(points), dtype=bool)
    for solid in solids:
        if solid.vertices[:, 2].max() > 0.0:
            hidden |= clearance(solid.vertices, solid.faces, points, np.zeros(3)) > 0.0
    return hidden
