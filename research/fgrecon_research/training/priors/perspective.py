"""Perspective correction of scaled orthography: the nearer end of a vehicle is imaged larger.

To first order a point at depth zeta behind its shape's centre is drawn towards the image of that centre,

    p - centre = (1 - d zeta) (p - centre) of scaled orthography,     d = 1 / distance of the camera.

Left alone, this becomes a mode of deformation of its own: on street images the second basis vector of a car then tells
whether the camera sees the front (a car that widens forward) or the rear. Here one common d, in the shape's units, is
estimated by weighted least squares, and the image points are moved to where scaled orthography would have them.
d = 0.065 of a car whose keypoints lie 1.65 m (RMS) from its origin means a camera at 25 m.

The estimate must be made while the shape is rigid, since vectors that explain the effect leave nothing to see.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon_research.training.priors.em_ppca import Data, EmState, expected_shapes

_LEAST_FACTOR = 0.5
"""Bound on 1 + d zeta for points of mistaken cameras."""


def estimate_nearness(data: Data, state: EmState, handedness: float) -> float:
    """Inverse distance d of the cameras, per unit of the shape, that explains the residuals best.

    Args:
        handedness: 1 where the frame of the model is right-handed, -1 where its depth is reversed.

    Returns:
        d; below zero where the residuals speak for the reverse.
    """
    depth, offset, centre = _geometry(state, handedness)
    weight = state.posterior.weight * data.importance[:, None]
    residual = state.cameras.inverse_scale[:, None, None] * data.points - centre[:, None] - offset
    change = -offset * depth[:, :, None]
    w = weight[:, :, None]

    def free_of_camera(values: Array) -> Array:
        """Without what translation and scale of each image can take up."""
        centred = values - (w * values).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
        pattern = offset - (w * offset).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
        share = (w * pattern * centred).sum(axis=(1, 2)) / (w * pattern**2).sum(axis=(1, 2))
        return np.asarray(centred - share[:, None, None] * pattern)

    change, residual = free_of_camera(change), free_of_camera(residual)
    return float((w * residual * change).sum() / (w * change**2).sum())


def without_perspective(data: Data, state: EmState, handedness: float, nearness: float) -> Data:
    """The image points (as annotated) moved to where scaled orthography would have them."""
    depth, _, centre = _geometry(state, handedness)
    centre = centre / state.cameras.inverse_scale[:, None]
    factor = np.maximum(1.0 + nearness * depth, _LEAST_FACTOR)[:, :, None]
    moved = centre[:, None] + factor * (data.points - centre[:, None])
    return replace(data, points=moved * data.measured[:, :, None])


def _geometry(state: EmState, handedness: float) -> tuple[Array, Array, Array]:
    """Depth (M, K) and image offset (M, K, 2) of the keypoints from their centre, and the image of that (M, 2)."""
    shapes = expected_shapes(state.model, state.posterior.mean)
    middle = shapes.mean(axis=1)
    centred = shapes - middle[:, None]
    rotation = state.cameras.rotation
    forward = handedness * np.cross(rotation[:, 0], rotation[:, 1])
    depth = (centred @ forward[:, :, None])[:, :, 0]
    centre = state.cameras.translation + (rotation @ middle[:, :, None])[:, :, 0]
    return depth, centred @ rotation.transpose(0, 2, 1), centre
