"""A common offset of marks against the keypoints that they mark."""

from __future__ import annotations

import numpy as np

from fgrecon.core.arrays import Array

_REWEIGHTINGS = 10


def robust_offset(jacobian: Array, residual: Array, weight: Array, sigma: float, weak: float) -> Array:
    """Offset (3,) by iteratively re-weighted least squares with a Huber loss, drawn weakly to zero.

    Args:
        jacobian: (N, 2, 3) derivative of the marks by the offset.
        residual: (N, 2) marks less the projected keypoints.
        weight: (N,) how much each mark counts.
        sigma: Residual up to which the loss is quadratic, in the residuals' unit.
    """
    offset = np.zeros(3)
    for _ in range(_REWEIGHTINGS):
        away = np.linalg.norm(jacobian @ offset - residual, axis=1)
        robust = weight / np.maximum(away, sigma)
        matrix = np.einsum("nij,nik,n->jk", jacobian, jacobian, robust) + weak * max(len(jacobian), 1) * np.eye(3)
        offset = np.linalg.solve(matrix, np.einsum("nij,ni,n->j", jacobian, residual, robust))
    return offset
