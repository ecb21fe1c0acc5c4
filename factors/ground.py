"""The ground plane as evidence about the pose: height of the origin, and uprightness.

The ground is the plane normal . x = distance of the camera frame, its normal pointing down; the object's origin is on
it and its y axis points into it. Not in the paper, whose poses come from boxes.

    r = (normal . t - distance) / sigma(t_z),    r = (R e_y - normal) / tilt_sigma

The chord between two unit vectors at an angle a is 2 sin(a / 2) long: the lean in radians where it is small. To first
order it equals the two coordinates in the tangent plane of the normal; but those vanish again for a vehicle upside
down, where the chord is longest, and the chord is smooth everywhere. The rows of a factor
(`factors.observation_rows`), and for many poses at once those of the search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.arrays import Array


@dataclass(frozen=True)
class GroundRows:
    """The ground plane: unit normal (3,), distance of the camera in metres, standard deviation of the lean, radians."""

    normal: Array
    distance: float
    tilt_sigma: float

    def whitened(self, rotation: Array, translation: Array, height_sigma: float | Array) -> tuple[Array, Array, Array]:
        """Whitened rows.

        Args:
            rotation: (..., 3, 3) of camera_T_object.
            translation: (..., 3) of camera_T_object, metres.
            height_sigma: (...,) standard deviation of the origin's height over the plane, metres.

        Returns:
            (..., 4) residual, (..., 4, 3) its derivative by a turn about the object's axes, and (..., 3) that of its
            first row by a shift along the camera's axes.
        """
        residual, by_turn = ground_rows(self.normal, self.distance, rotation, translation)
        sigma = np.full(residual.shape, self.tilt_sigma)
        sigma[..., 0] = height_sigma
        return residual / sigma, by_turn / sigma[..., None], self.normal / sigma[..., :1]

    def energy(self, rotation: Array, translation: Array, height_sigma: float) -> float:
        """Half the squared rows of one pose, nats."""
        rows, _ = ground_rows(self.normal, self.distance, rotation, translation)
        lean = rows[1:] / self.tilt_sigma
        return 0.5 * float((rows[0] / height_sigma) ** 2 + lean @ lean)


def ground_rows(normal: Array, distance: float, rotation: Array, translation: Array) -> tuple[Array, Array]:
    """Height and lean over the ground, for any number of poses.

    Args:
        normal: (3,) unit normal of the ground in the camera frame.
        distance: Height of the camera, metres.
        rotation: (..., 3, 3) of camera_T_object.
        translation: (..., 3) of camera_T_object, metres.

    Returns:
        (..., 4) residual: height in metres, lean; and (..., 4, 3) its derivative by a turn about the object's axes:
        d(R exp(w) e_y) = R (w x e_y) = R (-w_z, 0, w_x). By the translation that of the height is the normal, that of
        the lean zero.
    """
    residual = np.empty((*translation.shape[:-1], 4))
    residual[..., 0] = translation.dot(normal) - distance
    residual[..., 1:] = rotation[..., 1] - normal
    by_turn = np.zeros((*translation.shape[:-1], 4, 3))
    by_turn[..., 1:, 0] = rotation[..., 2]
    by_turn[..., 1:, 2] = -rotation[..., 0]
    return residual, by_turn
