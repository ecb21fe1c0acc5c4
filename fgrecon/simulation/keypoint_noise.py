"""Error model of a keypoint network: localisation noise, confidences, lost points and coherent confusions.

`HOURGLASS` holds the numbers that `fgrecon_research.paper.keypoint_noise_fit` measured on 76 frames of KITTI tracking
whose keypoints a stacked-hourglass network really found. Everything is relative to
the extent of the 2D box (the larger of its width and height), as a network that looks at a resized crop sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError

OUTLIER = 0.1
"""A measurement farther from the truth than this fraction of the box extent is an outlier (the APK threshold)."""


@dataclass(frozen=True)
class Twins:
    """Which keypoints look alike, as indices (K,) into the category's keypoints."""

    mirrored: NDArray[np.intp]  # the other side's keypoint (left and right confused)
    # the one at the same place of the vehicle turned by 180 degrees (front and back confused): the left headlight
    # for the right taillight. Keypoints without a counterpart (side mirrors) have their mirror image
    rotated: NDArray[np.intp]
    swapped: NDArray[np.intp]  # the one at the other end of the same side

    @classmethod
    def of(cls, category: Category) -> Twins:
        """The twins of a category: rotated twins are opposite corners of its planar faces of four keypoints."""
        rotated = category.mirror.copy()
        for face in category.faces:
            if len(face.keypoints) == 4:
                a, b, c, d = face.keypoints
                rotated[[a, b, c, d]] = c, d, a, b
        return cls(category.mirror, rotated, category.mirror[rotated])


@dataclass(frozen=True)
class NoiseModel:
    """Statistics of a keypoint network's mistakes; lengths are fractions of the box extent, shares are in [0, 1].

    A keypoint is *found* (measured near its true place) or *lost* (measured somewhere else). Hidden keypoints are found
    at times, since the network guesses them from the others.

    Attributes:
        found_visible: Share of visible keypoints that are found.
        found_hidden: Share of hidden keypoints that are found.
        sigma_visible: Standard deviation per axis of a found visible keypoint.
        sigma_hidden: The same for a found hidden one.
        lost_to: Where lost keypoints go: to the place of their rotated twin, of their mirror image, of their swapped
            twin, onto the measurement of another found keypoint, anywhere in the box. Sums to 1.
        confidence_visible: Beta distribution (a, b) of the confidence of a found visible keypoint.
        confidence_hidden: The same for a found hidden one.
        confidence_lost: Median and standard deviation of the logarithm of a lost keypoint's confidence.
        confident_lost: Share of lost keypoints that are as confident as found visible ones.
        confusion: Share of vehicles of which the network takes one end for the other as a whole.
        confusion_share: Share of the keypoints that follow such a confusion, confidently.
        fade: Mean of the exponential spread of difficulty over vehicles: a vehicle of difficulty s has every
            confidence and every share of found keypoints raised to the power 1 + s. 0 where all are alike.
        covered: Share of vehicles of which something else hides a part (a strip from the left or right of the box).
        missing: Share of keypoints that are not measured at all (NaN).
        box_sigma: Standard deviation of each side of the 2D box, pixels.
    """

    found_visible: float
    found_hidden: float
    sigma_visible: float
    sigma_hidden: float
    lost_to: tuple[float, float, float, float, float]
    confidence_visible: tuple[float, float]
    confidence_hidden: tuple[float, float]
    confidence_lost: tuple[float, float]
    confident_lost: float = 0.0
    confusion: float = 0.0
    confusion_share: float = 0.7
    fade: float = 0.0
    covered: float = 0.0
    missing: float = 0.0
    box_sigma: float = 1.5

    def __post_init__(self) -> None:
        """Check that shares are shares and spreads are not negative.

        Raises:
            InvalidInputError: A number is out of range.
        """
        shares = ("found_visible", "found_hidden", "confident_lost", "confusion", "confusion_share")
        for name in (*shares, "covered", "missing"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidInputError(f"noise.{name}", getattr(self, name), "Give a share from 0 to 1.")
        for name in ("sigma_visible", "sigma_hidden", "fade", "box_sigma"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InvalidInputError(f"noise.{name}", getattr(self, name), "Give a number >= 0.")
        if len(self.lost_to) != 5 or min(self.lost_to) < 0 or abs(sum(self.lost_to) - 1.0) > 1e-6:
            raise InvalidInputError("noise.lost_to", self.lost_to, "Give five shares that sum to 1.")
        for name in ("confidence_visible", "confidence_hidden", "confidence_lost"):
            if min(getattr(self, name)) <= 0:
                raise InvalidInputError(f"noise.{name}", getattr(self, name), "Give two positive numbers.")

    def measure(
        self,
        projections: NDArray[np.float64],
        visible: NDArray[np.bool_],
        box: NDArray[np.float64],
        twins: Twins,
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw what the network would report.

        Args:
            projections: (K, 2) true pixels.
            visible: (K,) whether each keypoint can be seen.
            box: (4,) x1, y1, x2, y2 of the crop in pixels; measurements lie inside.
            twins: Which keypoints look alike.
            rng: Source of randomness.

        Returns:
            (K, 2) measured pixels (NaN where missing) and (K,) confidences.
        """
        size = len(projections)
        extent = float(max(box[2] - box[0], box[3] - box[1]))
        exponent = 1.0 + (rng.exponential(self.fade) if self.fade else 0.0)
        found = rng.random(size) < np.where(visible, self.found_visible, self.found_hidden) ** exponent
        sigma = np.where(visible, self.sigma_visible, self.sigma_hidden)[:, None] * extent
        noise = rng.standard_normal((size, 2)) * sigma
        seen_confidence = rng.beta(*self.confidence_visible, size)
        confidence = np.where(visible, seen_confidence, rng.beta(*self.confidence_hidden, size))
        median, spread = self.confidence_lost
        lost_confidence = np.minimum(median * np.exp(spread * rng.standard_normal(size)), 1.0)
        confident = rng.random(size) < self.confident_lost
        confidence = np.where(found, confidence, np.where(confident, seen_confidence, lost_confidence))

        pixels = projections + noise
        pixels[~found] = self._lost_places(pixels, projections, found, box, twins, rng)[~found]
        if rng.random() < self.confusion:
            # The end that is seen is named as the other end: hidden keypoints are found, confidently, where their
            # visible twins are, and those twins are lost.
            follows = rng.random(size) < self.confusion_share
            named = follows & ~visible & visible[twins.rotated]
            pixels[named] = (projections[twins.rotated] + noise)[named]
            confidence[named] = seen_confidence[named]
            unnamed = np.zeros(size, dtype=bool)
            unnamed[twins.rotated[named]] = True
            pixels[unnamed] = self._lost_places(pixels, projections, ~unnamed, box, twins, rng)[unnamed]
            confidence[unnamed] = lost_confidence[unnamed]
        pixels = np.clip(pixels, box[:2], box[2:])
        pixels[rng.random(size) < self.missing] = np.nan
        return pixels, np.where(np.isnan(pixels[:, 0]), 0.0, confidence**exponent)

    def _lost_places(
        self,
        pixels: NDArray[np.float64],
        projections: NDArray[np.float64],
        found: NDArray[np.bool_],
        box: NDArray[np.float64],
        twins: Twins,
        rng: np.random.Generator,
    ) -> NDArray[np.float64]:
        size = len(pixels)
        kind = rng.choice(len(self.lost_to), size, p=self.lost_to)
        others = np.flatnonzero(found)
        response = pixels[rng.choice(others, size)] if len(others) else projections
        anywhere = box[:2] + rng.random((size, 2)) * (box[2:] - box[:2])
        extent = float(max(box[2] - box[0], box[3] - box[1]))
        jitter = rng.standard_normal((size, 2)) * self.sigma_visible * extent
        places = np.stack(
            [
                projections[twins.rotated] + jitter,
                projections[twins.mirrored] + jitter,
                projections[twins.swapped] + jitter,
                response,
                anywhere,
            ]
        )
        return places[kind, np.arange(size)]


HOURGLASS = NoiseModel(
    found_visible=0.92,
    found_hidden=0.314,
    sigma_visible=0.0244,
    sigma_hidden=0.0413,
    lost_to=(0.34, 0.02, 0.10, 0.40, 0.14),
    confidence_visible=(3.0, 1.97),
    confidence_hidden=(0.87, 5.4),
    confidence_lost=(0.022, 0.7),
    confident_lost=0.0127,
)
"""A stacked-hourglass network on unoccluded cars seen mostly from ahead or behind, at 8-30 m.

Fitted by `fgrecon_research.paper.keypoint_noise_fit.fit_noise_model` to the three tracks (76 frames, 1,064 keypoints)
of KITTI tracking in `kitti_tracking_keypoints14`. Of the 479 keypoints more confident than 0.3 there, 1 % are outliers.
"""
