"""A depth for each pixel of an image: measured, or as a network gives it up to scale, or scale and shift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_either, as_finite, as_shape, own
from fgrecon.core.choices import DepthScale
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.repr import brief_repr
from fgrecon.core.settings import one_of

_FARTHEST, _NEAREST = 300.0, 0.5  # metres: the median depth of no image with vehicles is larger or smaller
_LARGEST_RELATIVE = 1.0
_LEAST_SIGMA = 1e-9  # of shares and shared errors that are not none: squares of much less are 0 in doubles
_LEAST_MEASURED = 20  # pixels of which the median tells the unit
_MIDDLE = 0.25  # of a 2D box's sides, from its middle
_ALIKE, _LEAST_ALIKE = 2.0, 0.05  # times as far or near, within which a pixel may be the vehicle's; share that is so
_SIDE_M, _TOO_FAR = 1.5, 3.3  # of a vehicle's outline, the smaller; times as far as by it, as no vehicle is
_ROUNDING = 1e-9  # share of the largest number of a covariance that is rounding


@dataclass(frozen=True, eq=False)
class DepthCalibration:
    """What the numbers of a depth map are in metres: scale times the number, plus the shift, is the (inverse) depth.

    Attributes:
        scale: Metres, or 1 / metres of an inverse depth, for each unit of the map.
        shift: Metres, or 1 / metres.
        covariance: (2, 2) of both; zero where they are exact.
    """

    scale: float = 1.0
    shift: float = 0.0
    covariance: ArrayLike = ((0.0, 0.0), (0.0, 0.0))

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: The scale is not positive, or the covariance is none.
        """
        scale, shift = (float(as_finite(f"calibration.{n}", getattr(self, n), ())) for n in ("scale", "shift"))
        if scale <= 0.0:
            raise InvalidInputError("calibration.scale", scale, "Give a positive number.")
        matrix = as_finite("calibration.covariance", self.covariance, (2, 2))
        if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix).min() < -_ROUNDING * np.abs(matrix).max():
            raise InvalidInputError("calibration.covariance", matrix.tolist(), "Give a symmetric, positive one.")
        object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "shift", shift)
        object.__setattr__(self, "covariance", own(matrix))


@dataclass(frozen=True, eq=False)
class DepthMap:
    """The depth of each pixel of the image, along the camera's z axis.

    Which pixels are a vehicle's is decided in its graph. A pixel is unsure along its ray, and hardly across it; what
    all pixels have wrong together, as scale and shift, are variables that all vehicles of the image share.

    Attributes:
        depth: (H, W) as large as the image, an array or a tensor. NaN where nothing was measured; 0 as well, unless it
            is an inverse depth or has a shift.
        sigma: Standard deviation of a pixel in the map's unit, one, or (H, W) of those that were measured; 0 where
            `relative_sigma` says all.
        relative_sigma: The same as a share of the depth, added in quadrature.
        scale: Whether the numbers are metres, or scale, or scale and shift, are to be found.
        inverse: Whether the numbers are inverse depths (1 / metres), as of disparities and many networks.
        shared_sigma: Standard deviation of an error of the inverse depth that all pixels have in common, 1 / metres.
        shared_mean: What of that error is known, 1 / metres; it is added to the inverse depth.
        sensor: Name of the sensor of a map in metres, if that error is its constant: a `Tracker` learns it over time.
            Empty where each map has its own.
        calibration: Scale and shift where they are known, such as from the frame before; takes the place of `scale`.
        corner: Row and column of the image's pixel that is the first of a map of a part of it (`part`).
    """

    depth: NDArray[np.float64]
    sigma: float | NDArray[np.float64] = 0.0
    relative_sigma: float = 0.05
    scale: DepthScale = DepthScale.METRIC
    inverse: bool = False
    shared_sigma: float = 0.0
    shared_mean: float = 0.0
    sensor: str = ""
    calibration: DepthCalibration | None = None
    corner: tuple[int, int] = (0, 0)

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: They are no depths of this kind, or a standard deviation is none.
        """
        set_ = object.__setattr__
        depth = as_shape("depth", self.depth, (None, None), "Give (H, W), a number for each pixel.")
        set_(self, "scale", one_of(DepthScale, "depth.scale", self.scale))
        shifted = self.inverse or self.scale is DepthScale.SCALE_AND_SHIFT
        valid = np.isfinite(depth) & (True if shifted else depth > 0.0)
        set_(self, "depth", own(np.where(valid, depth, np.nan)))
        sigma = as_either("depth.sigma", self.sigma, [(), depth.shape], "Give one, or one for each pixel.")
        if not (sigma[valid if sigma.ndim else ...] >= 0.0).all():
            fix = "Give standard deviations, one for each pixel that was measured."
            raise InvalidInputError("depth.sigma", float(np.min(sigma)), fix)
        set_(self, "sigma", float(sigma) if sigma.ndim == 0 else own(sigma))
        for name, largest in (("relative_sigma", _LARGEST_RELATIVE), ("shared_sigma", 1.0)):
            value = float(as_finite(f"depth.{name}", getattr(self, name), ()))
            if value != 0.0 and not _LEAST_SIGMA <= value <= largest:
                raise InvalidInputError(f"depth.{name}", value, f"Give 0, or {_LEAST_SIGMA:g} to {largest:g}.")
            set_(self, name, value)
        set_(self, "shared_mean", float(as_finite("depth.shared_mean", self.shared_mean, ())))
        if not isinstance(self.sensor, str):
            raise InvalidInputError("depth.sensor", self.sensor, "Give a name, or an empty text.")
        if not np.any(self.sigma) and self.relative_sigma == 0.0:
            raise InvalidInputError("depth.sigma", 0.0, "Give a standard deviation, or a relative one.")
        if self.scale is DepthScale.METRIC and self.calibration is None:
            self._check_metres()

    def _check_metres(self) -> None:
        with np.errstate(divide="ignore"):
            metres = 1.0 / self.depth if self.inverse else self.depth
        measured = metres[np.isfinite(metres) & (metres > 0.0)]
        if len(measured) < _LEAST_MEASURED:
            return
        median = float(np.median(measured))
        if median > _FARTHEST or median < _NEAREST:
            fix = "Give metres, or say by `scale=` (scale, scale_and_shift) or `inverse=` what the numbers are."
            raise InvalidInputError("depth", f"a median depth of {median:.3g} m", fix)

    @property
    def known(self) -> DepthCalibration | None:
        """Scale and shift; None where they are to be found."""
        if self.calibration is None and self.scale is DepthScale.METRIC:
            return DepthCalibration()
        return self.calibration

    def part(self, rows: slice, columns: slice) -> DepthMap:
        """The part of a whole map in some rows and columns, in an array of its own; its calibration must be known."""
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[rows, columns]
        corner = rows.start, columns.start
        return replace(self, depth=self.depth[rows, columns], sigma=sigma, calibration=self.known, corner=corner)

    def at(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
        """Numbers of the map (M,) at pixels of the image."""
        return self.depth[row - self.corner[0], column - self.corner[1]]

    def metres(self, numbers: Array, calibration: DepthCalibration) -> Array:
        """Depths of numbers of the map in metres; NaN of what is nowhere before the camera."""
        found, mean = calibration.scale * numbers + calibration.shift, self.shared_mean
        above, below = (np.ones_like(found), found + mean) if self.inverse else (found, 1.0 + mean * found)
        return np.asarray(above / np.where((above > 0.0) & (below > 0.0), below, np.nan))

    def times_too_far(self, box: NDArray[np.float64], metres: float) -> float | None:
        """How many times as far as a vehicle the pixels of a map in metres are; None where they may be its.

        Args:
            box: (4,) 2D box of the vehicle, pixels.
            metres: Its depth.
        """
        known = self.known
        if known is None or (known.scale, known.shift) != (1.0, 0.0) or np.any(known.covariance):
            return None
        middle = middle_of(box)
        first, size = np.array(self.corner[::-1]), np.array(self.depth.shape[::-1])
        low, high = (np.clip(at - first, 0, size).astype(int) for at in (middle[:2], middle[2:] + 1.0))
        found = self.metres(self.depth[low[1] : high[1], low[0] : high[0]], known)
        ratio = found[np.isfinite(found)] / metres
        if len(ratio) < _LEAST_MEASURED or (np.abs(np.log(ratio)) < np.log(_ALIKE)).mean() >= _LEAST_ALIKE:
            return None
        return float(np.median(ratio))

    def check_vehicles(self, boxes: Sequence[NDArray[np.float64]], camera: Camera, field: str) -> None:
        """Refuse a map in metres by which vehicles would be larger than any are.

        Args:
            boxes: (4,) 2D box of each, pixels.
            camera: The camera.
            field: What an error calls the map.

        Raises:
            InvalidInputError: Most of them would be.
        """
        usual = (float((_SIDE_M * camera.matrix.diagonal()[:2] / (box[2:] - box[:2])).max()) for box in boxes)
        found = [self.times_too_far(box, metres) or 1.0 for box, metres in zip(boxes, usual, strict=True)]
        if found and (times := float(np.median(found))) > _TOO_FAR:
            fix = "Give metres: of PNG files 256 units are one unless --depth-per-metre says it; or say `scale=scale`."
            raise InvalidInputError(field, f"depths {times:.2g} times as far as vehicles look", fix)

    def along(self, row: NDArray[np.intp], column: NDArray[np.intp], metres: Array, scale: float) -> Array:
        """Standard deviations (M,) of the depths of pixels in metres, with so many metres to a unit."""
        first = self.corner
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[row - first[0], column - first[1]]
        own_sigma = scale * np.asarray(sigma) * (metres**2 if self.inverse else 1.0)
        return np.asarray(np.hypot(own_sigma, self.relative_sigma * metres))


def middle_of(box: NDArray[np.float64]) -> Array:
    """(4,) the middle of a 2D box (4,): pixels that are surely its vehicle's, or of what hides it."""
    middle, reach = (box[:2] + box[2:]) / 2.0, _MIDDLE * (box[2:] - box[:2])
    return np.concatenate([middle - reach, middle + reach])


def pixel_rays(row: NDArray[np.intp], column: NDArray[np.intp], camera: Camera) -> Array:
    """Directions (M, 3) with z = 1 in which a camera sees the pixels of an image; NaN where no ray arrives."""
    return camera.rays(camera.undistort(np.stack([column, row], axis=1)))
