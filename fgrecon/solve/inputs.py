"""Input checks and set-up: the one place for every entry of `solve`, and so for the command line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.checks import as_finite, as_instance, as_list, as_rigid, as_shape
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Evidence, Points, Range, RangeRate, StereoPair, VehicleClass, as_evidence
from fgrecon.core.input_warnings import InputWarning, input_warning_of, strays
from fgrecon.core.mask import Mask, of_vehicle
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.options import Options, checked_options
from fgrecon.core.point_frames import check_points
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import ClassSizes, SizePrior, SizesLike, check_size, other_fleets
from fgrecon.io.catalogue import coarse_prior, load_prior, load_size_prior, shipped_class_sizes
from fgrecon.io.lens_fields import scale_between
from fgrecon.solve.proposals.point_term import measured_by
from fgrecon.solve.vehicle.model import VehicleModel, in_traffic, prepare, sized

if TYPE_CHECKING:
    import gtsam


_CAMERA_NUMBERS = Real, np.ndarray, list, tuple  # what a matrix, or fx, fy, cx, cy, are made of
_TURN = 2.0 * np.pi + 1e-6  # radians; what is more is in degrees
_ROTATION_TOLERANCE = 1e-4  # of a camera's pose: more digits than that are seldom lost
_LEAST_MASK_OVERLAP = 0.3  # intersection over union of both boxes, from which on a mask is a vehicle's
_NO_VELOCITY = (
    "Give it with the vehicle, as `Observation(evidence=...)`, to a `Tracker`: images without times have no velocity."
)
_ROUNDING = 1e-9  # share of the largest number of a covariance that is rounding


@dataclass(frozen=True)
class SolveSetup:
    """What holds for all vehicles of a call."""

    options: Options  # settings
    prior: ShapePrior  # the shape prior as it is given
    model: VehicleModel  # the prior prepared for the vehicles' sizes
    ground: Ground | None = None  # ground plane, or None
    fleet: SizePrior | None = None  # sizes that are given for all vehicles, or None
    evidence: tuple[Evidence, ...] = ()  # what other sensors say of all vehicles

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
            ground: Ground plane, or the height in metres of a level camera.
            joint: Whether pose and shape have to move together.

        Raises:
            InvalidInputError: One of them cannot be used; names it, its value and the fix.
        """
        chosen, loaded = checked_options(options, joint=joint), load_prior(prior)
        fleet = None if sizes is None else load_size_prior(sizes)
        if fleet is not None:
            check_size("size_prior", fleet.mean, _usual_size(loaded))
        model = prepare(loaded, fleet, chosen.shape.basis_vectors)
        return cls(chosen, loaded, model, as_ground(ground), fleet)

    @property
    def fits_classes(self) -> bool:
        """Whether images tell of which class vehicles are that nobody says it of (`fgrecon.solve.fitted_class`)."""
        return self.fleet is not None and self.fleet.mixed

    @property
    def class_sizes(self) -> ClassSizes:
        """Sizes and shares of classes: the fleet's, or the package's."""
        known = None if self.fleet is None else self.fleet.class_sizes
        return shipped_class_sizes() if known is None else known

    def model_of(self, observations: Sequence[Observation], cameras: Sequence[Camera]) -> VehicleModel:
        """The prior prepared for a vehicle: for the class that its observations say it is of, else for all.

        What several of them say is averaged: a detector takes a vehicle for the same in all its images. Where points
        say how far it is, its size is as free as the traffic's.

        Args:
            cameras: That of each.

        Raises:
            InvalidInputError: A class is none of its scheme.
        """
        classes = self.classes_of(observations)
        model = self.model if classes is None else self.model_for(classes)
        measured = any(self.is_measured(*one) for one in zip(observations, cameras, strict=True))
        return in_traffic(model) if measured else model

    def is_measured(self, observation: Observation, camera: Camera) -> bool:
        """Whether points or pixels about a vehicle measure how far it is: others of a scan say nothing of it."""
        if not observation.evidence:
            return False
        return any(name not in self.options.disabled_terms for name in measured_by(observation, camera))

    def classes_of(self, observations: Sequence[Observation]) -> dict[str, float] | None:
        """Probability of each class by what observations say of a vehicle, averaged; None where they say nothing.

        Raises:
            InvalidInputError: A class is none of its scheme.
        """
        given = [one for observation in observations for one in observation.evidence if isinstance(one, VehicleClass)]
        if not given:
            return None
        sizes = self.class_sizes
        found = [sizes.probabilities(one.probabilities, one.scheme.value) for one in given]
        return {name: float(np.mean([one[name] for one in found])) for name in sizes.mean}

    def model_as(self, name: str) -> VehicleModel:
        """The prior prepared for a vehicle that is of a class for sure."""
        return self.model_for({one: float(one == name) for one in self.class_sizes.mean})

    def model_for(self, classes: Mapping[str, float]) -> VehicleModel:
        """The prior prepared for a vehicle that is of each class with a probability."""
        share = tuple((name, round(value, 2)) for name, value in classes.items())
        return _of_class(self.prior, self.fleet, self.class_sizes, self.options.shape.basis_vectors, share)


@lru_cache(maxsize=128)  # one object for one class, so that what is prepared for it is found again
def _of_class(
    prior: ShapePrior,
    fleet: SizePrior | None,
    sizes: ClassSizes,
    basis_vectors: int | None,
    share: tuple[tuple[str, float], ...],
) -> VehicleModel:
    """The prior prepared for a vehicle of each class with a probability, in a fleet."""
    probabilities = dict(share)
    is_usual = probabilities[sizes.usual] == 1.0
    of_sizes = fleet is not None and (fleet.name == sizes.name or fleet.mixed)
    if fleet is None:
        if is_usual:
            return prepare(prior, None, basis_vectors)
        usual, spread = _usual_size(prior), prior.category.dimension_operator
        basis = np.tensordot(spread, prior.basis, axes=((1, 2), (1, 2)))
        moment = basis @ basis.T + other_fleets(usual)
        usual_size: SizePrior | None = SizePrior(prior.name, usual, np.sqrt(np.diag(moment)), moment)
    else:
        usual_size = None if of_sizes else fleet
    if usual_size is fleet is not None and is_usual:
        return prepare(prior, fleet, basis_vectors)
    size = sizes.size(probabilities, usual_size, any_fleet=not of_sizes)
    coarse = None if size.coarse is None else coarse_prior(size.coarse, prior.category.keypoints)
    return sized(prepare(prior, None, basis_vectors) if coarse is None else prepare(coarse), size)


def _usual_size(prior: ShapePrior) -> Array:
    """(3,) length, width and height of the prior's mean vehicle, metres."""
    return prior.box_size(np.zeros(prior.dimension))


class Observed(NamedTuple):
    """What a vehicle is solved from, and what must be wrong with what was given or with the camera, if anything."""

    observation: Observation
    warning: InputWarning | None


def observe(
    keypoints: KeypointsLike,
    camera: Camera,
    setup: SolveSetup,
    *,
    confidence: ArrayLike | None = None,
    box: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    evidence: Sequence[Evidence] = (),
    moving: bool = False,
) -> Observed:
    """The observation that is solved from: checked against the prior's category, and freed of lens distortion.

    Args:
        moving: Whether the vehicle has a velocity, as over time.

    Raises:
        InvalidInputError: An array has the wrong shape or values, something is given twice, the box is outside of the
            image, or a range rate is of a vehicle without a velocity.
    """
    category, options = setup.prior.category, setup.options
    observation = given = _as_observation(keypoints, category, confidence, box, covariance).with_evidence(evidence)
    rates = [] if moving else [one for one in given.evidence if isinstance(one, RangeRate)]
    if rates:
        raise InvalidInputError("evidence", rates[0], _NO_VELOCITY)
    scale_between(given.image_size, camera.image_size, "image_size")
    if observation.box is not None and camera.image_size is not None:
        (left, top, right, bottom), (width, height) = observation.box, camera.image_size
        if right <= -0.5 or bottom <= -0.5 or left >= width - 0.5 or top >= height - 0.5:
            fix = f"Give a box in the image of {width} x {height} pixels."
            raise InvalidInputError("box", observation.box.tolist(), fix)
    if "direction" in options.disabled_terms:
        observation = replace(observation, azimuth=None)  # nor are neighbours or frames of a track to hear of it
    observation = observation.of_at_least(options.keypoints.least_confidence)
    warning = input_warning_of(given, camera)
    for which, why in strays(observation, camera):
        observation = observation.without(which, category.keypoints, why)
    observation = observation.undistorted(camera, category.keypoints)
    return Observed(_with_own_mask(observation, camera) if observation.evidence else observation, warning)


def without_rates_over_ground(observation: Observation) -> Observation:
    """The observation of a camera whose motion nothing says: rates over the ground say nothing of what it sees."""
    used = tuple(one for one in observation.evidence if not (isinstance(one, RangeRate) and one.over_ground))
    if len(used) == len(observation.evidence):
        return observation
    why = "range rate: left out, it is over the ground, and `world_T_camera` does not say how the camera moves."
    return replace(observation, evidence=used, left_out=(*observation.left_out, why))


def _with_own_mask(observation: Observation, camera: Camera) -> Observation:
    """The observation with its own mask, of those of the image, freed of lens distortion, and what may hide it."""
    masks = [one for one in observation.evidence if isinstance(one, Mask)]
    if not masks:
        return observation
    for one in masks:
        if camera.image_size is not None and one.image_size != tuple(camera.image_size):
            width, height = camera.image_size
            fix = f"Give masks of the whole image: ({height}, {width}), a number for each pixel."
            raise InvalidInputError("mask", f"{one.image_size[1]} rows of {one.image_size[0]}", fix)
    others = [one for one in observation.evidence if not isinstance(one, Mask)]
    ideal = [found for mask in masks if (found := mask.undistorted(camera)) is not None]
    box = observation.place
    own, hiding = (None, []) if box is None or not ideal else of_vehicle(ideal, box, _LEAST_MASK_OVERLAP)
    if own is None:
        left_out = (*observation.left_out, "masks: left out, none of them is about where the vehicle is.")
        return replace(observation, evidence=tuple(others), left_out=left_out)
    return replace(observation, evidence=(*others, own, *(one.hiding for one in hiding)))


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


_level = lru_cache(maxsize=16)(Ground.level)  # thousands of vehicles stand on one ground


def as_initial(initial: Box3D | float | None, prior: ShapePrior) -> Box3D | float | None:
    """Where the pose search is to start as well: a box, or a guess of `rotation_y` in radians.

    Raises:
        InvalidInputError: It is neither, or the box's size is in another order than the prior's.
    """
    if initial is None:
        return None
    if isinstance(initial, Box3D):
        if initial.size is not None:
            check_size("initial.size", initial.size, _usual_size(prior))
        return initial
    yaw = float(as_finite("initial", initial, (), "Give a `Box3D`, or a guess of rotation_y in radians."))
    if abs(yaw) > _TURN:
        raise InvalidInputError(
            "initial", yaw, f"Give rotation_y in radians: {yaw:g} degrees are {np.radians(yaw):.6g}."
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


def evidence_of(given: Sequence[Evidence], camera: Camera, *, of_all: bool = False) -> tuple[Evidence, ...]:
    """What other sensors say of the vehicles in a camera's image.

    Args:
        of_all: Whether it is about all vehicles of the image, and not of a single one.

    Raises:
        InvalidInputError: It is no sequence of evidence, or what can be of one vehicle alone is given for all.
    """
    evidence = as_evidence(given)
    for number, one in enumerate(evidence):
        if isinstance(one, RangeRate) or (of_all and isinstance(one, Range)):
            fix = (
                _NO_VELOCITY
                if isinstance(one, RangeRate)
                else "Give it with the vehicle, as `Observation(evidence=...)`."
            )
            raise InvalidInputError(f"evidence[{number}]", one, fix)
        if isinstance(one, DepthMap) and camera.image_size not in (None, one.depth.shape[::-1]):
            fix = "Give a depth for each pixel of the image of {} x {}.".format(*camera.image_size)
            raise InvalidInputError(f"evidence[{number}]", f"a depth map of shape {one.depth.shape}", fix)
        if isinstance(one, StereoPair):
            fix = "Give it to what has the left image, such as `fgrecon.reconstruct_image`; or the depth it makes."
            raise InvalidInputError(f"evidence[{number}]", "a stereo pair without the left image", fix)
    return evidence


def check_frames(
    evidence: Sequence[Evidence], camera: Camera, ground: Ground | None, observations: Iterable[KeypointsLike]
) -> None:
    """Refuse points that are in another frame or unit than metres in the frame of a camera.

    Args:
        ground: That is given, or None.
        observations: Of the vehicles of its image, which tell by their boxes where points have to be.

    Raises:
        InvalidInputError: Some are; says the likely cause.
    """
    boxes: list[Array] | None = None
    for number, one in enumerate(evidence):
        if boxes is None and isinstance(one, Points | DepthMap):
            places = [one.place for one in observations if isinstance(one, Observation)]
            boxes = [place for place in places if place is not None]
        if isinstance(one, Points) and len(one.points):
            check_points(one.points, camera, f"evidence[{number}]", ground, boxes or ())
        elif isinstance(one, DepthMap):
            one.check_vehicles(boxes or (), camera, f"evidence[{number}]")


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
            check_size(f"boxes[{number}].size", box.size, _usual_size(prior))
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
