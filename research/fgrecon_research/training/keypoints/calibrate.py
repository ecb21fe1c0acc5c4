"""Confidences that mean what they say: fitted to samples of cars that the network has not learnt from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.reliability import Reliability, reliability
from fgrecon.perception.keypoints.crops import MARGIN
from fgrecon.perception.keypoints.decode import ConfidenceCalibration, logit
from fgrecon.perception.keypoints.detect import REACH, KeypointCascade
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.dataset import Photographs
from fgrecon_research.training.keypoints.labels import SEEN
from fgrecon_research.training.keypoints.views import azimuth_weights

__all__ = ["SCORED", "Reliability", "calibrate", "reliability"]

SCORED = replace(Street(), covered=0.25, block=0.1, stretch=0.0, bend=0.0)
"""Degradation of the samples: less occlusion than in the training, as street cars are, and no deformed cars."""

_BATCH = 32
_SIDE = 176  # pixels of the samples: as fine as the networks look
_UNLABELLED = 0.015
"""Added to the spread of keypoints, as a fraction of the box: labels of a photograph follow the network's points, and
so understate how far these are from a shape model's. Shapes common to a group are met to 0.011 per axis (median of the
last rounds), and five coefficients express a car that they were not learnt from to 0.008."""


def calibrate(
    detector: KeypointCascade,
    photographs: Photographs,
    chosen: NDArray[np.intp],
    partner: NDArray[np.intp],
    *,
    street: Street = SCORED,
    samples: int = 1500,
    seed: int = 1,
) -> ConfidenceCalibration:
    """Fit the calibration on street-like samples of photographs that the network has not learnt from.

    Args:
        detector: The network, without a calibration of its spread so far.
        photographs: With labels.
        chosen: Which of them to use.
        partner: (K,) index of each keypoint's mirror image.
        street: Degradation.
        samples: How many samples.
        seed: Of the samples.
    """
    scene = replace(street, size=_SIDE)
    extent = _SIDE / MARGIN
    box = (_SIDE - 1) / 2 + np.array([-0.5, -0.5, 0.5, 0.5]) * extent
    weights = azimuth_weights(photographs.azimuth, chosen)
    visible, mass, right, spread, error, azimuth, truth = [], [], [], [], [], [], []
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
            visible.append(logit(detection.visible)[known])
            mass.append(detection.mass[known])
            right.append(hit[known])
            if detection.observation.covariance is not None:
                spread.append(detection.observation.covariance[hit] / extent**2)
                error.append(away[hit])
    fitted = ConfidenceCalibration.fit(np.concatenate(visible), np.concatenate(mass), np.concatenate(right))
    fitted = fitted.with_spread(np.concatenate(spread), np.concatenate(error))
    fitted = fitted.with_direction(np.array(azimuth), np.array(truth))
    return replace(fitted, floor=float(np.hypot(fitted.floor, _UNLABELLED)))
