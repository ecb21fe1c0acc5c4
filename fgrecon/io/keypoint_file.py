"""Keypoints of one or more vehicles from a JSON file, the input of `fgrecon reconstruct`.

The file holds one instance, a list of instances, or an object with `instances` beside what they share. An instance::

    {
      "id": "car-7",                                       optional; else its number from 0
      "keypoints": {"left_front_wheel": [u, v], ...},      by name, absent where not found
                or [[u, v], null, ...],                    or in the category's order, null where not found
      "confidence": [0.9, ...],                            optional, 0 to 1; or the third number of every keypoint
      "confidence_midpoint": 0.5,                          optional: where a point is as likely right as wrong
      "covariance": [[[uu, uv], [uv, vv]], ...],           optional, square pixels
      "box": [x1, y1, x2, y2],                             optional, pixels
      "azimuth": [0.1, 0.7, ...],                          optional: probability of each direction it is seen from, the
                                                           first from ahead, then evenly all around over its left
      "initial": rotation_y in radians, or                 optional
                 {"location": [x, y, z], "rotation_y": r, "size": [length, width, height]},
      "image": "street.jpg",                               optional: the photograph that it is in
      "frame": 12, "track": 3                              optional, of videos: number of the frame, id of the vehicle
                                                           (-1: none)
    }

`confidence` and `covariance` may be given by name as well. The camera, for one instance or shared: `K` (3 x 3) or
`intrinsics` (fx, fy, cx, cy), and with it `distortion` (OpenCV's coefficients) and `image_size` (width, height).

The structure of each instance is checked on reading; one that is malformed is left out, and said so, where another is
not. Whether an instance's numbers make sense (enough points, a box of some size) is for `fgrecon.reconstruct` to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.checks import one_word
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.observation import Observation, scaled_pixels
from fgrecon.io.catalogue import class_of_kind
from fgrecon.io.images import IMAGES, refuse_unread
from fgrecon.io.json_fields import Fields, numbers, plain_id
from fgrecon.io.lens_fields import check_unused, read_lens, read_size, scale_between
from fgrecon.io.video_frames import VIDEOS

_NO_TRACK = -1
_CAMERA_FIELDS = {"K", "intrinsics", "distortion", "distortion_model", "image_size"}
_INSTANCE_FIELDS = {
    "id",
    "keypoints",
    "confidence",
    "confidence_midpoint",
    "covariance",
    "box",
    "azimuth",
    "initial",
    "image",
    "frame",
    "track",
    "kind",
    "score",
} | _CAMERA_FIELDS
_DETECTOR_FIELDS = {"visible", "front_probability", "left_probability"}
"""What `fgrecon keypoints detect` writes beside what is read: nobody need wonder that it is left out."""
_FILE_FIELDS = {"instances"} | _CAMERA_FIELDS


@dataclass(frozen=True)
class Instance:
    """What is known about one vehicle, as `fgrecon.reconstruct` takes it."""

    name: str  # its id
    keypoints: Array  # (K, 2) pixels in the category's order, NaN where not found
    confidence: Array | None = None  # (K,), or None
    confidence_midpoint: float | None = None  # confidence at which a point is as likely right as wrong, or None
    box: Array | None = None  # (4,) x1, y1, x2, y2 in pixels, or None
    covariance: Array | None = None  # (K, 2, 2) in square pixels, or None
    # (A,) probability of each direction that it is seen from, as in `Observation`, or None
    azimuth: Array | None = None
    initial: Box3D | float | None = None  # 3D box, or guess of rotation_y in radians, or None
    camera: Camera | None = None  # the camera that the file names for it, or None
    image: str | None = None  # name of the photograph that it is in, as the file has it, or None
    frame: int | None = None  # number of the frame of a video that it is in, or None
    track: int | None = None  # id of the vehicle through the frames of a video, or None
    kind: str | None = None  # what it is, one word such as `Van`, which results repeat; or None
    score: float | None = None  # how sure its detector is, which exports repeat; or None
    image_size: tuple[int, int] | None = None  # width and height in pixels that the file states of its image, or None
    vehicle_class: VehicleClass | None = None  # of which class it is, where that is to tell its size; or None

    def fitted(self, size: tuple[int, int] | None, *, scale: bool = False) -> Instance:
        """The same in pixels of an image of a size, which is the camera's or the picture's; None where it is not known.

        Args:
            size: Width and height in pixels.
            scale: Whether points may be scaled, where the file states another size of the same shape.

        Raises:
            InvalidInputError: The file states another size, and scaling is not requested or the shapes differ.
        """
        ratio = np.array(scale_between(self.image_size, size, f"instance {self.name}: image_size", scale=scale))
        if (ratio == 1.0).all():
            return self
        return replace(self, **scaled_pixels(self.keypoints, self.box, self.covariance, ratio), image_size=size)

    @property
    def classed(self) -> Instance:
        """The same, whose kind tells its size where it is the name of a class."""
        return replace(self, vehicle_class=class_of_kind(self.kind))

    @property
    def observation(self) -> Observation:
        """What `fgrecon.reconstruct` takes; without confidences each point is as likely right as wrong."""
        observation = Observation.of(
            self.keypoints, self.confidence, self.box, self.covariance, self.confidence_midpoint, self.azimuth
        )
        evidence = () if self.vehicle_class is None else (self.vehicle_class,)
        return replace(observation, image_size=self.image_size, evidence=evidence)


@dataclass(frozen=True)
class KeypointFile:
    """The content of a file."""

    instances: tuple[Instance, ...]  # at least one, with distinct names
    ignored: tuple[str, ...]  # names of fields that mean nothing to fgrecon
    left_out: tuple[InvalidInputError, ...] = ()  # why instances were left out, each with its place
    # keypoints of instances that the category does not have, which were left out, with their places
    unknown: tuple[InvalidInputError, ...] = ()


def parse_keypoints(data: Any, category: Category, where: str = "") -> KeypointFile:
    """Check the content of a file and turn it into instances.

    Args:
        data: What the JSON file holds; the error in the place of an instance that cannot be used.
        category: The category whose keypoints it holds.

    Raises:
        InvalidInputError: These are results, or no instance can be used: a field is missing or of the wrong kind.
    """
    refuse_results(data, where)
    records, camera, size, ignored = [data], None, None, set[str]()
    if isinstance(data, list):
        records = data
    elif isinstance(data, Mapping) and "instances" in data:
        fields = Fields(data, where)
        records, camera, size = fields.get("instances", list), parse_camera(fields), _stated_size(fields)
        ignored |= set(data) - _FILE_FIELDS
    if not records:
        raise InvalidInputError(f"{where}instances", records, "Give at least one instance.")
    instances, left_out, unknown = dict[str, Instance](), list[InvalidInputError](), list[InvalidInputError]()
    for position, record in enumerate(records):
        place = where if record is data else f"{where}instance {position}: "
        try:
            if isinstance(record, InvalidInputError):
                raise record
            fields = Fields(record, place)
            instance = _instance(fields, str(position), category, camera)
            if instance.name in instances:
                raise InvalidInputError(f"{place}id", instance.name, "Give every instance an id of its own.")
        except InvalidInputError as error:
            left_out.append(error)
            continue
        instances[instance.name] = instance if instance.image_size else replace(instance, image_size=size)
        ignored |= set(record) - _INSTANCE_FIELDS - _DETECTOR_FIELDS
        if names := _unknown_keypoints(record["keypoints"], category):
            unknown.append(InvalidInputError(f"{place}keypoints", ", ".join(names), _names_fix(category)))
    if not instances:
        raise left_out[0]
    return KeypointFile(tuple(instances.values()), tuple(sorted(ignored)), tuple(left_out), tuple(unknown))


def _stated_size(fields: Fields) -> tuple[int, int] | None:
    """Width and height in pixels that a file or an instance states of its image."""
    named = {"image_size": fields.data["image_size"]} if "image_size" in fields else {}
    return read_size(Fields(named, fields.where))


def _unknown_keypoints(given: Any, category: Category) -> list[str]:
    """Names among those given that are no keypoint of the category."""
    return [str(name) for name in given if name not in category.keypoints] if isinstance(given, Mapping) else []


def _names_fix(category: Category) -> str:
    ours = ", ".join(category.keypoints)
    return f"Use the keypoints of {category.name} ({ours}), say which one it is by `names` (--names), or take it out."


def _instance(fields: Fields, name: str, category: Category, camera: Camera | None) -> Instance:
    if "id" in fields:
        identity = fields.data["id"]
        number = plain_id(identity)
        if number is None:
            raise InvalidInputError(f"{fields.where}id", identity, "Give a text or an integer.")
        name = identity if isinstance(identity, str) else str(number)
    keypoints, confidence = _keypoints(fields, category)
    midpoint = fields.numbers("confidence_midpoint", ()) if "confidence_midpoint" in fields else None
    return Instance(
        name=name,
        keypoints=keypoints,
        confidence=confidence,
        confidence_midpoint=None if midpoint is None else float(midpoint),
        box=fields.numbers("box", (4,)) if "box" in fields else None,
        covariance=_per_keypoint(fields, "covariance", category, (2, 2)) if "covariance" in fields else None,
        azimuth=_azimuth(fields),
        initial=_initial(fields) if "initial" in fields else None,
        camera=parse_camera(fields) or camera,
        image=fields.get("image", str) if "image" in fields else None,
        frame=fields.whole("frame") if "frame" in fields else None,
        track=_track(fields),
        kind=one_word(fields.where + "kind", fields.get("kind", str)) if "kind" in fields else None,
        score=float(fields.numbers("score", ())) if "score" in fields else None,
        image_size=_stated_size(fields),
    )


def _track(fields: Fields) -> int | None:
    """Id through the frames; -1 is none, as KITTI has it."""
    track = fields.whole("track", least=_NO_TRACK) if "track" in fields else _NO_TRACK
    return None if track == _NO_TRACK else track


def _azimuth(fields: Fields) -> Array | None:
    """(A,) probabilities of directions; null is none."""
    given = fields.data.get("azimuth")
    return None if given is None else fields.numbers("azimuth", (len(given) if isinstance(given, list) else 1,))


def _keypoints(fields: Fields, category: Category) -> tuple[Array, Array | None]:
    """Pixels (K, 2), and confidences (K,) from the third numbers or from their own field."""
    given = fields.data.get("keypoints")
    rows = given.values() if isinstance(given, Mapping) else given if isinstance(given, list) else ()
    width = max((len(row) for row in rows if isinstance(row, list) and len(row) in (2, 3)), default=2)
    keypoints = _per_keypoint(fields, "keypoints", category, (width,))
    confidence = _per_keypoint(fields, "confidence", category, ()) if "confidence" in fields else None
    if width == 2:
        return keypoints, confidence
    if confidence is not None:
        fix = "Give confidences either here or as the third number of every keypoint."
        raise InvalidInputError(f"{fields.where}confidence", fields.data["confidence"], fix)
    return keypoints[:, :2], keypoints[:, 2]


def _per_keypoint(fields: Fields, field: str, category: Category, shape: tuple[int, ...]) -> Array:
    """(K, *shape) numbers, given in the category's order or by name; NaN where absent or null."""
    place = f"{fields.where}{field}"
    given = fields.data.get(field)
    if not isinstance(given, Mapping):
        if isinstance(given, list) and len(given) != category.size:
            fix = f"Give one for each of the {category.size} keypoints of {category.name}, or give them by name."
            raise InvalidInputError(place, f"{len(given)} elements", fix)
        return fields.numbers(field, (category.size, *shape), missing=True)
    unknown = _unknown_keypoints(given, category)
    if given and len(unknown) == len(given):
        raise InvalidInputError(place, ", ".join(unknown), _names_fix(category))
    array = np.full((category.size, *shape), np.nan)
    for name, value in given.items():
        if value is not None and name in category.keypoints:
            array[category.index(name)] = numbers(value, shape, f"{place}.{name}", missing=True)
    return array


def _initial(fields: Fields) -> Box3D | float:
    value = fields.data["initial"]
    place = f"{fields.where}initial"
    if not isinstance(value, Mapping):
        return float(numbers(value, (), place))
    box = Fields(value, f"{place}.")
    try:
        return Box3D(
            location=box.numbers("location", (3,)),
            rotation_y=float(box.numbers("rotation_y", ())),
            size=box.numbers("size", (3,)) if "size" in box else None,
        )
    except InvalidInputError as error:
        raise InvalidInputError(error.field.replace("box3d", place), error.value, error.fix) from error


def parse_camera(fields: Fields) -> Camera | None:
    """The camera of an instance or of all; None where its fields are absent."""
    matrices = [name for name in ("K", "intrinsics") if name in fields]
    if not matrices:
        if "distortion" in fields:
            raise InvalidInputError(f"{fields.where}distortion", fields.data["distortion"], "Give K beside it.")
        return None
    if len(matrices) > 1:
        raise InvalidInputError(f"{fields.where}intrinsics", fields.data["intrinsics"], "Give either K or intrinsics.")
    field = matrices[0]
    value = fields.data[field]
    short = field == "intrinsics" and isinstance(value, list) and not any(isinstance(row, list) for row in value)
    check_unused(fields, _INSTANCE_FIELDS | _DETECTOR_FIELDS)
    lens, size = read_lens(fields), read_size(fields)
    try:
        return Camera(Camera.of(fields.numbers(field, (4,) if short else (3, 3))).matrix, image_size=size, **lens)
    except InvalidInputError as error:
        name = error.field.replace("intrinsics", field).removeprefix(fields.where)
        raise InvalidInputError(f"{fields.where}{name}", error.value, error.fix) from error


_ROWS = (".jsonl", ".ndjson", ".parquet")


def refuse_other_file(path: Path) -> None:
    """Refuse a file whose name says that it holds no keypoints that are read whole."""
    refuse_unread(path, "file")
    ending = path.suffix.lower()
    if ending in VIDEOS:
        what, fix = "A video", "give it to `fgrecon run`, which follows cars, or to `fgrecon batch`."
    elif ending in IMAGES:
        what, fix = "An image", "give it to `fgrecon reconstruct`; images of a drive to `fgrecon run`."
    elif ending in _ROWS:
        what, fix = "A file of rows", "give it to `fgrecon batch`."
    else:
        return
    if path.is_file():  # else whoever opens it says so
        raise InvalidInputError("file", str(path), f"{what}: {fix}")


def refuse_results(data: Any, where: str) -> None:
    """Refuse what fgrecon has written, which has results in the place of keypoints."""
    kind = data.get("format") if isinstance(data, Mapping) else None
    if isinstance(kind, str) and kind.startswith("fgrecon."):
        fix = "These are results: give the keypoints. `fgrecon export` makes files for other programs of results."
        raise InvalidInputError(f"{where}format", kind, fix)
