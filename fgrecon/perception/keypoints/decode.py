"""Decoding of likelihood maps to positions, confidences and covariances. Plain numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.detection import half_around
from fgrecon.perception.keypoints.layout import SETTINGS

_TINY = 1e-6


@dataclass(frozen=True)
class Decoded:
    """What the maps of B crops say about K keypoints."""

    points: Array  # (B, K, 2) positions in pixels of the crop, to sub-pixel
    covariance: Array  # (B, K, 2, 2) of the likelihood around the peak, square pixels of the crop
    mass: Array  # (B, K) share of the likelihood within `reach` of the position: how sure the map is


@dataclass(frozen=True)
class ConfidenceCalibration:
    """Logistic regression from what the network says to the probability that a point is visible and right.

    confidence = sigmoid(bias + visible * v + mass * m + product * v m'), with v the visibility's logit, m the log odds
    of the map's mass near the position, both limited to [-6, 6], and m' = m / 6.
    """

    bias: float = 0.0  # constant
    visible: float = 1.0  # factor of v
    mass: float = 0.5  # factor of m
    product: float = 0.0  # factor of v m'
    scale: float = 1.0  # factor of the likelihood's standard deviations
    # standard deviation per axis that is added in quadrature, as a fraction of the box's longer side: what a
    # likelihood cannot know, such as how annotators see a keypoint
    floor: float = 0.0
    # power to which the directions' probabilities are raised: below 1 where the network is too sure
    sharpness: float = 1.0
    doubt: float = 0.0  # probability that its direction means nothing
    kind_sharpness: float = 1.0  # the same of the kinds of vehicles
    kind_doubt: float = 0.0  # likewise

    def confidence(self, visible: Array, mass: Array) -> Array:
        """(B, K) confidences in (0, 1) from visibility logits and masses (B, K)."""
        return sigmoid(self.features(visible, mass) @ np.array([self.bias, self.visible, self.mass, self.product]))

    @staticmethod
    def features(visible: Array, mass: Array) -> Array:
        """(..., 4) what the factors multiply."""
        odds = np.log(np.clip(mass, _TINY, 1.0) / np.clip(1.0 - mass, _TINY, 1.0))
        v, m = np.clip(visible, -6.0, 6.0), np.clip(odds, -6.0, 6.0)
        return np.stack([np.ones_like(v), v, m, v * m / 6.0], axis=-1)

    def covariance(self, likelihood: Array, extent: float) -> Array:
        """Covariances (..., 2, 2) from those of the likelihood, for a box of that longer side in the same unit."""
        return self.scale**2 * likelihood + (self.floor * extent) ** 2 * np.eye(2)

    def direction(self, azimuth: Array) -> Array:
        """(B, A) probabilities of the directions from what the network says of them (B, A)."""
        return _softened(azimuth, self.sharpness, self.doubt)

    def kinds(self, kinds: Array) -> Array:
        """(B, N) probabilities of the kinds of vehicles, likewise."""
        return _softened(kinds, self.kind_sharpness, self.kind_doubt)

    def to_dict(self) -> dict[str, float]:
        """Plain numbers for a file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, float]) -> ConfidenceCalibration:
        """The reverse of `to_dict`; older files lack what came later."""
        later = "sharpness", "doubt", "kind_sharpness", "kind_doubt"
        return cls(**{f.name: float(data[f.name]) for f in fields(cls) if f.name in data or f.name not in later})


def _softened(probability: Array, sharpness: float, doubt: float) -> Array:
    """(B, N) probabilities to a power, mixed with every outcome alike."""
    if sharpness == 1.0 and doubt == 0.0:
        return probability
    power = np.clip(probability, _TINY**2, None) ** sharpness
    return (1.0 - doubt) * power / power.sum(axis=1, keepdims=True) + doubt / power.shape[1]


def left_probability(azimuth: Array) -> float:
    """How probably the camera is to the vehicle's left, for the directions (A,) that the network says.

    These are smeared over some bins, as is what the network is trained on: a car that is seen from 5 degrees left of
    straight ahead has directions on both sides. So they are sharpened within the front and the rear half, whose
    probabilities stay.
    """
    bins, probability = len(azimuth), 0.0
    ahead, left = half_around(0.0, bins), half_around(np.pi / 2.0, bins)
    for half in (ahead, 1.0 - ahead):
        sharp = (half * azimuth) ** SETTINGS.side_power
        probability += float(half @ azimuth * (left @ sharp) / max(float(sharp.sum()), _TINY**4))
    return min(probability, 1.0)


def logit(probability: Array) -> Array:
    """The reverse of `sigmoid`, limited to about 14."""
    p = np.clip(probability, _TINY, 1.0 - _TINY)
    return np.log(p / (1.0 - p))


def sigmoid(x: Array) -> Array:
    """1 / (1 + exp(-x)) without overflow."""
    return 0.5 * (1.0 + np.tanh(0.5 * x))


def log_softmax(logits: NDArray[np.floating]) -> Array:
    """Over the last axis."""
    shifted = np.asarray(logits, dtype=np.float64)
    shifted = shifted - shifted.max(axis=-1, keepdims=True)
    return shifted - np.log(np.exp(shifted).sum(axis=-1, keepdims=True))


def softmax(logits: NDArray[np.floating]) -> Array:
    """Over the last axis."""
    return np.exp(log_softmax(logits))


def decode(likelihood: Array, stride: float, reach: float) -> Decoded:
    """Position, spread and mass of likelihood maps; position and spread as from `peak`.

    Args:
        likelihood: (B, K, H, W), each map sums to one.
        stride: Pixels of the crop per cell; the centre of cell i is at (i + 0.5) * stride - 0.5.
        reach: Radius in pixels of the crop within which the mass is counted.
    """
    cell, covariance = peak(likelihood)
    x, y = cell[..., 0, None], cell[..., 1, None]
    height, width = likelihood.shape[2:]
    distance = ((np.arange(height) - y) ** 2)[..., :, None] + ((np.arange(width) - x) ** 2)[..., None, :]
    mass = np.where(distance <= (reach / stride) ** 2, likelihood, 0.0).sum(axis=(2, 3))
    return Decoded((cell + 0.5) * stride - 0.5, covariance * stride**2, np.minimum(mass, 1.0))


def peak(likelihood: Array) -> tuple[Array, Array]:
    """Positions (B, K, 2) and covariances (B, K, 2, 2) of likelihood maps (B, K, H, W), in cells.

    The position is the mean of the likelihood in a window around the peak of the smoothed map (3 x 3 mean: a peak
    split between two cells counts as one).
    """
    batch, count, height, width = likelihood.shape
    flat = likelihood.reshape(batch * count, height, width)
    padded = np.zeros((len(flat), height + 2, width + 2))
    padded[:, 1:-1, 1:-1] = flat
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    smooth = rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:]
    r0, c0 = np.divmod(smooth.reshape(len(flat), -1).argmax(axis=1), width)
    span = np.arange(-SETTINGS.peak_reach_cells, SETTINGS.peak_reach_cells + 1)
    r, c = r0[:, None, None] + span[:, None], c0[:, None, None] + span
    inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
    many = np.arange(len(flat))[:, None, None]
    local = np.where(inside, flat[many, np.clip(r, 0, height - 1), np.clip(c, 0, width - 1)], 0.0)
    total = np.maximum(local.sum(axis=(1, 2)), _TINY**2)
    share = local / total[:, None, None]
    y, x = (share * r).sum(axis=(1, 2)), (share * c).sum(axis=(1, 2))
    dy, dx = r - y[:, None, None], c - x[:, None, None]
    # A cell's own extent has the variance 1/12; it is part of what is not known.
    xx, yy = ((share * d * d).sum(axis=(1, 2)) + 1.0 / 12.0 for d in (dx, dy))
    xy = (share * dx * dy).sum(axis=(1, 2))
    covariance = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
    return np.stack([x, y], axis=-1).reshape(batch, count, 2), covariance.reshape(batch, count, 2, 2)
