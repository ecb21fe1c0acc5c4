"""Description of a data set's drive: the images of its cameras with their poses, and the 3D boxes around them.

Every reader of this folder gives the same: axes and quaternions, centres and bottoms, orders of sizes are dealt with
there. The world's frame is the data set's own; it is the same for all images and boxes of a sequence.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners, box_outline
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import FORWARD_LEFT_UP, transform
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.text import one_word
from fgrecon.io.files import write_bytes
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.kitti_files import Drive, DriveFrame, Objects

T = TypeVar("T")

UNKNOWN = -1
"""KITTI's mark for an occlusion that is not known."""


@dataclass(frozen=True, eq=False)
class WorldBox:
    """An object with a 3D box."""

    name: str  # what the data set calls it; no other box of the sequence has it
    kind: str  # its class, in the data set's words
    world_T_box: Array  # (4, 4) the box's centre and its axes forward, left, up, metres
    size: Array  # (3,) length, width and height, metres
    track: str | None = None  # of the object through the sequence, or None
    score: float | None = None  # of its detector, or None
    occlusion: int = UNKNOWN  # KITTI's grade 0 to 2; -1 where it is not known
    velocity: Array | None = None  # (3,) in the world's frame, m/s, or None
    # (4,) 2D boxes that people have drawn, by camera; else the projection of the 3D box is taken
    boxes: Mapping[str, Array] = field(default_factory=dict)

    @property
    def corners(self) -> Array:
        """(8, 3) in the world's frame; rear before front, bottom before top, right before left."""
        return transform(self.world_T_object, box_corners(self.size))

    @property
    def world_T_object(self) -> Array:
        """(4, 4) pose of the object frame: origin at the centre of the bottom face, axes forward, down, left."""
        pose = self.world_T_box.copy()
        pose[:3, :3] = self.world_T_box[:3, :3] @ FORWARD_LEFT_UP.T
        pose[:3, 3] -= self.world_T_box[:3, 2] * self.size[2] / 2.0
        return pose


@dataclass(frozen=True, eq=False)
class Sweep:
    """A scan of a LiDAR: its file, and (4, 4) pose in the world of the frame that its points are in."""

    path: Path
    world_T_points: Array


@dataclass(frozen=True, eq=False)
class CameraImage:
    """An image."""

    camera: str  # name of the camera
    path: Path  # the file; it need not be there
    name: str  # what the data set calls the image
    time: float  # seconds, by the data set's clock
    lens: Camera
    vehicle_T_camera: Array  # (4, 4) how it is mounted on the vehicle, in the vehicle's frame of the data set
    world_T_vehicle: Array  # (4, 4) pose of the vehicle when the image was taken
    moment: str | None  # the moment whose boxes are those of the image; None where it is of none
    sweep: Sweep | None = None  # the LiDAR's that belongs to it, or None
    # gives the file, where the data set has it inside a table; it is then unpacked to `path`
    content: Callable[[], bytes] | None = None

    @property
    def world_T_camera(self) -> Array:
        """(4, 4) pose of the camera when it took the image."""
        return self.world_T_vehicle @ self.vehicle_T_camera

    @property
    def camera_T_points(self) -> Array | None:
        """(4, 4) from the frame of the sweep's points to the camera's when it took the image; None without a sweep."""
        return (
            None if self.sweep is None else np.asarray(np.linalg.solve(self.world_T_camera, self.sweep.world_T_points))
        )

    def pixels(self, points: Array) -> tuple[Array, Array]:
        """(N, 2) pixels of points (N, 3) of the world, and their depths (N,); behind the camera they mean nothing."""
        camera_T_world = np.linalg.inv(self.world_T_camera).astype(np.float64)
        in_camera = transform(camera_T_world, points)
        safe: Array = np.where(in_camera[:, 2:] > 0.0, in_camera, [0.0, 0.0, 1.0])
        return self.lens.distort(self.lens.project(safe)), in_camera[:, 2]


@dataclass(frozen=True, eq=False)
class Moment:
    """When objects are labelled, or to be found in a test set, all around at once."""

    name: str  # what the data set calls it, such as the token of a sample
    time: float  # seconds, by the data set's clock
    world_T_vehicle: Array  # (4, 4) pose of the vehicle then
    boxes: tuple[WorldBox, ...]  # the objects
    labelled: bool = True  # whether somebody has looked for them


@dataclass(frozen=True, eq=False)
class DataSequence:
    """A drive of a vehicle with cameras."""

    name: str  # what the data set calls it
    images: tuple[CameraImage, ...]
    moments: Mapping[str, Moment]  # by their names
    cars: Mapping[str, str]  # what the data set calls cars and vans, and KITTI's names for them (`Car`, `Van`)
    # whether the images follow one another, with times and poses in one world; else each is by itself
    continuous: bool = True

    @cached_property
    def cameras(self) -> tuple[str, ...]:
        """The names of the cameras."""
        return tuple(dict.fromkeys(image.camera for image in self.images))

    def of_camera(self, camera: str | None) -> tuple[CameraImage, ...]:
        """The images of a camera, None for the only one.

        Raises:
            InvalidInputError: There is no such camera, or none is named and there are several.
        """
        name = self.cameras[0] if camera is None and len(self.cameras) == 1 else camera
        found = tuple(image for image in self.images if image.camera == name)
        if not found:
            fix = f"Name a camera: {', '.join(self.cameras) or 'there is none'}."
            if self.cameras:
                fix = f"{fix[:-1]}, such as FOLDER#{self.name}/{self.cameras[0]}."
            raise InvalidInputError("camera", camera or f"{len(self.cameras)} cameras of {self.name}", fix)
        return found


def unpacked_images() -> Path:
    """Where images that lie inside of tables are unpacked to: they are there for the next run."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fgrecon" / "images"


def drive_of(drive: DataSequence, camera: str | None = None) -> Drive:
    """The images of a camera as a drive whose objects are those that are seen in them.

    Images without a file are left out; those inside of tables are unpacked (`unpacked_images`). Boxes are upright in
    the camera's frame there, as KITTI's are: of a camera that looks up or down they lose the angle to it.
    """
    there = images_there(drive, drive.of_camera(camera))
    tracks: dict[str, int] = {}
    frames = tuple(_frame(number, image, drive, tracks) for number, image in enumerate(there))
    return Drive(f"{drive.name}-{there[0].camera}", frames)


def images_there(drive: DataSequence, images: tuple[CameraImage, ...]) -> tuple[CameraImage, ...]:
    """Those of the images whose files are there, in order of time; those inside of tables are unpacked."""
    for image in images:
        if image.content is not None and not image.path.is_file():
            image.path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(image.path, image.content())
    there = sorted((image for image in images if image.path.is_file()), key=lambda image: image.time)
    if not there:
        first = str(images[0].path) if images else "none"
        raise InvalidInputError("images", first, f"Give the images of {drive.name} there.")
    return tuple(there)


def _frame(number: int, image: CameraImage, drive: DataSequence, tracks: dict[str, int]) -> DriveFrame:
    moment = None if image.moment is None else drive.moments[image.moment]
    boxes = () if moment is None else moment.boxes
    visible = [(box, row) for box in boxes if (row := _row(box, image)) is not None]
    kinds = [drive.cars.get(box.kind, one_word(box.kind)) for box, _ in visible]
    objects = Objects.of_rows(kinds, np.array([row for _, row in visible]))
    return DriveFrame(
        number=number,
        image=image.path,
        objects=objects,
        tracks=np.array([tracks.setdefault(box.track or box.name, len(tracks)) for box, _ in visible], dtype=np.int64),
        usable=np.ones(len(visible), dtype=bool),
        labelled=moment is not None and moment.labelled,
        calibration=KittiCalibration(image.lens, np.zeros(3), image.camera_T_points),
        time=image.time if drive.continuous else None,
        world_T_camera=image.world_T_camera if drive.continuous else None,
        sweep=None if image.sweep is None else image.sweep.path,
    )


def _row(box: WorldBox, image: CameraImage) -> list[float] | None:
    """The numbers of KITTI's line for a box in an image; None where it is not seen in it."""
    pose = np.linalg.inv(image.world_T_camera) @ box.world_T_object
    outline = box_outline(transform(pose, box_corners(box.size)), image.lens)
    if outline is None:
        return None
    corners, truncation = outline
    x, y, z = pose[:3, 3]
    yaw = rotation_y(pose)
    length, width, height = box.size
    alpha = float(wrap_angle(yaw - np.arctan2(x, z)))
    drawn = box.boxes.get(image.camera, corners)
    score = np.nan if box.score is None else box.score
    return [truncation, box.occlusion, alpha, *drawn, height, width, length, x, y, z, yaw, score]


@dataclass(frozen=True)
class Reader(Generic[T]):
    """A data set: how its sequences are found, and how one is read. Every module of this folder has one, `READER`."""

    what: str  # a sequence in its words, such as `log`
    # the sequences below a path by their names, with what `read` needs of each; empty where it is no such data
    # set
    listed: Callable[[Path], Mapping[str, T]]
    # makes a sequence of its name and that. Raises `InvalidInputError` with file and field where one is malformed
    read: Callable[[str, T], DataSequence]

    def matches(self, path: Path) -> bool:
        """Whether a path is this data set."""
        return path.is_dir() and bool(self.listed(path))

    def sequence(self, path: Path, wanted: str | None) -> DataSequence:
        """The sequence that is wanted, or the only one.

        Raises:
            InvalidInputError: There is no such sequence, or none is wanted and there are several; lists some.
        """
        found = self.listed(path)
        names = list(found)
        if wanted is None and len(names) == 1:
            wanted = names[0]
        if wanted not in found:
            listed = ", ".join([*names[:5], *(["..."] if len(names) > 5 else [])])
            value = wanted if wanted is not None else f"{len(names)} of them"
            raise InvalidInputError(self.what, value, f"Name one of {path}: {listed}, such as {path}#{names[0]}.")
        assert wanted is not None
        return self.read(wanted, found[wanted])
