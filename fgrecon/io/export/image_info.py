"""Metadata of the images behind results, for other programs: tokens, times, poses of the camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import imaged, points_ahead
from fgrecon.core.checks import as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import FORWARD_LEFT_UP, box_around, transform
from fgrecon.core.repr import brief_repr
from fgrecon.io.bag import is_bag
from fgrecon.io.datasets import is_data_set, open_sequence
from fgrecon.io.export.results import NamedResult
from fgrecon.io.json_fields import Fields, read_json

EVERY = "*"
"""Name of what holds for every image that is not named."""

VISIBLE = 0.5


@dataclass(frozen=True, eq=False)
class BagImage:
    """An image's message in a bag."""

    topic: str
    frame: str  # its frame, in which boxes are given beside it
    frame_T_camera: Array  # (4, 4) from a camera's axes right, down, ahead to those of the frame
    stamp: int  # nanoseconds of its header
    recorded: int  # when it was recorded, nanoseconds


@dataclass(frozen=True, eq=False)
class ImageInfo:
    """What is known of an image."""

    # NuScenes' token of the sample, Argoverse's time of the sweep; empty where the image is of none that is evaluated;
    # None where it is not known
    sample_token: str | None = None
    image_id: int | str | None = None  # COCO's number or name of the image, or None
    timestamp: float | None = None  # when it was taken, seconds; or None
    world_T_camera: Array | None = None  # (4, 4) pose of the camera in the world's frame, or None
    sequence: str | None = None  # the drive that the image is of, such as Argoverse's log, or None
    world_T_vehicle: Array | None = None  # (4, 4) pose of the vehicle at the time of the sample, or None
    bag: BagImage | None = None  # its message, where it is of a bag

    __repr__ = brief_repr


def read_images_file(path: Path) -> dict[str, ImageInfo]:
    """What a JSON file, a data set or a bag tells of images.

    Args:
        path: A camera of a data set (`fgrecon.io.datasets`), or a topic of a bag (`fgrecon.io.bag_drive`); or JSON:
            an object that has for each image (or `*`, for those not named) an object with `sample_token`, `image_id`,
            `timestamp` in seconds, `world_T_camera`, `world_T_vehicle` (4 x 4) and `sequence`, as far as known.
    """
    if is_data_set(path):
        return _of_data_set(path)
    if is_bag(path):
        return _of_bag(path)
    data = read_json(path)
    if not isinstance(data, Mapping):
        raise InvalidInputError(str(path), type(data).__name__, "Give an object by image.")
    return {str(name): _info(Fields(entry, f"{path}: {name}.")) for name, entry in data.items()}


def _of_data_set(source: Path) -> dict[str, ImageInfo]:
    found, camera = open_sequence(source)
    images = found.images if camera is None else found.of_camera(camera)
    return {
        image.path.name: ImageInfo(
            sample_token=image.moment or "",
            timestamp=image.time if found.continuous else None,
            world_T_camera=image.world_T_camera,
            sequence=found.name,
            world_T_vehicle=None if image.moment is None else found.moments[image.moment].world_T_vehicle,
        )
        for image in images
    }


def _of_bag(source: Path) -> dict[str, ImageInfo]:
    from fgrecon.io.bag_drive import open_bag_drive

    drive = open_bag_drive(source)
    frames, axes = drive.frames, drive.frame_T_camera
    return {
        frames.name(number): ImageInfo(
            timestamp=time, bag=BagImage(frames.topic, drive.frame, axes, drive.times[number], drive.recorded[number])
        )
        for number, time in zip(frames.numbers, frames.times, strict=True)
    }


def _info(fields: Fields) -> ImageInfo:
    number = fields.data.get("image_id")
    if number is not None and not (isinstance(number, int | str) and not isinstance(number, bool)):
        raise InvalidInputError(f"{fields.where}image_id", number, "Give an integer or a text.")
    known: dict[str, Any] = {
        name: as_rigid(f"{fields.where}{name}", fields.numbers(name, (4, 4)))
        for name in ("world_T_camera", "world_T_vehicle")
        if name in fields
    }
    known |= {name: fields.get(name, str) for name in ("sample_token", "sequence") if name in fields}
    return ImageInfo(
        image_id=number,
        timestamp=float(fields.numbers("timestamp", ())) if "timestamp" in fields else None,
        **known,
    )


def names_of(image: str) -> tuple[str, ...]:
    """Names by which something may be known of an image: its own, without folder and ending, and that of every one."""
    return image, Path(image).name, Path(image).stem, EVERY


def info_of(image: str, images: Mapping[str, ImageInfo]) -> ImageInfo:
    """What is known of an image by the first of its names that tells something."""
    for name in names_of(image):
        if name in images:
            return images[name]
    return ImageInfo()


def by_image(results: Sequence[NamedResult]) -> dict[str, list[NamedResult]]:
    """The results that have a pose, by their images, in order; where these are not known, by their rows of a batch."""
    found: dict[str, list[NamedResult]] = {}
    for item in results:
        if item.solved:
            found.setdefault(item.image or item.row, []).append(item)
    return found


def box_in(info: ImageInfo, camera_T_object: Array, size: Array) -> tuple[Array, Array]:
    """Centre (3,) of a vehicle's box and its axes (3, 3) forward, left, up; in the world's frame, else the camera's.

    Args:
        camera_T_object: (4, 4) pose, its origin on the ground below the centre.
        size: (3,) length, width and height, metres.
    """
    pose = camera_T_object if info.world_T_camera is None else info.world_T_camera @ camera_T_object
    centre: Array = pose[:3, 3] - pose[:3, 1] * size[2] / 2.0
    return centre, pose[:3, :3] @ FORWARD_LEFT_UP


def score(item: NamedResult) -> float:
    """Its detector's; else the mean weight of the keypoints that the pose shows: how much was found in its place."""
    if item.score is not None:
        return item.score
    visible = item.result.diagnostics.visibility >= VISIBLE
    return float(item.result.diagnostics.weights[visible].mean()) if visible.any() else 0.0


def track_of(item: NamedResult) -> str:
    """What it is called through the images: its track, else its name."""
    return item.name if item.track is None else str(item.track)


def image_box(item: NamedResult) -> Array:
    """(4,) x1, y1, x2, y2 of a vehicle in its image, pixels.

    The observed box; else that of the projected surface, as far as it is in front of the camera, cut at the image's
    edges; without a camera or a surface that of the projected keypoints.
    """
    if item.box is not None:
        return item.box
    shape, camera = item.result.shape, item.camera
    box = box_around(item.result.pose.wireframe_uv)
    if camera is not None and shape.surface_vertices is not None and shape.surface_faces is not None:
        vertices = transform(item.result.camera_T_object, shape.surface_vertices)
        faces = shape.surface_faces
        points = points_ahead(vertices, np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]))
        box = box_around(imaged(camera, points)) if len(points) else box
    if camera is not None and camera.image_size is not None:
        box = np.clip(box, 0.0, np.tile(np.subtract(camera.image_size, 1.0), 2))
    return box


def keypoint_names(item: NamedResult) -> tuple[str, ...]:
    """Names of the keypoints; their places in the order where the category is not to be found."""
    from fgrecon.io.catalogue import load_category

    try:
        return load_category(item.result.shape.category).keypoints
    except InvalidInputError:
        return tuple(str(number) for number in range(len(item.result.shape.wireframe)))


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a rotation (3, 3), w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return x, y, z, w


def plain_vector(vector: Any) -> dict[str, float]:
    """x, y and z as messages have them."""
    return dict(zip("xyz", np.asarray(vector, dtype=np.float64).tolist(), strict=True))


def plain_quaternion(rotation: Array) -> dict[str, float]:
    """A rotation (3, 3) as messages have it."""
    return dict(zip("xyzw", quaternion(rotation), strict=True))
