"""What callers give, checked and made ready: the one place for every entry of `solve`, and so for the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.checks import as_finite, as_instance, as_list, as_rigid, as_shape
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.input_warnings import (
    FARTHEST_OUTSIDE,
    InputWarning,
    InputWarnings,
    camera_warning_of,
    input_warning_of,
    result_warning_of,
)
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.options import Options, checked_options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike, check_order, size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.model import VehicleModel, prepare

if TYPE_CHECKING:
    import gtsam

Array = NDArray[np.float64]

_CAMERA_NUMBERS = Real, np.ndarray, list, tuple  # what a matrix, or fx, fy, cx, cy, are made of
_TURN = 2.0 * np.pi + 1e-6  # radians; what is more is in degrees
_ROTATION_TOLERANCE = 1e-4  # of a camera's pose: more digits than that are seldom lost
_JUDGED = 5  # keypoints from which on one is judged by how far it is from the others
_STRAY = 10.0  # times the median of these distances; on KITTI's tracks no keypoint has more than 3.6
_MARKS = [-999.0, -1000.0, -9999.0, 9999.0, 99999.0]  # for u and v of a point that is missing
_WIDEST_RAY = 11.4  # tangent of 85 degrees beside the axis
_ROUNDING = 1e-9  # share of the largest number of a covariance that is rounding


@dataclass(frozen=True)
class SolveSetup:
    """What holds for all vehicles of a call.

    Attributes:
        options: Settings.
        prior: The shape prior as it is given.
        model: The prior prepared for the vehicles' sizes.
        ground: Ground plane, or None.
    """

    options: Options
    prior: ShapePrior
    model: VehicleModel
    ground: Ground | None = None

    @classmethod
    def of(
        cls,
        prior: ShapePrior | str | Path,
        sizes: SizesLike | None,
        options: Options | None,
        ground: Ground | float | None = None,
        *,
        joint: bool = False,
    ) -> SolveSetup:
        """The setup of a call's arguments; see `fgrecon.reconstruct`.

        Args:
            prior: Shape prior, or its name, or the path of its file.
            sizes: Fleet, or a size prior; None takes sizes from the shape prior.
            options: Settings.
            ground: Ground plane, or the height in metres of a level camera.
            joint: Whether pose and shape have to move together.

        Raises:
            InvalidInputError: One of them cannot be used; names it, its value and the fix.
        """
        chosen, loaded = checked_options(options, joint=joint), load_prior(prior)
        fleet = None if sizes is None else size_prior(sizes)
        if fleet is not None:
            check_order("size_prior", fleet.mean, _usual_size(loaded))
        model = prepare(loaded, fleet, chosen.shape.basis_vectors)
        return cls(chosen, loaded, model, as_ground(ground))


def _usual_size(prior: ShapePrior) -> Array:
    """(3,) length, width and height of the prior's mean vehicle, metres."""
    return prior.box_size(np.zeros(prior.dimension))


def observe(
    keypoints: KeypointsLike,
    camera: Camera,
    category: Category,
    options: Options,
    *,
    confidence: ArrayLike | None = None,
    box: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
) -> Observation:
    """The observation that is solved from: checked against the category, and freed of lens distortion.

    Raises:
        InvalidInputError: An array has the wrong shape or values, something is given twice, or the box is outside of
            the image.
    """
    observation = _as_observation(keypoints, category, confidence, box, covariance)
    if observation.box is not None and camera.image_size is not None:
        (left, top, right, bottom), (width, height) = observation.box, camera.image_size
        if right <= -0.5 or bottom <= -0.5 or left >= width - 0.5 or top >= height - 0.5:
            fix = f"Give a box in the image of {width} x {height} pixels."
            raise InvalidInputError("box", observation.box.tolist(), fix)
    if "direction" in options.disabled_terms:
        observation = replace(observation, azimuth=None)  # nor are neighbours or frames of a track to hear of it
    observation = observation.of_at_least(options.keypoints.least_confidence)
    observation = _without_strays(observation, camera, category.keypoints).undistorted(camera, category.keypoints)
    _check_rays(observation, camera)
    return observation


def add_input_warnings(
    doubts: InputWarnings,
    name: str,
    keypoints: KeypointsLike,
    camera: Camera,
    setup: SolveSetup,
    solved: tuple[Observation, Reconstruction] | None = None,
    given: Mapping[str, ArrayLike | None] = MappingProxyType({}),
) -> None:
    """Add what must be wrong with a vehicle's keypoints as they are given, or with their camera, if anything.

    Of what a network detected with the vehicle's direction, whose names of keypoints are its own, only the camera and
    where the result is are doubted.

    Args:
        doubts: What is added to.
        name: What a warning calls the vehicle.
        keypoints: As `observe` takes them.
        camera: The camera.
        setup: What holds for all vehicles of the call.
        solved: What it was solved from, with the result; None without one.
        given: What else `observe` takes; what it refuses is not doubtful.
    """
    detected = isinstance(keypoints, Observation) and keypoints.azimuth is not None
    try:
        every: dict[str, ArrayLike | None] = {"confidence": None, "box": None, "covariance": None, **given}
        observation = _as_observation(keypoints, setup.prior.category, **every)
        doubts.add(name, camera_warning_of(camera) if detected else input_warning_of(observation, camera))
    except FgreconError:
        return
    if solved is not None and not (detected and result_warning_of(*solved) is InputWarning.FIT):
        doubts.add_result(name, *solved)


def _as_observation(
    keypoints: KeypointsLike,
    category: Category,
    confidence: ArrayLike | None,
    box: ArrayLike | None,
    covariance: ArrayLike | None,
) -> Observation:
    if isinstance(keypoints, Mapping):
        keypoints, confidence = _by_name(keypoints, category, confidence)
    fix = (
        f"Give {category.size} rows (u, v) or (u, v, confidence) in the order of category {category.name}; NaN where "
        "not detected."
    )
    if isinstance(keypoints, Observation):
        for field, value in (("confidence", confidence), ("box", box), ("covariance", covariance)):
            if value is not None:
                raise InvalidInputError(field, "given twice", "The observation has it: give it there.")
        as_shape("keypoints", keypoints.keypoints, (category.size, 2), fix)
        return keypoints
    pixels = as_shape("keypoints", keypoints, (category.size, None), fix)
    if pixels.shape[1] not in (2, 3):
        raise InvalidInputError("keypoints", f"shape {pixels.shape}", fix)
    if pixels.shape[1] == 3:
        if confidence is not None:
            fix = "Give it here or as the third number of every keypoint."
            raise InvalidInputError("confidence", "given twice", fix)
        pixels, confidence = pixels[:, :2], np.where(np.isnan(pixels).any(axis=1), 0.0, pixels[:, 2])
    return Observation.of(pixels, confidence, box, covariance)


def _check_rays(observation: Observation, camera: Camera) -> None:
    """Refuse intrinsics of another unit: by them most keypoints are where no pinhole sees.

    Raises:
        InvalidInputError: They are.
    """
    points = observation.keypoints[observation.measured]
    if not len(points):
        return
    aside = float(np.median(np.abs((points - camera.matrix[:2, 2]) / camera.matrix.diagonal()[:2]).max(axis=1)))
    if aside > _WIDEST_RAY:
        degrees = np.degrees(np.arctan(aside))
        fix = "Give K in pixels of this image."
        raise InvalidInputError("intrinsics", f"keypoints {degrees:.1f} degrees beside the camera's axis", fix)


def _without_strays(observation: Observation, camera: Camera, names: Sequence[str]) -> Observation:
    """The observation without keypoints where its vehicle cannot be: whatever their weight, noise goes by the extent.

    These are marks of other programs for what is missing, points far outside of an image of known size, and points
    absurdly far from the others.
    """
    found = observation.without(_marks(observation.keypoints), names, "other programs mark so what is missing")
    if camera.image_size is not None:
        size = np.array(camera.image_size, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            beyond = np.abs(found.keypoints - size / 2.0) > (0.5 + FARTHEST_OUTSIDE) * size
            outside = np.asarray(beyond.any(axis=1))
        if 2 * np.count_nonzero(outside) < np.count_nonzero(found.measured):  # else it is another image
            found = found.without(
                outside, names, f"far outside of the image of {camera.image_size[0]} x {camera.image_size[1]}"
            )
    points = found.keypoints[found.measured]
    if len(points) < _JUDGED:
        return found
    away = np.abs(found.keypoints - np.median(points, axis=0)).max(axis=1)
    with np.errstate(invalid="ignore"):
        far = np.asarray(away > _STRAY * max(float(np.median(away[found.measured])), 1.0))
    return found.without(far, names, "far from all others")


def _marks(pixels: Array) -> NDArray[np.bool_]:
    """(K,) which pixels (K, 2) are numbers that stand for a missing point."""
    return np.asarray(np.isin(pixels, _MARKS).all(axis=1))


def _by_name(
    keypoints: Mapping[str, ArrayLike], category: Category, confidence: ArrayLike | None
) -> tuple[Array, ArrayLike | None]:
    """Pixels (K, 2) in the category's order, NaN where none is given, and confidences from the third numbers."""
    rows = np.full((category.size, 3), np.nan)
    widths = set()
    for name, value in keypoints.items():
        index = category.index(name, "keypoints")
        row = as_shape(f"keypoints.{name}", value, (None,), "Give (u, v) or (u, v, confidence).")
        widths.add(len(row))
        if widths not in ({2}, {3}):
            fix = "Give (u, v) for every keypoint, or (u, v, confidence) for every one."
            raise InvalidInputError(f"keypoints.{name}", f"{len(row)} numbers", fix)
        rows[index, : len(row)] = row
    if widths != {3}:
        return rows[:, :2], confidence
    if confidence is not None:
        raise InvalidInputError("confidence", "given twice", "Give it here or as the third number of every keypoint.")
    return rows[:, :2], np.where(np.isnan(rows[:, 0]), 0.0, rows[:, 2])


def calibrated(field: str, camera: Camera) -> Camera:
    """The camera, for what takes its focal length as exact.

    Raises:
        InvalidInputError: The focal length is not known.
    """
    if camera.focal_sigma:
        fix = "`fgrecon.reconstruct_scene([observation], camera)` finds the focal length; or give one that is known."
        raise InvalidInputError(field, f"focal length known to {100 * camera.focal_sigma:.0f} %", fix)
    return camera


def as_cameras(given: Camera | ArrayLike | Sequence[Camera], count: int) -> list[Camera]:
    """The calibrated camera of each of so many images.

    Raises:
        InvalidInputError: Another number is given, or a focal length is not known.
    """
    each = [given] if isinstance(given, Camera) else as_list("cameras", given)
    if isinstance(given, Camera) or (each and all(isinstance(one, _CAMERA_NUMBERS) for one in each)):
        return [calibrated("cameras", Camera.of(cast("Camera | ArrayLike", given)))] * count
    if len(each) != count:
        raise InvalidInputError("cameras", f"{len(each)} for {count} images", "Give one for each image.")
    cameras = as_list("cameras", each, Camera)
    return [calibrated(f"cameras[{number}]", camera) for number, camera in enumerate(cameras)]


def as_ground(ground: Ground | float | None) -> Ground | None:
    """The plane, or that of a level camera at a height in metres.

    Raises:
        InvalidInputError: It is neither a plane nor a positive number, or the camera is higher than 100 metres.
    """
    if ground is None:
        return None
    if isinstance(ground, Ground):
        return ground.as_given()
    height = float(as_finite("ground", ground, (), "Give a `Ground`, or the camera's height in metres."))
    if height <= 0.0:
        fix = "Give how high the camera is above the ground, as a positive number of metres, such as 1.65."
        raise InvalidInputError("ground", height, fix)
    return _level(height)


@lru_cache(maxsize=16)  # thousands of vehicles stand on one ground
def _level(height: float) -> Ground:
    return Ground.level(height)


def as_initial(initial: Box3D | float | None, prior: ShapePrior) -> Box3D | float | None:
    """Where the pose search is to start as well: a box, or a guess of `rotation_y` in radians.

    Raises:
        InvalidInputError: It is neither, or the box's size is in another order than the prior's.
    """
    if initial is None:
        return None
    if isinstance(initial, Box3D):
        if initial.size is not None:
            check_order("initial.size", initial.size, _usual_size(prior))
        return initial
    yaw = float(as_finite("initial", initial, (), "Give a `Box3D`, or a guess of rotation_y in radians."))
    if abs(yaw) > _TURN:
        raise InvalidInputError(
            "initial", yaw, f"Give rotation_y in radians: {yaw:g} degrees are {np.radians(yaw):.4f}."
        )
    return yaw


def as_extra_factors(given: Sequence[gtsam.NonlinearFactor]) -> Sequence[gtsam.NonlinearFactor]:
    """The caller's own factors.

    Raises:
        InvalidInputError: They are no sequence of factors.
    """
    if isinstance(given, tuple) and not given:
        return given
    import gtsam

    return as_list("extra_factors", given, gtsam.NonlinearFactor)


def as_boxes(boxes: Sequence[Box3D | None], count: int, camera: Camera, prior: ShapePrior) -> list[Box3D | None]:
    """Another detector's 3D box of each of so many vehicles.

    Raises:
        InvalidInputError: Another number of boxes is given, they are of a camera of unknown focal length, or a size is
            in another order than the prior's.
    """
    boxes = as_list("boxes", boxes, Box3D, gaps=True)
    if len(boxes) != count:
        raise InvalidInputError("boxes", f"{len(boxes)} for {count} vehicles", "Give a box, or None, for each.")
    if camera.focal_sigma:
        fix = "Give the focal length that the boxes were found with."
        raise InvalidInputError("boxes", "given without a known focal length", fix)
    for number, box in enumerate(boxes):
        if box is not None and box.size is not None:
            check_order(f"boxes[{number}].size", box.size, _usual_size(prior))
    return boxes


def as_box_errors(errors: BoxErrors | None) -> BoxErrors:
    """How far a detector's 3D boxes are off; those of a monocular one for None."""
    return BoxErrors() if errors is None else cast("BoxErrors", as_instance("box_errors", errors, BoxErrors))


def as_camera_pose(world_T_camera: ArrayLike) -> Array:
    """(4, 4) pose of a camera in a world that stands still.

    Raises:
        InvalidInputError: It is no rigid motion.
    """
    return as_rigid("world_T_camera", world_T_camera, _ROTATION_TOLERANCE)


def as_motion_covariance(given: ArrayLike) -> Array:
    """(6, 6) covariance of a camera's motion: rotation in radians, then translation in metres.

    Raises:
        InvalidInputError: It is no covariance.
    """
    matrix = as_finite("motion_covariance", given, (6, 6), "Give radians and metres, rotation first.")
    least = -_ROUNDING * float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > -least or np.linalg.eigvalsh(matrix).min() < least:
        fix = "Give a symmetric matrix without negative variances."
        raise InvalidInputError("motion_covariance", matrix.tolist(), fix)
    return matrix
