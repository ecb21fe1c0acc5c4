"""What is known about one vehicle in one image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import CORNERS, as_finite, as_shape, check_corners, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Evidence, as_evidence
from fgrecon.core.lens import OPENCV, WIDEST_DEGREES
from fgrecon.core.repr import brief_repr

_SUM = 1e-3
"""By so much the sum of probabilities may be off."""

_FEWEST = 3
_STEEP = 1000.0  # pixels that one becomes: there is no lens there any more
"""Keypoints that a pose needs."""

_LARGEST = 1e7
"""No image is larger, in pixels; beyond, squares of numbers soon overflow."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Keypoints of one vehicle, as a detector or a person gave them.

    Attributes:
        keypoints: (K, 2) pixels (u, v); NaN rows are keypoints without any measurement.
        confidence: (K,) in [0, 1]: how probable it is that the point is visible and right; 0 where not measured.
        box: (4,) 2D box x1, y1, x2, y2 of the vehicle in pixels, or None; of its outline, unless `Options.box` says
            otherwise.
        covariance: (K, 2, 2) covariance of each keypoint in square pixels, or None.
        confidence_midpoint: Confidence at which a point is as likely right as wrong: 0.5 where confidences are
            probabilities. Likelihood peaks of keypoint networks are underconfident; for them 0.1 to 0.3 do alike.
        azimuth: (A,) probability of each direction from the vehicle to the camera: bin a is centred at 2 pi a / A,
            0 ahead of the vehicle, pi / 2 to its left. It decides between poses that explain the keypoints alike. None
            where nobody says.
        left_out: Sentences that say what of it was not used, and why.
        evidence: What is known of the vehicle beside its keypoints (`fgrecon.core.evidence`).
        image_size: Width and height in pixels of the image as the file or the network states them, or None: a camera of
            another size is refused.
    """

    keypoints: NDArray[np.float64]
    confidence: NDArray[np.float64]
    box: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    confidence_midpoint: float = 0.2
    azimuth: NDArray[np.float64] | None = None
    left_out: tuple[str, ...] = ()
    evidence: tuple[Evidence, ...] = ()
    image_size: tuple[int, int] | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check shapes and values; a missing keypoint gets confidence 0.

        Raises:
            InvalidInputError: Wrong shapes, infinite pixels or such as no image has, confidences outside [0, 1], a box
                of no size, a covariance that is not symmetric positive definite, a midpoint outside (0, 1], or
                directions that are no probabilities.
        """
        set_ = object.__setattr__
        keypoints = as_shape("keypoints", self.keypoints, (None, 2))
        missing: NDArray[np.bool_] = np.any(np.isnan(keypoints), axis=1)
        if (np.abs(keypoints) > _LARGEST).any():
            if np.isinf(keypoints).any():
                fix = "Give finite pixels, or NaN where not measured."
                raise InvalidInputError("keypoints", "an infinite pixel", fix)
            _check_size("keypoints", keypoints[~missing])
        confidence = as_shape("confidence", self.confidence, (len(keypoints),))
        wrong = ~(((confidence >= 0) & (confidence <= 1)) | missing)
        if wrong.any():
            raise InvalidInputError("confidence", float(confidence[wrong][0]), "Give numbers from 0 to 1.")
        midpoint = float(
            as_finite("confidence_midpoint", self.confidence_midpoint, (), "Give a number above 0, up to 1.")
        )
        if not 1e-6 <= midpoint <= 1.0:
            raise InvalidInputError("confidence_midpoint", midpoint, "Give a number above 0, up to 1.")
        set_(self, "confidence_midpoint", midpoint)
        set_(self, "keypoints", own(np.where(missing[:, None], np.nan, keypoints)))
        set_(self, "confidence", own(np.where(missing, 0.0, confidence)))
        if self.box is not None:
            box = as_finite("box", self.box, (4,), CORNERS)
            check_corners("box", box, least=1.0)
            _check_size("box", box)
            set_(self, "box", own(box))
        if self.covariance is not None:
            covariance = as_shape("covariance", self.covariance, (len(keypoints), 2, 2))
            _check_covariances(covariance[~missing])
            symmetric = (covariance + covariance.swapaxes(1, 2)) / 2.0  # J S J' need not be, to the last digit
            set_(self, "covariance", own(np.where(missing[:, None, None], np.eye(2), symmetric)))
        if self.azimuth is not None:
            set_(self, "azimuth", as_directions("azimuth", self.azimuth))
        if self.evidence:
            set_(self, "evidence", as_evidence(self.evidence))

    @classmethod
    def of(
        cls,
        keypoints: ArrayLike,
        confidence: ArrayLike | None = None,
        box: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        confidence_midpoint: float | None = None,
        azimuth: ArrayLike | None = None,
    ) -> Observation:
        """An observation of which not everything is known.

        Without confidences each point is as likely right as wrong, which visibility and residuals then settle; without
        their midpoint it is the class's.

        Raises:
            InvalidInputError: As the constructor.
        """
        midpoint = cls.confidence_midpoint if confidence_midpoint is None else confidence_midpoint
        pixels = as_shape("keypoints", keypoints, (None, 2))
        trust = np.full(len(pixels), midpoint) if confidence is None else confidence
        given: Any = trust, box, covariance, midpoint, azimuth  # of which the constructor makes arrays
        return cls(pixels, *given)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(K,) whether a keypoint has a measurement."""
        return np.isfinite(self.keypoints[:, 0])

    def of_at_least(self, confidence: float) -> Observation:
        """The observation whose keypoints of less confidence count as not measured."""
        low = self.confidence < confidence
        return replace(self, keypoints=np.where(low[:, None], np.nan, self.keypoints)) if low.any() else self

    def without(self, keypoints: NDArray[np.bool_], names: Sequence[str], why: str) -> Observation:
        """The observation without some of its keypoints (K,), and the reason beside their names."""
        if not keypoints.any():
            return self
        listed = ", ".join(name for name, out in zip(names, keypoints, strict=True) if out)
        left_out = (*self.left_out, f"{listed}: left out, {why}.")
        return replace(self, keypoints=np.where(keypoints[:, None], np.nan, self.keypoints), left_out=left_out)

    def renamed(self, other: NDArray[np.intp]) -> Observation:
        """The observation with each keypoint where another one (K,) was, by index; not measured where that is -1."""
        there, index, covariance = other >= 0, np.maximum(other, 0), self.covariance
        return replace(
            self,
            keypoints=np.where(there[:, None], self.keypoints[index], np.nan),
            confidence=np.where(there, self.confidence[index], 0.0),
            covariance=None if covariance is None else covariance[index],
        )

    def scaled(self, ratio: NDArray[np.float64], size: tuple[int, int]) -> Observation:
        """The same in pixels of an image of another size, whose sides are longer by the ratio (2,)."""
        return replace(self, **scaled_pixels(self.keypoints, self.box, self.covariance, ratio), image_size=size)

    def with_evidence(self, evidence: Sequence[Evidence]) -> Observation:
        """The observation with more evidence of its vehicle."""
        if not evidence:
            return self
        other = copy(self)  # all else is checked
        object.__setattr__(other, "evidence", as_evidence((*self.evidence, *evidence)))
        return other

    def with_directions(self, azimuth: NDArray[np.float64]) -> Observation:
        """The observation with other directions (A,)."""
        other = copy(self)  # all else is checked
        object.__setattr__(other, "azimuth", as_directions("azimuth", azimuth))
        return other

    def undistorted(self, camera: Camera, names: Sequence[str]) -> Observation:
        """The observation freed of lens distortion.

        A keypoint where no ray of such a lens arrives is not measured, and a box with such a side is none: `left_out`
        says so. A side goes where its middle goes: a vehicle is nearer to it there than at the box's corners (error of
        the lower side of a car's box with a lens of k1 = -0.3: 1.1 % of its height in the median, by corners 3.4 %).

        Args:
            camera: The camera that took the image.
            names: Of the keypoints.

        Raises:
            InvalidInputError: The distortion cannot be undone at half of the measured keypoints.
        """
        if camera.distortion is None:
            return self
        box, left_out = self.box, self.left_out
        if box is not None:
            middle = (box[:2] + box[2:]) / 2.0
            sides, returns = camera.ideal_pixels(
                np.array([[box[0], middle[1]], [middle[0], box[1]], [box[2], middle[1]], [middle[0], box[3]]])
            )
            box = np.array([sides[0, 0], sides[1, 1], sides[2, 0], sides[3, 1]])
            if not returns.all() or (box[2:] - box[:2]).min() < 1.0:
                box = None
                left_out = (*left_out, "2D box: left out, the lens distortion cannot be undone at its sides.")
        keypoints, returns = camera.ideal_pixels(self.keypoints)
        lost = self.measured & ~returns
        left = keypoints[self.measured & ~lost]
        gone = bool(lost.any()) and len(left) < max(_FEWEST, int(np.count_nonzero(lost)))
        spread = float(np.ptp(self.keypoints[self.measured], axis=0).max()) if len(left) > 1 else 0.0
        if gone or (spread >= 1.0 > float(np.ptp(left, axis=0).max())):
            fix = "Give coefficients of this camera: they cannot be undone at the keypoints."
            if camera.distortion_model != OPENCV:
                fix = f"Leave out what is more than {WIDEST_DEGREES:.0f} degrees from the camera's axis."
            raise InvalidInputError("distortion", np.asarray(camera.distortion).tolist(), fix)
        known = None if self.covariance is None else _stretched(self.covariance, self.keypoints, camera)
        spots = np.where(lost[:, None], self.keypoints, keypoints)
        ideal = replace(self, keypoints=spots, covariance=known, box=box, left_out=left_out)
        return ideal.without(lost, names, "the lens distortion cannot be undone there")

    @property
    def right(self) -> NDArray[np.float64]:
        """(K,) probability that a point is visible and right, by its confidence c: c^2 / (c^2 + midpoint^2)."""
        squared = self.confidence**2
        return squared / (squared + self.confidence_midpoint**2)

    @property
    def place(self) -> NDArray[np.float64] | None:
        """(4,) the box, or that around the measured keypoints; None where neither is there."""
        if self.box is not None:
            return self.box
        points = self.keypoints[self.measured]
        if len(points) < 2 or np.ptp(points, axis=0).min() < 1.0:
            return None
        return np.concatenate([points.min(axis=0), points.max(axis=0)])

    @property
    def extent(self) -> float:
        """max(h, w) of the box in pixels, or of the measured keypoints of any confidence where no box is given."""
        if self.box is not None:
            return float(max(self.box[2] - self.box[0], self.box[3] - self.box[1]))
        points = self.keypoints[self.measured & (self.confidence > 0.0)]
        return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


KeypointsLike = Observation | Mapping[str, ArrayLike] | ArrayLike
"""Keypoints of a vehicle: an observation; (u, v) or (u, v, confidence) by name; or pixels (K, 2), NaN for not found."""


def scaled_pixels(
    keypoints: NDArray[np.float64],
    box: NDArray[np.float64] | None,
    covariance: NDArray[np.float64] | None,
    ratio: NDArray[np.float64],
) -> dict[str, Any]:
    """Keypoints (K, 2), box (4,) and covariances (K, 2, 2), by name, where the sides are longer by a ratio (2,)."""
    return {
        "keypoints": (keypoints + 0.5) * ratio - 0.5,
        "box": None if box is None else box * np.tile(ratio, 2),
        "covariance": None if covariance is None else covariance * np.outer(ratio, ratio),
    }


def _stretched(covariance: NDArray[np.float64], pixels: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(K, 2, 2) covariances about pixels (K, 2) of a camera, as they are where its lens is undone."""
    half = np.eye(2) / 2.0
    change = np.stack([camera.undistort(pixels + step) - camera.undistort(pixels - step) for step in half], axis=-1)
    change = np.where(np.abs(change).max(axis=(1, 2), keepdims=True) < _STEEP, change, np.eye(2))  # not where NaN
    return change @ covariance @ change.swapaxes(1, 2)


def as_directions(field: str, azimuth: ArrayLike) -> NDArray[np.float64]:
    """(A,) probabilities of directions, to keep.

    Raises:
        InvalidInputError: They are no probabilities, or their sum is not 1; names the field.
    """
    probability = as_finite(field, azimuth, (None,))
    if not len(probability) or (probability < 0).any() or abs(probability.sum() - 1.0) > _SUM:
        fix = "Give a probability for each direction, with the sum 1."
        raise InvalidInputError(field, f"numbers of sum {probability.sum():g}", fix)
    return own(probability)


def _check_size(field: str, pixels: NDArray[np.float64]) -> None:
    largest = float(np.abs(pixels).max(initial=0.0))
    if largest > _LARGEST:
        raise InvalidInputError(field, largest, f"Give pixels of an image, at most {_LARGEST:g}.")


def _check_covariances(covariance: NDArray[np.float64]) -> None:
    fix = "Give symmetric positive definite 2x2 matrices in square pixels."
    if not np.isfinite(covariance).all():
        raise InvalidInputError("covariance", "NaN or infinite", fix)
    _check_size("covariance", np.sqrt(np.abs(covariance)))
    if covariance.size and (
        np.abs(covariance[:, 0, 1] - covariance[:, 1, 0]).max() > 1e-6 * np.abs(covariance).max()
        or np.linalg.eigvalsh(covariance).min() <= 0
    ):
        raise InvalidInputError("covariance", "not symmetric positive definite", fix)
