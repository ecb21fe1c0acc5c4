"""Confidences that mean what they say: fitted to samples of cars that the network has not learnt from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.keypoints.augment import Street
from fgrecon.keypoints.crops import MARGIN
from fgrecon.keypoints.dataset import Photographs, azimuth_weights
from fgrecon.keypoints.decode import Calibration, decode
from fgrecon.keypoints.detect import REACH, Detector

__all__ = ["Reliability", "calibrate", "reliability"]

_BATCH = 32
_SEEN = 0.5  # a label counts as visible from this probability


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
    detector: Detector,
    photographs: Photographs,
    chosen: NDArray[np.intp],
    partner: NDArray[np.intp],
    *,
    street: Street | None = None,
    samples: int = 1500,
    seed: int = 1,
) -> Calibration:
    """Fit the calibration on street-like samples of photographs that the network has not learnt from.

    Args:
        detector: The network.
        photographs: With labels.
        chosen: Which of them to use.
        partner: (K,) index of each keypoint's mirror image.
        street: Degradation; None for that of the training with less occlusion, as street cars are.
        samples: How many samples.
        seed: Of the samples.
    """
    size = detector.network.settings.crop
    scene = replace(Street(), covered=0.25, block=0.1) if street is None else street
    scene = replace(scene, size=size)
    weights = azimuth_weights(photographs.azimuth, chosen)
    visible, mass, right = [], [], []
    for start in range(0, samples, _BATCH):
        count = min(_BATCH, samples - start)
        drawn = [photographs.draw(chosen, weights, scene, partner, (seed, start + i)) for i in range(count)]
        maps, seen, _ = detector.forward(np.stack([sample.crop for sample in drawn]))
        found = decode(maps, size / maps.shape[-1], REACH * size / MARGIN)
        away = np.linalg.norm(found.points - np.array([sample.keypoints for sample in drawn]), axis=-1)
        truly = np.array([sample.visible for sample in drawn]) > _SEEN
        visible.append(seen)
        mass.append(found.mass)
        right.append(truly & (away <= REACH * size / MARGIN))
    return Calibration.fit(np.concatenate(visible), np.concatenate(mass), np.concatenate(right))
