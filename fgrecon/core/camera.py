"""Pinhole camera with an optional lens (OpenCV's or a fisheye), and the ground plane seen from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import unit_vector
from fgrecon.core import lens
from fgrecon.core.checks import as_either, as_finite, as_vectors, own
from fgrecon.core.errors import InvalidInputError

DEFAULT_FIELD_OF_VIEW = 60.0
"""Horizontal field of view in degrees where nothing is known about the camera: distances are then rough."""

ANY_FOCAL_SIGMA = 0.5
"""Standard deviation of the focal length's logarithm there: 95 % of such cameras see 24 to 114 degrees."""

MIN_DEPTH = 0.3
"""Nothing may be nearer to the camera than this, metres; `factors.projection` has the depths of its own barrier."""

CUT_OFF = 0.03  # share of rows or columns that an image may have lost: KITTI's are cropped by a few
_LARGEST_SIGMA = 2.0  # of a focal length's logarithm: five times longer or shorter is no lens any more
_SIZE = "Give width and height in whole pixels."
_NARROWEST, _FARTHEST = 1e-9, 1e6  # metres, radians: what a ground is known to, and how high a camera is at most
_ANY_TILT = 0.3  # radians (1 sigma)
_HIGHEST = 100.0  # metres, of a camera as somebody tells it: more are millimetres or centimetres
_HEIGHT = f"Give the camera's height above the ground in metres, at most {_HIGHEST:g} and above 0."
_SAME_PIXEL, _LARGEST_IDEAL = 1.0, 1e7  # pixels: where a distortion counts as undone, and what is far from any image
_LARGEST = 1e9
"""No focal length is longer, in pixels; beyond, squares of numbers soon overflow."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera: pixel = K [x/z, y/z, 1], pixel centres at integer coordinates.

    Attributes:
        matrix: (3, 3) upper triangular intrinsics K with last row (0, 0, 1); a skew is allowed.
        distortion: OpenCV distortion coefficients (4, 5, 8, 12 or 14 numbers), those of another lens, or None.
        image_size: (width, height) in pixels where known, else None.
        focal_sigma: Standard deviation of the focal lengths' logarithm, about their relative error; 0 where they are
            known. `fgrecon.reconstruct_scene` and `fgrecon.reconstruct_image` find them where they are not.
        cropped_from_larger: Whether the image is a part of one (`cropped`): the principal point may be anywhere.
        distortion_model: What the coefficients are of: `opencv`, or a fisheye of `fgrecon.core.lens`.
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64] | None = None
    image_size: tuple[int, int] | None = None
    focal_sigma: float = 0.0
    cropped_from_larger: bool = False
    distortion_model: str = lens.OPENCV

    def __post_init__(self) -> None:
        """Check the matrix and the coefficients.

        Raises:
            InvalidInputError: The matrix is singular or not upper triangular, or the number of coefficients is wrong.
        """
        fix = "Give the 3x3 camera matrix K; of fx, fy, cx, cy: Camera.of((fx, fy, cx, cy))."
        matrix = as_finite("intrinsics", self.matrix, (3, 3), fix)
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise InvalidInputError("intrinsics", matrix.diagonal()[:2].tolist(), "Give positive focal lengths fx, fy.")
        if np.abs(matrix).max() > _LARGEST or min(matrix[0, 0], matrix[1, 1]) < 1.0 / _LARGEST:
            raise InvalidInputError(
                "intrinsics", matrix.tolist(), f"Give pixels, from {1 / _LARGEST:g} to {_LARGEST:g}."
            )
        if matrix[1, 0] != 0 or matrix[2].tolist() != [0.0, 0.0, 1.0]:
            raise InvalidInputError("intrinsics", matrix.tolist(), "Give [[fx, s, cx], [0, fy, cy], [0, 0, 1]].")
        object.__setattr__(self, "matrix", own(matrix))
        object.__setattr__(self, "distortion", _coefficients(self.distortion, self.distortion_model))
        if self.image_size is not None:
            object.__setattr__(self, "image_size", _image_size(self.image_size))
        fix = f"Give a number from 0 to {_LARGEST_SIGMA:g}."
        sigma = float(as_finite("focal_sigma", self.focal_sigma, (), fix))
        if not 0.0 <= sigma <= _LARGEST_SIGMA:
            raise InvalidInputError("focal_sigma", sigma, fix)
        object.__setattr__(self, "focal_sigma", sigma)

    @classmethod
    def of(cls, intrinsics: Camera | ArrayLike, distortion: ArrayLike | None = None) -> Camera:
        """A camera from K (3, 3), from (fx, fy, cx, cy), or unchanged where it is one already.

        A distortion given beside a camera takes the place of the camera's own.

        Raises:
            InvalidInputError: The intrinsics are neither.
        """
        coefficients = None if distortion is None else as_finite("distortion", distortion, (None,))
        if isinstance(intrinsics, Camera):
            return intrinsics if coefficients is None else intrinsics.with_distortion(coefficients)
        fix = "Give the 3x3 camera matrix K, or fx, fy, cx, cy."
        numbers = as_either("intrinsics", intrinsics, ((3, 3), (4,)), fix)
        if numbers.shape == (4,):
            fx, fy, cx, cy = as_finite("intrinsics", numbers, (4,))
            return cls(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), coefficients)
        return cls(numbers, coefficients)

    @classmethod
    def of_field_of_view(cls, width: int, height: int, degrees: float = DEFAULT_FIELD_OF_VIEW) -> Camera:
        """A camera that looks straight at the middle of its image: what to assume where nothing is known.

        Args:
            width: Of the image, pixels.
            height: Of the image, pixels.
            degrees: Horizontal field of view.

        Raises:
            InvalidInputError: The image has no pixels, or the angle is not between 0 and 180 degrees.
        """
        width, height = _image_size((width, height))
        fix = "Give degrees above 0 and below 180."
        angle = float(as_finite("field_of_view", degrees, (), fix))
        if not 0.0 < angle < 180.0:
            raise InvalidInputError("field_of_view", angle, fix)
        focal = width / 2 / np.tan(np.radians(angle) / 2)
        return replace(cls.of([focal, focal, (width - 1) / 2, (height - 1) / 2]), image_size=(width, height))

    @classmethod
    def of_unknown(cls, width: int, height: int) -> Camera:
        """A camera whose focal length is to be found, and whose principal point is the middle of its image.

        Args:
            width: Of the image, pixels.
            height: Of the image, pixels.

        Raises:
            InvalidInputError: The image has no pixels.
        """
        return replace(cls.of_field_of_view(width, height), focal_sigma=ANY_FOCAL_SIGMA)

    def with_distortion(self, coefficients: ArrayLike | None) -> Camera:
        """The camera with OpenCV's coefficients instead of its lens; None for a pinhole.

        Raises:
            InvalidInputError: The number of coefficients is wrong.
        """
        numbers = None if coefficients is None else as_finite("distortion", coefficients, (None,))
        return replace(self, distortion=numbers, distortion_model=lens.OPENCV)

    @property
    def lens_fields(self) -> dict[str, Any]:
        """Its lens as JSON has it: `distortion`, and `distortion_model` where it is a fisheye; empty for a pinhole."""
        fields = {} if self.distortion is None else {"distortion": self.distortion.tolist()}
        return fields if self.distortion_model == lens.OPENCV else {**fields, "distortion_model": self.distortion_model}

    def with_size_of(self, image: NDArray[Any]) -> Camera:
        """The camera with the size of an image (H, W, ...) that it took.

        Raises:
            InvalidInputError: It is known to take images of another size; some rows and columns may be cut off.
        """
        size = image.shape[1], image.shape[0]
        if self.image_size is not None and np.abs(np.divide(size, self.image_size) - 1.0).max() > CUT_OFF:
            known = f"{self.image_size[0]} x {self.image_size[1]}"
            fix = (
                f"Give a calibration for that size: this one is for {known} pixels. Of a part of an image say which "
                "(Camera.cropped, --crop); of one made smaller or larger the camera is Camera.resized."
            )
            raise InvalidInputError("image", f"{size[0]} x {size[1]} pixels", fix)
        return replace(self, image_size=size)

    def scaled(self, ratio: float) -> Camera:
        """The camera with focal lengths (and skew) that many times as long, for an image of the same size.

        Raises:
            InvalidInputError: It is no positive number.
        """
        fix = "Give a positive number."
        factor = float(as_finite("ratio", ratio, (), fix))
        if not factor > 0.0:
            raise InvalidInputError("ratio", factor, fix)
        matrix = self.matrix.copy()
        matrix[:2, :2] *= factor
        return replace(self, matrix=matrix)

    def cropped(self, left: float, top: float, width: int | None = None, height: int | None = None) -> Camera:
        """The camera of a part of its image, whose pixels are counted from the part's own corner.

        Args:
            left: Columns that were cut off at the left.
            top: Rows that were cut off at the top.
            width: Of the part, pixels; None where nobody says.
            height: Of the part, pixels.

        Raises:
            InvalidInputError: The part is not inside an image of known size, or a number is none.
        """
        fix = "Give the column and the row of the part's corner."
        corner = np.array([as_finite("crop", number, (), fix) for number in (left, top)])
        size = None if width is None or height is None else _image_size((width, height))
        if self.image_size is not None:
            room = np.array(self.image_size) - corner - (0 if size is None else np.array(size))
            if np.any(corner < 0) or np.any(room < 0):
                part = [*corner.tolist(), *(size or ())]
                raise InvalidInputError("crop", part, "Give a part of the image of {} x {}.".format(*self.image_size))
        matrix = self.matrix.copy()
        matrix[:2, 2] -= corner
        return replace(self, matrix=matrix, image_size=size, cropped_from_larger=True)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of its whole image made smaller or larger, whose corners stay corners.

        Args:
            width: Of the new image, pixels.
            height: Likewise.

        Raises:
            InvalidInputError: The size of its own image is not known, or the new one is none.
        """
        size = _image_size((width, height))
        if self.image_size is None:
            raise InvalidInputError("image_size", None, "Give a camera that knows the size of its own image.")
        ratio = np.divide(size, self.image_size)
        matrix = self.matrix.copy()
        matrix[:2] *= ratio[:, None]
        matrix[:2, 2] += 0.5 * ratio - 0.5  # pixel centres are at whole numbers
        return replace(self, matrix=matrix, image_size=size)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Pixels (..., 2) of points (..., 3) in the camera frame, without distortion.

        Raises:
            InvalidInputError: They are no such numbers.
        """
        homogeneous = as_vectors("points", points, 3) @ self.matrix.T
        return homogeneous[..., :2] / homogeneous[..., 2:]

    def rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Directions (..., 3) with z = 1 of undistorted pixels (..., 2).

        Raises:
            InvalidInputError: They are no such numbers.
        """
        return self._rays(as_vectors("pixels", pixels, 2))

    def _rays(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        homogeneous = np.ones((*pixels.shape[:-1], 3))
        homogeneous[..., :2] = pixels
        return homogeneous @ self._inverse.T

    def _of_plane(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, 2) pixels of points (M, 2) at z = 1."""
        return points @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    @cached_property
    def _inverse(self) -> NDArray[np.float64]:
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)

    def undistort(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Pixels (M, 2) as the ideal pinhole camera with the same K sees them; NaN rows stay NaN.

        Of a fisheye what is more than `lens.WIDEST_DEGREES` to the side is NaN too.

        Raises:
            InvalidInputError: They are no such numbers.
        """
        return self._undistorted(as_vectors("pixels", pixels, 2))

    def _undistorted(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        pixels = pixels.copy()
        if self.distortion is None or not len(pixels):
            return pixels
        if self.distortion_model != lens.OPENCV:
            return self._of_plane(lens.ahead(self.distortion_model, self.distortion, self._rays(pixels)[:, :2]))
        import cv2  # on use: importing fgrecon must not import OpenCV

        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        measured = np.isfinite(pixels).all(axis=1)
        if measured.any():
            ideal: Any = cv2.undistortPoints(
                pixels[measured][:, None], self.matrix, self.distortion, P=self.matrix, criteria=criteria
            )
            pixels[measured] = ideal[:, 0]
        return pixels

    def distort(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """The reverse of `undistort`: where the real camera images ideal pixels (M, 2).

        Raises:
            InvalidInputError: They are no such numbers.
        """
        return self._distorted(as_vectors("pixels", pixels, 2))

    def _distorted(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        pixels = pixels.copy()
        if self.distortion is None or not len(pixels):
            return pixels
        if self.distortion_model != lens.OPENCV:
            return self._of_plane(lens.imaged(self.distortion_model, self.distortion, self._rays(pixels)[:, :2]))
        import cv2

        zero = np.zeros(3)
        projected: Any = cv2.projectPoints(self._rays(pixels), zero, zero, self.matrix, self.distortion)[0]
        pixels[:] = projected[:, 0]
        return pixels

    def ideal_pixels(self, pixels: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Pixels (M, 2) freed of distortion, and which of them (M,) the lens images where they came from.

        Far outside of the image a polynomial of the distortion turns back, and no ray arrives there.
        """
        ideal = self._undistorted(pixels)
        returns = np.asarray((np.abs(ideal) < _LARGEST_IDEAL).all(axis=1))  # not NaN
        off = np.abs(self._distorted(ideal[returns]) - pixels[returns])
        returns[returns] = off.max(axis=1) < _SAME_PIXEL
        return ideal, returns


def lens_of(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a camera's lens, by what `Camera.lens_fields` made of them; both may be absent or None."""
    return {
        "distortion": fields.get("distortion"),
        "distortion_model": fields.get("distortion_model") or lens.OPENCV,
    }


def _coefficients(given: ArrayLike | None, model: str) -> NDArray[np.float64] | None:
    """A lens's coefficients; None for a pinhole."""
    if model not in lens.COUNTS:
        raise InvalidInputError("distortion_model", model, f"Give one of: {', '.join(lens.COUNTS)}.")
    if given is None and model == lens.OPENCV:
        return None
    coefficients = as_finite("distortion", [] if given is None else given, (None,))
    counts = lens.COUNTS[model]
    if len(coefficients) not in counts:
        listed = "4, 5, 8, 12 or 14 (OpenCV's order)" if model == lens.OPENCV else f"{counts[0]} of {model}"
        raise InvalidInputError("distortion", f"{len(coefficients)} coefficients", f"Give {listed}.")
    return own(coefficients) if coefficients.any() or model != lens.OPENCV else None


def _image_size(given: object) -> tuple[int, int]:
    width, height = as_finite("image_size", given, (2,), _SIZE).tolist()  # type: ignore[arg-type]
    if not (width == round(width) > 0 and height == round(height) > 0):
        raise InvalidInputError("image_size", (width, height), _SIZE)
    return int(width), int(height)


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground plane in the camera frame: points with normal . x = distance.

    Attributes:
        normal: (3,) unit vector pointing down, into the ground.
        distance: Height of the camera above the ground, metres.
        height_sigma: How far a vehicle's origin may be off the plane near the camera (1 sigma, metres).
        slope_sigma: Uncertainty of the plane's slope (1 sigma, radians): at depth z the origin may be
            hypot(height_sigma, slope_sigma z) off the plane. The defaults are those of KITTI's labelled cars about a
            level plane 1.65 m below the camera.
        tilt_sigma: How far its down axis may lean from the normal (1 sigma, radians).
    """

    normal: NDArray[np.float64]
    distance: float
    height_sigma: float = 0.1
    slope_sigma: float = 0.0125
    tilt_sigma: float = 0.03

    def __post_init__(self) -> None:
        """Check and normalise the plane.

        Raises:
            InvalidInputError: The normal has no length or points up, or a number is not positive.
        """
        normal = as_finite("ground.normal", self.normal, (3,))
        unit = unit_vector("ground.normal", normal)
        if unit[1] <= 0:
            raise InvalidInputError("ground.normal", normal.tolist(), "Let the normal point down (positive y).")
        object.__setattr__(self, "normal", own(unit))
        for field in ("distance", "height_sigma", "slope_sigma", "tilt_sigma"):
            value = float(as_finite(f"ground.{field}", getattr(self, field), (), "Give a positive number."))
            if not _NARROWEST <= value <= _FARTHEST:
                fix = _HEIGHT if field == "distance" else f"Give a number from {_NARROWEST:g} to {_FARTHEST:g}."
                raise InvalidInputError(f"ground.{field}", value, fix)

    @cached_property
    def upright(self) -> NDArray[np.float64]:
        """(3, 3) smallest rotation that turns the camera's y axis onto the normal."""
        x, cosine, z = self.normal
        skew = np.array([[0.0, x, 0.0], [-x, 0.0, -z], [0.0, z, 0.0]])  # of the axis (z, 0, -x) = y x normal
        rotation: NDArray[np.float64] = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
        return own(rotation)

    def height_sigma_at(self, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation in metres of an origin's height over the plane at depths (...,) in metres."""
        return np.hypot(self.height_sigma, self.slope_sigma * depth)

    def height_sigma_at_depth(self, depth: float) -> float:
        """The same at one depth."""
        return math.hypot(self.height_sigma, self.slope_sigma * depth)

    def as_given(self) -> Ground:
        """Itself, checked as a plane that is given: an estimate may be wilder.

        Raises:
            InvalidInputError: The camera is higher than any that looks at vehicles.
        """
        if self.distance > _HIGHEST:
            raise InvalidInputError("ground.distance", self.distance, _HEIGHT)
        return self

    @classmethod
    def of_height(cls, camera_height: float) -> Ground:
        """The ground under a camera at a height in metres that may look down or up and be rolled, by 17 degrees or so.

        Vehicles that are solved together tell how it is tilted.

        Raises:
            InvalidInputError: It is not positive, or is more than 100 metres.
        """
        return replace(cls.level(camera_height), slope_sigma=_ANY_TILT, tilt_sigma=_ANY_TILT)

    @property
    def is_vague(self) -> bool:
        """Whether hardly more than the camera's height is known."""
        return self.slope_sigma >= _ANY_TILT

    @classmethod
    def level(cls, camera_height: float) -> Ground:
        """The ground under a level camera at a height in metres (KITTI: 1.65).

        Raises:
            InvalidInputError: It is not positive, or is more than 100 metres.
        """
        return cls(np.array([0.0, 1.0, 0.0]), camera_height).as_given()
