"""How sure the result is: marginal covariances of the joint graph at its minimum."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import FactorCallbackError
from fgrecon.solve.graph.graph import VehicleGraph

__all__ = ["Covariances", "covariances", "factorise", "read_covariances"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Covariances:
    """Covariances of the result.

    Attributes:
        pose: (6, 6), GTSAM's local coordinates: rotation in radians, translation in metres, in the object's own frame.
        coefficients: (N, N).
        keypoints: (K, 3, 3) of each 3D keypoint in the object frame, square metres.
    """

    pose: Array
    coefficients: Array
    keypoints: Array


def covariances(vehicle: VehicleGraph, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Covariances | None:
    """Marginals of pose, coefficients and keypoints; None where the graph does not determine them.

    Args:
        vehicle: Builder of the graph, with the pose as a variable.
        graph: The graph.
        values: Its minimum.
    """
    marginals = factorise(graph, values)
    return None if marginals is None else read_covariances(vehicle, marginals)


def factorise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals | None:
    """The marginals of a graph at its minimum; None where it does not determine its variables."""
    try:
        return gtsam.Marginals(graph, values)
    except FactorCallbackError:
        raise
    except RuntimeError:  # GTSAM's only sign of an indeterminate system
        return None


def read_covariances(vehicle: VehicleGraph, marginals: gtsam.Marginals) -> Covariances | None:
    """What the marginals say of one frame of a vehicle; None where they are not finite or cannot be had."""
    assert vehicle.pose_key is not None
    shape_keys = list(vehicle.shape.keys)
    try:
        pose = marginals.marginalCovariance(vehicle.pose_key)
        shape = _joint(marginals, shape_keys)
    except FactorCallbackError:
        raise
    except RuntimeError:  # GTSAM's only sign of an indeterminate system
        return None
    derivative = vehicle.shape.derivative  # (K, 3, D)
    keypoints = derivative @ shape @ derivative.transpose(0, 2, 1)
    if not (np.isfinite(pose).all() and np.isfinite(keypoints).all()):
        return None
    count = vehicle.shape.dims[0] if vehicle.shape.coefficients_key is not None else 0
    return Covariances(pose, shape[:count, :count], keypoints)


def _joint(marginals: gtsam.Marginals, keys: list[int]) -> Array:
    if not keys:
        return np.zeros((0, 0))
    if len(keys) == 1:
        single: Array = marginals.marginalCovariance(keys[0])
        return single
    joint = marginals.jointMarginalCovariance(gtsam.KeyVector(keys))
    rows: Array = np.block([[joint.at(a, b) for b in keys] for a in keys])
    return rows
