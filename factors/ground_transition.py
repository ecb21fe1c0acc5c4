"""Ground plane from one image to the next: kept, and carried along with the camera's motion.

    G(t) ---- same ground (3) ---- G(t')

The change G(t') of the plane from its nominal one (`factors.contact`) should be

    kept * carried(G(t))

`carried` is the same plane in the camera frame of then: with the camera's motion (R, p) = camera_now_T_camera_next the
plane n . x = d becomes R' n . x = d - n . p. Where the motion is not known it is G(t) itself: the camera goes along the
road. `kept`, below one, draws the plane back to the nominal one.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from factors.arrays import Array
from factors.checks import finite_array
from factors.contact import GroundFrame
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.noise import Noise


def ground_transition_factor(
    ground_key: int,
    next_key: int,
    frames: tuple[GroundFrame, GroundFrame],
    noise: Noise,
    camera_motion: gtsam.Pose3 | None = None,
    kept: float = 1.0,
) -> gtsam.CustomFactor:
    """The next image's plane is this one's: 3 rows, metres and radians.

    Args:
        ground_key: Key of the plane's change (3,) now.
        next_key: Key of its change in the next image.
        frames: The nominal planes of both.
        noise: Noise model of dimension 3.
        camera_motion: camera_now_T_camera_next; None where it is not known.
        kept: Share of the change that stays, above 0 and at most 1.

    Raises:
        InvalidInputError: The share is out of its range, or the noise model has another dimension.
    """
    share = float(finite_array("ground_transition.kept", kept, ()))
    if not 0.0 < share <= 1.0:
        raise InvalidInputError("ground_transition.kept", kept, "Give a share above 0 and at most 1.")
    motion = None if camera_motion is None else (camera_motion.rotation().matrix(), camera_motion.translation())
    callback = _Transition(ground_key, next_key, frames, motion, share)
    return guarded_factor("ground_transition", noise, (ground_key, next_key), (3, 3), 3, callback)


@dataclass(frozen=True, slots=True)
class _Transition:
    ground_key: int
    next_key: int
    frames: tuple[GroundFrame, GroundFrame]
    motion: tuple[Array, Array] | None
    kept: float

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        change = values.atVector(self.ground_key)
        carried, by_change = (change, np.eye(3)) if self.motion is None else self._carried(change, *self.motion)
        residual = values.atVector(self.next_key) - self.kept * carried
        return residual, np.hstack([-self.kept * by_change, np.eye(3)]) if want_jacobian else None

    def _carried(self, change: Array, rotation: Array, way: Array) -> tuple[Array, Array]:
        """The plane's change in the next camera's frame, and its derivative."""
        now, then = self.frames
        normal, by_ab = now.tilted(change)
        distance = now.distance + float(change[0])
        turned, turned_by_ab = rotation.T @ normal, rotation.T @ by_ab
        ahead = float(then.normal @ turned)
        sideways = then.across @ turned / ahead
        carried = np.array([distance - normal @ way - then.distance, *sideways])
        jacobian = np.zeros((3, 3))
        jacobian[0, 0] = 1.0
        jacobian[0, 1:] = -way @ by_ab
        jacobian[1:, 1:] = (then.across @ turned_by_ab - np.outer(sideways, then.normal @ turned_by_ab)) / ahead
        return carried, jacobian
