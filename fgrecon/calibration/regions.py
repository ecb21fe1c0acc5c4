"""Errors of a result in units of its claimed confidence regions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import position_covariance
from fgrecon.core.reconstruction import Reconstruction

DIMENSIONS = {"position": 3, "yaw": 1, "size": 3, "velocity": 2}
"""What normalised squared errors are of, and its dimension; velocity is over the ground."""


@dataclass(frozen=True)
class Claimed:
    """Errors by the covariances that a result has for them."""

    # normalised squared error by quantity; without those whose covariance is not determined
    squared: Mapping[str, float]
    spread: Mapping[str, float]  # geometric mean of the semi-axes of each one's one-sigma region, degrees or metres


def claimed(result: Reconstruction, position: Array, yaw: float, size: Array) -> Claimed:
    """The errors of position, yaw and size by the result's own covariances.

    Args:
        position: (3,) error of the location in the camera's frame, metres.
        yaw: Error about the vertical axis, radians.
        size: (3,) error of length, width and height, metres.
    """
    errors = {"position": position, "yaw": np.array([yaw]), "size": size}
    regions: dict[str, Array] = {}
    if result.uncertainty.pose_covariance is not None:
        regions["position"] = position_covariance(result.camera_T_object, result.uncertainty.pose_covariance)
        regions["yaw"] = result.uncertainty.pose_covariance[1:2, 1:2]  # about the vehicle's own vertical axis
    if result.uncertainty.size_covariance is not None:
        regions["size"] = result.uncertainty.size_covariance
    squared = {
        name: value
        for name, covariance in regions.items()
        if (value := normalised_squared_error(errors[name], covariance)) is not None
    }
    return Claimed(squared, {name: _radius(name, regions[name]) for name in squared})


def _radius(name: str, covariance: Array) -> float:
    radius = float(np.linalg.det(covariance)) ** (0.5 / len(covariance))
    return float(np.degrees(radius)) if name == "yaw" else radius


def normalised_squared_error(error: Array, covariance: Array) -> float | None:
    """Error (D,) by its covariance (D, D); None where that is not positive definite."""
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    white = np.linalg.solve(root, error)
    return float(white @ white)
