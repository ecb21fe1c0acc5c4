"""Subjects of recordings and pictures: vehicles, their inputs, and the truth where it is known."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_finite, as_rigid, as_shape, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.history import GraphFactor
from fgrecon.core.metrics import orientation_error, translation_error
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Iteration, Reconstruction, rotation_y
from fgrecon.core.text import distinct
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz import entities
from fgrecon.viz.geometry import as_image

ORIENTATION_ERROR = "orientation_deg"
TRANSLATION_ERROR = "translation_m"
SHAPE_ERROR = "keypoints_m"

_RIGID = 1e-5  # by so much a rotation may fail to be one: single precision does


@dataclass(frozen=True)
class Truth:
    """The true pose, and box and keypoints where they are known.

    Attributes:
        camera_T_object: (4, 4) true pose, maps object coordinates into the camera frame.
        box_size: (3,) true length, width and height in metres, or None.
        keypoints: (K, 3) true keypoints in the object frame, metres, or None; NaN rows are not known.
    """

    camera_T_object: Array
    box_size: Array | None = None
    keypoints: Array | None = None

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: A wrong shape, a pose that is no rigid motion, or a size that is not positive.
        """
        pose = as_rigid("truth.camera_T_object", self.camera_T_object, _RIGID)
        object.__setattr__(self, "camera_T_object", own(pose))
        if self.box_size is not None:
            size = as_finite("truth.box_size", self.box_size, (3,), "Give length, width and height in metres.")
            if (size <= 0).any():
                raise InvalidInputError("truth.box_size", size.tolist(), "Give positive lengths in metres.")
            object.__setattr__(self, "box_size", own(size))
        if self.keypoints is not None:
            object.__setattr__(self, "keypoints", own(as_shape("truth.keypoints", self.keypoints, (None, 3))))

    def errors(self, camera_T_object: Array, keypoints: Array) -> Mapping[str, float]:
        """How far an estimate is from the truth.

        Args:
            camera_T_object: (4, 4) estimated pose.
            keypoints: (K, 3) estimated keypoints in the object frame, metres.

        Returns:
            `orientation_deg`: |wrapped difference of rotation_y|, degrees; `translation_m`: distance of the origins,
            metres; and where true keypoints are known `keypoints_m`: mean distance in the object frame, metres.
        """
        yaws = [rotation_y(camera_T_object)], [rotation_y(self.camera_T_object)]
        errors = {
            ORIENTATION_ERROR: float(orientation_error(*yaws)[0]),
            TRANSLATION_ERROR: float(
                translation_error(camera_T_object[None, :3, 3], self.camera_T_object[None, :3, 3])[0]
            ),
        }
        if self.keypoints is not None and self.keypoints.shape == keypoints.shape:
            distances = np.linalg.norm(keypoints - self.keypoints, axis=1)
            if np.isfinite(distances).any():
                errors[SHAPE_ERROR] = float(distances[np.isfinite(distances)].mean())
        return errors


_JPEG_QUALITY = 92


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph, (H, W, 3) RGB bytes. Several recordings may show it, and it is encoded once for all of them."""

    pixels: NDArray[np.uint8]

    @classmethod
    def of(cls, image: NDArray[np.uint8] | Photograph | None) -> Photograph | None:
        """An image as a photograph; None where there is none.

        Raises:
            InvalidInputError: The image is not (H, W, 3) of bytes.
        """
        return image if image is None or isinstance(image, Photograph) else cls(as_image(image))

    @cached_property
    def columns(self) -> list[Any]:
        """It as a JPEG, in component columns of one row of a recording."""
        import rerun as rr

        return list(rr.EncodedImage.columns(blob=[jpeg(self.pixels, _JPEG_QUALITY)]))


def detection_words(kind: str | None, score: float | None) -> str:
    """Class and score of a detection as pictures and recordings show them, such as `Van 0.87`; empty without both."""
    return " ".join([*([] if kind is None else [kind]), *([] if score is None else [f"{score:.2f}"])])


def jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """A file of an image (H, W, 3) of RGB bytes."""
    import cv2

    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


@dataclass(frozen=True)
class SolvedVehicle:
    """One reconstructed vehicle and what it was reconstructed from.

    Attributes:
        reconstruction: The result; its history is what recordings, animations and stages show.
        observation: Its keypoints.
        camera: The camera that observed them.
        image: (H, W, 3) RGB photograph, or None.
        truth: What is known to be true, drawn beside the estimate and given as errors; or None.
        title: What it is called; empty for nothing.
        model: The car model that it comes nearest to, or None.
        detection: Class and score of its detection, see `detection_words`; empty where they are not known.
    """

    reconstruction: Reconstruction
    observation: Observation
    camera: Camera
    image: NDArray[np.uint8] | Photograph | None = None
    truth: Truth | None = None
    title: str = ""
    model: VehicleMesh | None = None
    detection: str = ""

    @property
    def photograph(self) -> Photograph | None:
        """The image; an InvalidInputError where it is not (H, W, 3) of bytes."""
        return Photograph.of(self.image)

    @property
    def pixels(self) -> NDArray[np.uint8] | None:
        """The same as an array."""
        return None if (photograph := self.photograph) is None else photograph.pixels

    @property
    def solved(self) -> bool:
        """Whether there is a pose."""
        return bool(np.isfinite(self.reconstruction.camera_T_object).all())


def result_step(result: Reconstruction) -> Iteration:
    """A result as a step of an optimisation, of stage `result`."""
    return Iteration(
        stage="result",
        irls=0,
        step=0,
        camera_T_object=result.camera_T_object,
        coefficients=result.shape.coefficients,
        keypoints=result.wireframe,
        projections=result.pose.wireframe_uv,
        weights=result.diagnostics.weights,
        energies=result.diagnostics.energies,
    )


@dataclass(frozen=True)
class Member:
    """A vehicle of a scene on its way into a recording."""

    number: int  # its place in the scene, which is its colour
    title: str  # what it is called
    name: str  # the same in paths
    vehicle: SolvedVehicle  # what is recorded

    def place(self, entity: str) -> str:
        """Where the recording has one of its entities."""
        return entities.of_vehicle(entity, self.name)


def members_of(vehicles: Sequence[SolvedVehicle]) -> list[Member]:
    """The vehicles with names that paths can have, no two alike."""
    members: list[Member] = []
    taken: set[str] = set()
    for number, vehicle in enumerate(vehicles):
        title = vehicle.title or str(number)
        plain = re.sub(r"[^\w.-]+", "-", title, flags=re.ASCII).strip("-.") or str(number)
        members.append(Member(number, title, distinct(plain, taken), vehicle))
    return members


@dataclass(frozen=True, eq=False)
class DrawnVehicle:
    """One vehicle of an image or of a video's frame among others.

    Attributes:
        identity: Its id, which is its colour as well.
        box: (4,) 2D box in pixels.
        result: The reconstruction; None draws the 2D box alone.
        words: What is written beside its id, such as its speed.
        trail: (T, 3) where it was, in this camera's frame, oldest first; None where that is not known.
        name: What it is called where its id is not its name.
        truth: What is known to be true.
        model: The car model that it comes nearest to.
        detection: Class and score of its detection, see `detection_words`; empty where they are not known.
    """

    identity: int
    box: Array
    result: Reconstruction | None = None
    words: str = ""
    trail: Array | None = None
    name: str = ""
    truth: Truth | None = None
    model: VehicleMesh | None = None
    detection: str = ""

    @property
    def pose(self) -> Array | None:
        """(4, 4) `camera_T_object`, or None where it has no pose, or none that the keypoints determine."""
        if self.result is None or not self.result.status.determined:
            return None
        pose = self.result.camera_T_object
        return pose if np.isfinite(pose).all() else None

    @property
    def posed(self) -> tuple[Reconstruction, Array] | None:
        """Result and pose, or None where there is no pose."""
        return None if self.result is None or (pose := self.pose) is None else (self.result, pose)

    @property
    def all_words(self) -> str:
        """Class and score of its detection and its words."""
        return ", ".join(filter(None, (self.detection, self.words)))

    @property
    def label(self) -> str:
        """Its name, else its id."""
        return self.name or str(self.identity)


_FEW = 6  # vehicles of a scene that are drawn and listed in full


@dataclass(frozen=True)
class DrawnScene:
    """The vehicles of one image as a picture shows them."""

    vehicles: Sequence[DrawnVehicle]
    camera: Camera  # the camera that observed them
    size: tuple[float, float]  # width and height of its image, pixels
    ground: Ground | None = None  # the ground plane; without one the camera is taken for level
    # (4, 4) first estimates of poses, by id, where they are shown
    starts: Mapping[int, Array] = field(default_factory=dict)

    @property
    def crowded(self) -> bool:
        """Whether there are so many vehicles that each is drawn with less, or the picture were a thicket."""
        return len(self.vehicles) > _FEW

    @cached_property
    def posed(self) -> list[tuple[DrawnVehicle, Reconstruction, Array]]:
        """The vehicles that have a pose, with result and pose."""
        return [(vehicle, *vehicle.posed) for vehicle in self.vehicles if vehicle.posed is not None]


@dataclass(frozen=True)
class TrackInputs:
    """What a track was reconstructed from, one entry per image; images that were refused included.

    Attributes:
        observations: Its keypoints in each image; None where there are none.
        cameras: The camera of each image.
        numbers: Number of each image on the timeline `frame`, increasing; None counts them from 0.
        images: (H, W, 3) RGB photographs; None for none.
        truths: What is known to be true; None for nothing.
        ground: The ground plane that was assumed, or None.
    """

    observations: Sequence[Observation | None]
    cameras: Sequence[Camera]
    numbers: Sequence[int] | None = None
    images: Sequence[NDArray[np.uint8] | None] | None = None
    truths: Sequence[Truth | None] | None = None
    ground: Ground | None = None

    def __post_init__(self) -> None:
        """Check that there is one entry per image.

        Raises:
            InvalidInputError: A sequence has another length, or the numbers do not increase.
        """
        count = len(self.observations)
        for name in ("cameras", "numbers", "images", "truths"):
            given = getattr(self, name)
            if given is not None and len(given) != count:
                raise InvalidInputError(name, f"{len(given)} entries", f"Give one for each of {count} images.")
        if self.numbers is not None and (np.diff(np.array(self.numbers)) <= 0).any():
            raise InvalidInputError("numbers", list(self.numbers), "Give numbers that increase.")

    def number(self, index: int) -> int:
        """Number of an image on the timeline `frame`."""
        return index if self.numbers is None else int(self.numbers[index])

    def at(self, index: int, result: Reconstruction) -> SolvedVehicle:
        """One image with its result; its observation must not be None."""
        observation = self.observations[index]
        assert observation is not None
        image = None if self.images is None else self.images[index]
        truth = None if self.truths is None else self.truths[index]
        return SolvedVehicle(result, observation, self.cameras[index], image, truth)


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One frame as it is recorded."""

    number: int  # of the frame
    time: float  # seconds
    image: NDArray[np.uint8] | None  # (H, W, 3) RGB bytes, or None
    vehicles: tuple[DrawnVehicle, ...] = ()  # what it shows
    # (4, 4) pose of the camera; None takes the camera's frame for the world
    world_T_camera: Array | None = None
    problem: str | None = None  # why it could not be read, or None
    # what is plotted of each vehicle, by its id: name and numbers, such as a value and its band
    values: Mapping[int, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    # what becomes of each vehicle, by its id: a word or two; None for one that is no longer observed
    states: Mapping[int, str | None] = field(default_factory=dict)
    window: tuple[GraphFactor, ...] = ()  # factors of the window of one of them; empty leaves the graph as it was
