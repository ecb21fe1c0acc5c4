"""Labels corrected by a factor graph over all photographs of one shape.

    N(0, I) ---- L(0) ------- reprojection, robust, 14 x 2 per photograph ------- X(0, t) ---- measured pose
    offsets ---- O(0) ---------------+--- reprojection of marks, if any -------- (one each)
    prior          |
                symmetry ---- M(0)

The keypoints that the network found in the photographs of a shape, each with its covariance and confidence, meet in one
shape: coefficients and a small free offset per keypoint, shared by all. The measured poses are good to a few degrees;
each photograph may correct its own within that. What the network gets wrong on single photographs the robust loss and
the others outvote; what the first labels had wrong for the whole shape the network's view of all shapes corrects.

Photographs of one shape show nearly, not exactly, the same car. So each photograph is then solved once more by itself,
with its own coefficients and offsets around those of the group: the labels are the projections of that shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

import factors
from factors import L, LinearShape, M, O, ProjectionKernel, RobustLoss, X
from fgrecon.core.arrays import Array
from fgrecon.core.geometry import MIRROR, turn_between
from fgrecon.core.shape_prior import ShapePrior
from fgrecon_research.io.annotations.offsets import robust_offset
from fgrecon_research.training.keypoints.labels import ShapeFit
from fgrecon_research.training.keypoints.posed_cars import PosedCar

TURN_SIGMA = np.deg2rad(5.0)  # of the measured poses
SHIFT_SIGMA = np.array([0.02, 0.02, 0.06])  # across, down and along the view, in diagonals of the car's box
_OUTLINED = 0.5  # of these spreads where the silhouette has corrected the pose
_OUTLINED_SIGMA = 0.5  # of the coefficients around those of the silhouettes
_OFFSET_SIGMA = 0.02  # of a keypoint's free offset per axis: 10 cm on a car of 5 m
_UNKNOWN_SIGMA = 0.08  # of the offset along the car of one that the silhouettes say is elsewhere
_SYMMETRY_SIGMA = 0.002
_POINT_SIGMA = 0.02  # of the network's points, as a fraction of the photograph's longer side, beside their covariance
_LOSS = RobustLoss.of("geman_mcclure", 2.0)
_OWN_SIGMA = 0.7  # of a photograph's own coefficients around its group's
_OWN_OFFSET_SIGMA = 0.03  # of its own offsets around its group's
_LEAST_CONFIDENCE = 0.05
_MARK_SIGMA = 0.015  # of a keypoint marked by hand, as a fraction of the longer side
_MARK_LOSS = RobustLoss.of("huber", 1.5)
_SEEN, _WEAK = 0.6, 1e-4  # of what tells the network's bias
_DISAGREES = np.deg2rad(12.0)  # a photograph whose pose had to turn further is left out
_SUPPORT = 0.4  # share of the confidence that has to agree with the shape


@dataclass(frozen=True)
class Found:
    """What the network found in M photographs."""

    keypoints: Array  # (M, K, 2) pixels
    confidence: Array  # (M, K)
    covariance: Array  # (M, K, 2, 2) square pixels


@dataclass(frozen=True)
class Relabelled:
    """The corrected shape and poses of a group."""

    fit: ShapeFit  # the shape, with free offsets
    cars: tuple[PosedCar, ...]  # the photographs with corrected poses
    trusted: NDArray[np.bool_]  # (M,) whether a photograph agrees with the shape well enough to learn from
    keypoints: Array  # (M, K, 2) labels in pixels: projections of each photograph's own shape
    marked: NDArray[np.bool_]  # (K,) which keypoints are where marks say


def relabel_shape(
    prior: ShapePrior,
    cars: Sequence[PosedCar],
    start: ShapeFit,
    found: Found,
    outlined: NDArray[np.bool_] | None = None,
    known: NDArray[np.bool_] | None = None,
    marks: Array | None = None,
) -> Relabelled:
    """Correct shape and poses of the photographs of one shape.

    Args:
        prior: Model of the shapes, in the unit of the poses.
        outlined: (M,) which poses were corrected by a silhouette and are surer for that; where there are any, the shape
            that it starts from is the silhouettes', and what is found may only correct it.
        known: (K,) about which keypoints of it the shape so far tells; others may be anywhere along the car.
        marks: (M, K, 2) keypoints marked by hand, NaN where none is. In a shape where a keypoint or its mirror image is
            marked, it is where the marks say, and what was found of it counts nothing.
    """
    given = np.full((len(cars), prior.category.size, 2), np.nan) if marks is None else marks
    marked = np.asarray(np.isfinite(given).all(axis=-1).any(axis=0), dtype=np.bool_)
    marked = marked | marked[prior.category.mirror]
    sure = np.zeros(len(cars), dtype=bool) if outlined is None else outlined
    shape = LinearShape(prior.mean, prior.basis, L(0), O(0))
    free = marked if known is None else marked | ~known
    graph, values = _shape_graph(prior, shape, start, free, outlined=bool(sure.any()))
    extent = np.array([max(car.size) for car in cars], dtype=np.float64)
    covariance = found.covariance + (_POINT_SIGMA * extent)[:, None, None, None] ** 2 * np.eye(2)
    covariance = (covariance + covariance.swapaxes(-1, -2)) / 2
    weights = np.where((found.confidence < _LEAST_CONFIDENCE) | marked, 0.0, found.confidence)
    photographs = [
        _photograph_factors(
            car,
            shape,
            X(0, number),
            found.keypoints[number],
            weights[number],
            covariance[number],
            _OUTLINED if sure[number] else 1.0,
            given[number],
        )
        for number, car in enumerate(cars)
    ]
    for number, (car, own) in enumerate(zip(cars, photographs, strict=True)):
        values.insert(X(0, number), _pose(car))
        for factor in own:
            graph.add(factor)
    solved = _optimise(graph, values)
    fit = ShapeFit(solved.atVector(L(0)), solved.atVector(O(0)).reshape(-1, 3), start.edge_error)
    poses = [solved.atPose3(X(0, number)) for number in range(len(cars))]
    corrected = tuple(
        replace(car, rotation=pose.rotation().matrix(), translation=pose.translation())
        for car, pose in zip(cars, poses, strict=True)
    )
    points = prior.keypoints(fit.coefficients, fit.offsets)
    projected = np.array([car.project(points) for car in corrected])
    support = _support(found.keypoints - projected, covariance, weights)
    turned = np.array([turn_between(a.rotation, b.rotation) for a, b in zip(cars, corrected, strict=True)])
    trusted = (support >= _SUPPORT) & (turned < _DISAGREES)
    labels = projected.copy()
    for number, car in enumerate(corrected):
        if trusted[number]:
            labels[number] = _own_labels(prior, fit, car, X(0, number), photographs[number])
    return Relabelled(fit, corrected, trusted, labels, marked)


def _shape_graph(
    prior: ShapePrior, shape: LinearShape, start: ShapeFit, free: NDArray[np.bool_], *, outlined: bool
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The terms of the shape alone, and its first values."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    if outlined:
        noise = gtsam.noiseModel.Isotropic.Sigma(prior.dimension, _OUTLINED_SIGMA)
        graph.add(gtsam.PriorFactorVector(L(0), start.coefficients, noise))
    else:
        graph.add(factors.coefficients_prior(L(0), prior.dimension))
    spread = np.full(prior.mean.shape, _OFFSET_SIGMA)
    spread[free, 0] = _UNKNOWN_SIGMA
    graph.add(factors.offsets_prior(O(0), spread))
    graph.add(factors.symmetry_factor(shape, prior.category.symmetric_pairs, M(0), _SYMMETRY_SIGMA))
    values.insert(L(0), start.coefficients)
    values.insert(O(0), start.offsets.ravel())
    values.insert(M(0), gtsam.OrientedPlane3(np.array([0.0, 0.0, 1.0, 0.0])))
    return graph, values


def _support(difference: Array, covariance: Array, weights: Array) -> Array:
    """(M,) share of the weights (M, K) of points that agree, by differences (M, K, 2), covariances (M, K, 2, 2)."""
    distance = np.sqrt(np.einsum("mki,mkij,mkj->mk", difference, np.linalg.inv(covariance), difference))
    # GTSAM's loss sees the distance times the root of the weight, as its noise models do.
    agrees = _LOSS.weights(distance * np.sqrt(weights)) > 0.5
    return (weights * agrees).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-9)


def without_bias(
    prior: ShapePrior,
    cars: Sequence[PosedCar],
    fits: Sequence[ShapeFit],
    sure: NDArray[np.bool_],
    found: Found,
) -> Found:
    """What was found, less what is off alike in all shapes.

    A network that learnt from labels which are off puts its points off in the same way: an error that all shapes share
    is the network's. Per keypoint and its mirror image one offset in the object's frame is fitted, by least squares
    with a Huber loss, to what was found in photographs of known shape and pose (`sure`, (M, K)), and taken off again in
    all.
    """
    points = np.array([prior.keypoints(fit.coefficients, fit.offsets) for fit in fits])
    rotation, translation = np.array([c.rotation for c in cars]), np.array([c.translation for c in cars])
    camera = np.einsum("mij,mkj->mki", rotation, points) + translation[:, None]
    matrix = np.array([c.matrix for c in cars])
    homogeneous = np.einsum("mij,mkj->mki", matrix, camera)
    pixels = homogeneous[..., :2] / homogeneous[..., 2:]
    rows = matrix[:, None, :2] - pixels[..., None] * matrix[:, None, 2:]
    jacobian = np.einsum("mkij,mjl->mkil", rows, rotation) / homogeneous[..., 2, None, None]
    extent = np.array([max(car.size) for car in cars], dtype=np.float64)[:, None]
    bias = np.zeros_like(prior.mean)
    for keypoint, partner in enumerate(prior.category.mirror.tolist()):
        if keypoint > partner:
            continue
        pair = [keypoint, partner]
        rely = sure[:, keypoint] & sure[:, partner]
        by_offset = jacobian[rely][:, pair] / extent[rely][..., None, None]
        by_offset[:, 1, :, 2] *= -1.0
        residual = (found.keypoints - pixels)[rely][:, pair] / extent[rely][..., None]
        weight = np.where(found.confidence[rely][:, pair] > _SEEN, found.confidence[rely][:, pair], 0.0)
        bias[keypoint] = robust_offset(
            by_offset.reshape(-1, 2, 3), residual.reshape(-1, 2), _POINT_SIGMA * weight.ravel(), _POINT_SIGMA, _WEAK
        )
        bias[partner] = bias[keypoint] * MIRROR
    return replace(found, keypoints=found.keypoints - np.einsum("mkij,kj->mki", jacobian, bias))


def _photograph_factors(
    car: PosedCar,
    shape: LinearShape,
    key: int,
    points: Array,
    weights: Array,
    covariance: Array,
    spread: float,
    marks: Array,
) -> list[gtsam.NonlinearFactor]:
    """A photograph's pose with `spread` times the measured ones' spread, and the keypoints found and marked in it."""
    # GTSAM's increments are in the object's frame; the shift's spread is given in the camera's.
    shift = car.rotation.T @ np.diag(SHIFT_SIGMA**2) @ car.rotation
    full = np.zeros((6, 6))
    full[:3, :3], full[3:, 3:] = TURN_SIGMA**2 * np.eye(3), (shift + shift.T) / 2
    measured = gtsam.PriorFactorPose3(key, _pose(car), gtsam.noiseModel.Gaussian.Covariance(spread**2 * full))
    result: list[gtsam.NonlinearFactor] = [measured]
    kernel = ProjectionKernel(shape, car.matrix, key)
    if weights.any():
        reprojection = factors.reprojection_factor(kernel, points, weights, covariance, _LOSS)
        result.append(reprojection)
    if np.isfinite(marks).any():
        alike = np.tile((_MARK_SIGMA * max(car.size)) ** 2 * np.eye(2), (len(marks), 1, 1))
        result.append(factors.reprojection_factor(kernel, marks, np.ones(len(marks)), alike, _MARK_LOSS))
    return result


def _own_labels(
    prior: ShapePrior,
    group: ShapeFit,
    car: PosedCar,
    key: int,
    photograph: Sequence[gtsam.NonlinearFactor],
) -> Array:
    """(K, 2) projections of the shape that a photograph shows, near its group's; starts at the corrected pose."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    isotropic = gtsam.noiseModel.Isotropic.Sigma
    offsets = group.offsets.ravel()
    graph.add(gtsam.PriorFactorVector(L(0), group.coefficients, isotropic(prior.dimension, _OWN_SIGMA)))
    graph.add(gtsam.PriorFactorVector(O(0), offsets, isotropic(len(offsets), _OWN_OFFSET_SIGMA)))
    for factor in photograph:
        graph.add(factor)
    values.insert(L(0), group.coefficients)
    values.insert(O(0), offsets)
    values.insert(key, _pose(car))
    solved = _optimise(graph, values)
    pose = solved.atPose3(key)
    own = replace(car, rotation=pose.rotation().matrix(), translation=pose.translation())
    return own.project(prior.keypoints(solved.atVector(L(0)), solved.atVector(O(0)).reshape(-1, 3)))


def _optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(30)
    parameters.setRelativeErrorTol(1e-4)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _pose(car: PosedCar) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(car.rotation), car.translation)
