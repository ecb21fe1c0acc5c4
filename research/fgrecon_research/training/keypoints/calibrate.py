"""Calibration of confidences on samples of cars that the network has not learnt from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.decode import ConfidenceCalibration, logit, sigmoid
from fgrecon.perception.keypoints.detect import REACH, KeypointCascade
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.dataset import Photographs
from fgrecon_research.training.keypoints.deform import UNKNOWN_KIND, Partner
from fgrecon_research.training.keypoints.labels import SEEN
from fgrecon_research.training.keypoints.views import azimuth_weights

SCORED = replace(Street(), covered=0.25, block=0.1, stretch=0.0, bend=0.0)
"""Degradation of the samples: less occlusion than in the training, as street cars are, and no deformed cars."""

_BATCH = 32
_SHARPNESS = 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0
_DOUBTS = 0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12
_STREET_KIND_SHARPNESS = 0.5  # photographs say too little of vans in a street: chosen on KITTI's drives, each left out
_SIDE = 176  # pixels of the samples: as fine as the networks look
_UNLABELLED = 0.015
"""Added to the spread of keypoints, as a fraction of the box: labels of a photograph follow the network's points, and
so understate how far these are from a shape model's. Shapes common to a group are met to 0.011 per axis (median of the
last rounds), and five coefficients express a car that they were not learnt from to 0.008."""


def calibrate(
    detector: KeypointCascade,
    photographs: Photographs,
    chosen: NDArray[np.intp],
    partner: Partner,
    *,
    street: Street = SCORED,
    samples: int = 1500,
    seed: int = 1,
) -> ConfidenceCalibration:
    """Fit the calibration on street-like samples of photographs that the network has not learnt from.

    Args:
        detector: The network, without a calibration of its spread so far.
    """
    scene = replace(street, size=_SIDE)
    extent = _SIDE / MARGIN
    box = (_SIDE - 1) / 2 + np.array([-0.5, -0.5, 0.5, 0.5]) * extent
    weights = azimuth_weights(photographs.azimuth, chosen)
    visible, mass, right, spread, error, azimuth, truth = [], [], [], [], [], [], []
    kinds, kind = [], []
    for start in range(0, samples, _BATCH):
        count = min(_BATCH, samples - start)
        drawn = [photographs.draw(chosen, weights, scene, partner, (seed, start + i)) for i in range(count)]
        found = detector.detect_batch([sample.crop for sample in drawn], np.tile(box, (count, 1)))
        for sample, detection in zip(drawn, found, strict=True):
            away = (detection.observation.keypoints - sample.keypoints) / extent
            known = np.isfinite(sample.keypoints).all(axis=1)
            hit = (sample.visible > SEEN) & (np.linalg.norm(away, axis=1) <= REACH)
            azimuth.append(detection.azimuth)
            truth.append(sample.azimuth)
            if detection.kinds is not None and sample.kind != UNKNOWN_KIND:
                kinds.append(list(detection.kinds.values()))
                kind.append(sample.kind)
            visible.append(logit(detection.visible)[known])
            mass.append(detection.mass[known])
            right.append(hit[known])
            if detection.observation.covariance is not None:
                spread.append(detection.observation.covariance[hit] / extent**2)
                error.append(away[hit])
    fitted = fit_confidence(np.concatenate(visible), np.concatenate(mass), np.concatenate(right))
    fitted = fit_spread(fitted, np.concatenate(spread), np.concatenate(error))
    fitted = fit_direction(fitted, np.array(azimuth), np.array(truth))
    fitted = fit_kinds(fitted, np.array(kinds), np.array(kind, dtype=np.int64))
    fitted = replace(fitted, kind_sharpness=min(fitted.kind_sharpness, _STREET_KIND_SHARPNESS))
    return replace(fitted, floor=float(np.hypot(fitted.floor, _UNLABELLED)))


def fit_confidence(visible: Array, mass: Array, right: NDArray[np.bool_], ridge: float = 1e-3) -> ConfidenceCalibration:
    """Maximum likelihood on examples (any shape): `right` where the point was visible and near enough."""
    x = ConfidenceCalibration.features(visible, mass).reshape(-1, 4)
    y, w = right.ravel().astype(np.float64), np.zeros(4)
    for _ in range(50):  # Newton's method
        p = sigmoid(x @ w)
        gradient = x.T @ (p - y) + ridge * len(y) * w * [0.0, 1.0, 1.0, 1.0]
        curvature = (x * (p * (1 - p))[:, None]).T @ x + ridge * len(y) * np.diag([1e-6, 1.0, 1.0, 1.0])
        step = np.linalg.solve(curvature, gradient)
        w = w - step
        if np.abs(step).max() < 1e-9:
            break
    return ConfidenceCalibration(*(float(value) for value in w))


def fit_spread(calibration: ConfidenceCalibration, likelihood: Array, error: Array) -> ConfidenceCalibration:
    """The scale and floor under which errors of right points are most probable (Laplace-like tails).

    Args:
        likelihood: (M, 2, 2) covariances of the likelihood, in units of the box's longer side.
        error: (M, 2) errors in the same unit.
    """
    if not len(error):
        return calibration
    best, least = (calibration.scale, calibration.floor), np.inf
    for scale in (0.5, 0.7, 1.0, 1.4, 2.0):
        for floor in (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04):
            covariance = scale**2 * likelihood + (floor**2 + 1e-9) * np.eye(2)
            squared = np.einsum("mi,mij,mj->m", error, np.linalg.inv(covariance), error)
            # A bivariate t distribution of four degrees of freedom: a few bad points do not decide.
            cost = float(np.mean(0.5 * np.log(np.linalg.det(covariance)) + 3.0 * np.log1p(squared / 4.0)))
            if cost < least:
                best, least = (scale, floor), cost
    return replace(calibration, scale=best[0], floor=best[1])


def fit_direction(calibration: ConfidenceCalibration, azimuth: Array, truth: Array) -> ConfidenceCalibration:
    """The sharpness and doubt under which the true sides are most probable: the half circle around the truth.

    The probability of the very direction would not do: what a network is trained on is smeared over some bins.

    Args:
        azimuth: (M, A) probabilities of the directions as the network says them.
        truth: (M,) true directions, radians.
    """
    if not len(truth):
        return calibration
    centres = 2.0 * np.pi * np.arange(azimuth.shape[1]) / azimuth.shape[1]
    side = 0.5 * (1.0 + np.sign(np.round(np.cos(centres - truth[:, None]), 9)))  # a bin on the border counts half
    tried = [replace(calibration, sharpness=power, doubt=doubt) for power, doubt in product(_SHARPNESS, _DOUBTS)]
    return _most_probable(tried, lambda one: (one.direction(azimuth) * side).sum(axis=1))


def fit_kinds(calibration: ConfidenceCalibration, kinds: Array, truth: NDArray[np.int64]) -> ConfidenceCalibration:
    """The sharpness and doubt under which the true kinds are most probable.

    Args:
        kinds: (M, N) probabilities of the kinds as the network says them.
        truth: (M,) numbers of the true ones.
    """
    if not len(truth):
        return calibration
    rows = np.arange(len(truth))
    tried = [
        replace(calibration, kind_sharpness=power, kind_doubt=doubt) for power, doubt in product(_SHARPNESS, _DOUBTS)
    ]
    return _most_probable(tried, lambda one: one.kinds(kinds)[rows, truth])


def _most_probable(
    tried: Sequence[ConfidenceCalibration], likelihood: Callable[[ConfidenceCalibration], Array]
) -> ConfidenceCalibration:
    """The calibration that makes examples (M,) most probable."""
    return tried[int(np.argmin([-float(np.log(likelihood(one) + 1e-6).mean()) for one in tried]))]
