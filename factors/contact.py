"""Ground contact: a vehicle stands on the plane G(t), a variable that the vehicles of an image share.

The plane normal . x = distance is given by its difference (h, a, b) from a nominal one n0 . x = d0:

    normal = (n0 + a e1 + b e2) / |...|,    distance = d0 + h

with e1 and e2 across n0: e1 along the optical axis as far as that goes, so that a is the camera's pitch against the
road to first order and b its roll (radians), h metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.checks import finite_array, unit_vector
from factors.ground import ground_rows
from factors.guard import CompiledRows, Evaluation, guarded_factor
from factors.native import native
from factors.noise import Noise


@dataclass(frozen=True)
class GroundFrame:
    """The nominal plane, and the directions in which it may turn.

    Attributes:
        normal: (3,) unit normal n0 in the camera frame, pointing down.
        distance: Height d0 of the camera above it, metres.
        across: (2, 3) e1 and e2.
    """

    normal: Array
    distance: float
    across: Array
    _last: list[tuple[bytes, tuple[Array, Array]]] = field(default_factory=list, repr=False, compare=False)

    @classmethod
    def of(cls, normal: ArrayLike, distance: float) -> GroundFrame:
        """The frame of a plane.

        Raises:
            InvalidInputError: The normal has no length or a number is not finite.
        """
        n = unit_vector("normal", normal)
        forward = np.array([0.0, 0.0, 1.0]) - n[2] * n
        if np.linalg.norm(forward) < 1e-6:  # looking straight down: any two directions will do
            forward = np.array([0.0, 1.0, 0.0]) - n[1] * n
        e1 = forward / np.linalg.norm(forward)
        return cls(n, float(finite_array("distance", distance, ())), np.stack([e1, np.cross(n, e1)]))

    def lifted(self, metres: float) -> GroundFrame:
        """That of a plane so much nearer to the camera."""
        return replace(self, distance=self.distance - metres, _last=[]) if metres else self

    def plane(self, change: Array) -> tuple[Array, float]:
        """Normal (3,) and distance of the plane at a change (3,): h, a, b."""
        return self.tilted(change)[0], self.distance + float(change[0])

    def tilted(self, change: Array) -> tuple[Array, Array]:
        """Normal (3,) at a change (3,), and its derivative (3, 2) by a and b; the last one is remembered.

        All vehicles of an image ask for the same.
        """
        stamp = change.tobytes()
        for known, tilted in self._last:
            if known == stamp:
                return tilted
        normal = self.normal + change[1:].dot(self.across)
        length = math.sqrt(normal.dot(normal))
        normal /= length
        across = self.across.T / length
        tilted = normal, across - normal[:, None] * normal.dot(across)
        self._last[:] = [(stamp, tilted)]
        return tilted


def contact_factor(pose_key: int, ground_key: int, frame: GroundFrame, noise: Noise) -> gtsam.CustomFactor:
    """The object's origin lies on the ground and its down axis is the ground's normal: 4 rows, metres and radians.

    Args:
        pose_key: Key of camera_T_object.
        ground_key: Key of the plane's change (3,).
        frame: The nominal plane.
        noise: Noise model of dimension 4: height, lean.

    Raises:
        InvalidInputError: The noise model has another dimension.
    """
    keys, kernel, compiled = (pose_key, ground_key), native("factors._rows"), None
    if kernel is not None:
        compiled = CompiledRows(kernel.Contact(frame.normal, frame.distance, frame.across), keys)
    return guarded_factor("contact", noise, keys, (6, 3), 4, _Contact(*keys, frame), compiled=compiled)


@dataclass(frozen=True, slots=True)
class _Contact:
    pose_key: int
    ground_key: int
    frame: GroundFrame

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        pose, change = values.atPose3(self.pose_key).matrix(), values.atVector(self.ground_key)
        normal, by_ab = self.frame.tilted(change)
        rotation, place = pose[:3, :3], pose[:3, 3]
        residual, by_turn = ground_rows(normal, self.frame.distance, rotation, place)
        residual[0] -= change[0]
        if not want_jacobian:
            return residual, None
        jacobian = np.zeros((4, 9))
        jacobian[:, :3] = by_turn
        jacobian[0, 3:6] = normal.dot(rotation)
        jacobian[0, 6] = -1.0
        jacobian[0, 7:] = place.dot(by_ab)
        jacobian[1:, 7:] = -by_ab
        return residual, jacobian
