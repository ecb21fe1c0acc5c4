"""Confidences that mean what they say: fitted to samples of cars that the network has not learnt from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.decode import ConfidenceCalibration, logit
from fgrecon.perception.keypoints.detect import REACH, KeypointCascade
from fgrecon.training.keypoints.augment import Street
from fgrecon.training.keypoints.dataset import Photographs, azimuth_weights
from fgrecon.training.keypoints.labels import SEEN

__all__ = ["Reliability", "calibrate", "reliability"]

_BATCH = 32
_SIDE = 176  # pixels of the samples: as fine as the networks look
_UNLABELLED = 0.015
"""Added to the spread of keypoints, as a fraction of the box: labels of a photograph follow the network's points, and
so understate how far these are from a shape model's. Shapes common to a group are met to 0.011 per axis (median of the
last rounds), and five coefficients express a car that they were not learnt from to 0.008."""


@dataclass(frozen=True)
class Reliability:
    """How often points of a confidence are right; arrays of B bins that hold equally many points.

    Attributes:
        confidence: (B,) mean confidence.
        right: (B,) share that is visible and within 0.1 of the box.
        count: (B,) number of points.
    """

    confidence: NDArray[np.float64]
    right: NDArray[np.float64]
    count: NDArray[np.int64]

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of the two, by number of points."""
        return float(np.abs(self.confidence - self.right) @ self.count / max(self.count.sum(), 1))


def reliability(confidence: ArrayLike, right: ArrayLike, bins: int = 10) -> Reliability:
    """Sort points (any shape) by confidence into bins of equal size."""
    sure, hit = np.ravel(confidence).astype(np.float64), np.ravel(right).astype(np.float64)
    parts = [part for part in np.array_split(np.argsort(sure, kind="stable"), bins) if len(part)]
    return Reliability(
        np.array([sure[part].mean() for part in parts]),
        np.array([hit[part].mean() for part in parts]),
        np.array([len(part) for part in parts]),
    )


def calibrate(
    detector: KeypointCascade,
    photographs: Photographs,
    chosen: NDArray[np.intp],
    partner: NDArray[np.intp],
    *,
    street: Street | None = None,
    samples: int = 1500,
    seed: int = 1,
) -> ConfidenceCalibration:
    """Fit the calibration on street-like samples of photographs that the network has not learnt from.

    Args:
        detector: The network, without a calibration of its spread so far.
        photographs: With labels.
        chosen: Which of them to use.
        partner: (K,) index of each keypoint's mirror image.
        street: Degradation; None for that of the training with less occlusion, as street cars are, and with
            cars that are not deformed.
        samples: How many samples.
        seed: Of the samples.
    """
    scene = replace(Street(), covered=0.25, block=0.1, stretch=0.0, bend=0.0) if street is None else street
    scene = replace(scene, size=_SIDE)
    extent = _SIDE / MARGIN
    box = (_SIDE - 1) / 2 + np.array([-0.5, -0.5, 0.5, 0.5]) * extent
    weights = azimuth_weights(photographs.azimuth, chosen)
    visible, mass, right, spread, error = [], [], [], [], []
    for start in range(0, samples, _BATCH):
        count = min(_BATCH, samples - start)
        drawn = [photographs.draw(chosen, weights, scene, partner, (seed, start + i)) for i in range(count)]
        found = detector.detect_batch([sample.crop for sample in drawn], np.tile(box, (count, 1)))
        for sample, detection in zip(drawn, found, strict=True):
            away = (detection.observation.keypoints - sample.keypoints) / extent
            known = np.isfinite(sample.keypoints).all(axis=1)
            hit = (sample.visible > SEEN) & (np.linalg.norm(away, axis=1) <= REACH)
            visible.append(logit(detection.visible)[known])
            mass.append(detection.mass[known])
            right.append(hit[known])
            if detection.observation.covariance is not None:
                spread.append(detection.observation.covariance[hit] / extent**2)
                error.append(away[hit])
    fitted = ConfidenceCalibration.fit(np.concatenate(visible), np.concatenate(mass), np.concatenate(right))
    fitted = fitted.with_spread(np.concatenate(spread), np.concatenate(error))
    return replace(fitted, floor=float(np.hypot(fitted.floor, _UNLABELLED)))
