"""Keypoints of vehicles in images as COCO's JSON, with what else is known of them beside COCO's own fields.

Any reader of COCO keypoints takes the file; `read_coco_keypoints` reads all of it. A keypoint's flag is 2 where it is
probably seen, 1 where it is hidden, and 0, with u = v = 0, where it lies outside the image. Numbers have six digits,
vertices millimetres.

Images are named relative to the file's folder, so that both can move together. A path as it was given may go through
links: a data folder that is one. As long as the file is on the same side of the link its name is short, and stays right
when the link leads elsewhere; where `..` would be that of another folder than it looks, since the file's own folder is
behind a link, links are followed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.repr import brief_repr
from fgrecon.io.files import behind_links, write_text
from fgrecon.io.json_fields import Fields, numbers, read_fields

COCO_KEYPOINTS_FORMAT = "fgrecon.keypoint_labels/1"

SEEN = 0.5
"""A keypoint of at least this probability is flagged as visible."""

_CATEGORY = _LICENSE = 1
_CORNERS = 8
_LABELLED, _RECONSTRUCTED = "labelled", "reconstructed"  # where a cuboid is from
_FLAGS = 0, 1, 2


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """An image and its camera."""

    path: Path  # Its file
    size: tuple[int, int]  # Width and height, pixels
    matrix: Array  # (3, 3) camera matrix, pixels
    drive: str  # Name of the drive or folder that it belongs to
    frame: int  # Its number there

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class VehicleLabel:
    """A vehicle in an image. Camera frame: x right, y down, z forward, metres."""

    image: LabelledImage
    track: int  # Number of the vehicle within its drive
    kind: str  # Such as `Car`
    box: Array  # (4,) 2D box x1, y1, x2, y2, pixels
    keypoints: Array  # (K, 2) pixels, hidden ones as well; NaN where read back from outside the image
    probability: Array  # (K,) that each can be seen
    covariance: Array  # (K, 2, 2) of the keypoints, square pixels
    # (8, 2) pixels of the 3D box: rear before front, bottom before top, right before left, the last changing fastest;
    # NaN behind the camera
    corners: Array
    location: Array  # (3,) centre of the bottom face, camera frame
    rotation_y: float  # Yaw about the camera's y axis, radians; 0 where the vehicle faces camera +x
    size: Array  # (3,) length, width and height, metres
    azimuth: float  # Direction from the vehicle to the camera, radians; 0 ahead of it, pi / 2 to its left
    agreement: float  # Share of the network's confidence that agrees with the keypoints
    # Polygons (N, 2) in pixels, where the vehicle is seen; none where no part of it is
    silhouette: tuple[Array, ...] = ()
    vertices: Array | None = None  # (V, 3) surface, camera frame; None where it is not kept
    boxed: bool = True  # Whether its 3D box was labelled; else it was reconstructed

    __repr__ = brief_repr

    @property
    def flags(self) -> NDArray[np.int64]:
        """(K,) COCO's flags: 2 visible, 1 hidden, 0 outside the image."""
        width, height = self.image.size
        with np.errstate(invalid="ignore"):  # points outside that were read back
            inside = (self.keypoints >= -0.5) & (self.keypoints < [width - 0.5, height - 0.5])
        return np.where(inside.all(axis=1), np.where(self.probability >= SEEN, 2, 1), 0)


@dataclass(frozen=True, eq=False)
class VehicleLabels:
    """All that a file holds."""

    category: str  # Name of the category
    keypoints: tuple[str, ...]  # Names of its K keypoints
    skeleton: tuple[tuple[int, int], ...]  # Pairs of keypoints to draw, from 0
    vehicles: tuple[VehicleLabel, ...]  # The labels
    faces: NDArray[np.int64] | None = None  # (F, 3) triangles of every vehicle's surface, or None
    info: Mapping[str, str] = field(default_factory=dict)  # What made them, in words
    terms: str = ""  # Of the images, in words; empty where they are not given

    __repr__ = brief_repr


def write_coco_keypoints(path: str | Path, labels: VehicleLabels, *, meshes: bool = False) -> Path:
    """Write labels, whole or not at all; images are named relative to the file's folder, by their paths as given.

    Args:
        labels: What it shall hold.
        meshes: Whether to write the surfaces.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: There is no label, a surface is wanted that is not there, or the file cannot be written.
    """
    if not labels.vehicles:
        raise InvalidInputError("labels.vehicles", "none", "Give at least one.")
    if meshes and (labels.faces is None or any(vehicle.vertices is None for vehicle in labels.vehicles)):
        raise InvalidInputError("meshes", "a vehicle without a surface", "Give each its vertices, and the faces.")
    folder = _folder_of(Path(path))
    images: dict[Path, dict[str, Any]] = {}
    annotations = []
    for number, vehicle in enumerate(labels.vehicles, start=1):
        at = _place_of(vehicle.image.path)
        if at not in images:
            images[at] = _image(vehicle.image, _name_from(folder, vehicle.image.path), len(images) + 1)
            if labels.terms:
                images[at]["license"] = _LICENSE
        annotations.append(_annotation(vehicle, number, images[at]["id"], meshes=meshes))
    category: dict[str, Any] = {
        "id": _CATEGORY,
        "name": labels.category,
        "supercategory": "vehicle",
        "keypoints": list(labels.keypoints),
        "skeleton": [[a + 1, b + 1] for a, b in labels.skeleton],  # COCO counts from 1
    }
    if meshes and labels.faces is not None:
        category["mesh_faces"] = labels.faces.tolist()
    document = {
        "format": COCO_KEYPOINTS_FORMAT,
        "info": dict(labels.info),
        "licenses": [{"id": _LICENSE, "name": labels.terms, "url": ""}] if labels.terms else [],
        "images": list(images.values()),
        "categories": [category],
        "annotations": annotations,
    }
    return write_text(path, json.dumps(document, allow_nan=False) + "\n")


def _image(image: LabelledImage, name: str, number: int) -> dict[str, Any]:
    width, height = image.size
    return {
        "id": number,
        "file_name": name,
        "width": width,
        "height": height,
        "camera_matrix": image.matrix.tolist(),
        "drive": image.drive,
        "frame": image.frame,
    }


def _annotation(vehicle: VehicleLabel, number: int, image: int, *, meshes: bool) -> dict[str, Any]:
    x1, y1, x2, y2 = vehicle.box
    points, probability = np.array(_short(vehicle.keypoints)), np.array(_short(vehicle.probability))
    flags = replace(vehicle, keypoints=points, probability=probability).flags  # as a reader will tell them
    corners = _short(np.where(np.isfinite(vehicle.corners), vehicle.corners, 0.0))
    polygons = [_short(polygon.ravel()) for polygon in vehicle.silhouette]
    entry = {
        "id": number,
        "image_id": image,
        "category_id": _CATEGORY,
        "bbox": _short([x1, y1, x2 - x1, y2 - y1]),
        "segmentation": polygons,
        "area": _short(sum(map(_area, polygons)) or (x2 - x1) * (y2 - y1)),
        "iscrowd": 0,
        "num_keypoints": int((flags > 0).sum()),
        "keypoints": [x for (u, v), f in zip(points.tolist(), flags.tolist(), strict=True) for x in _flagged(u, v, f)],
        "keypoint_probability": probability.tolist(),
        "keypoint_covariance": _short(vehicle.covariance),
        "track_id": vehicle.track,
        "kind": vehicle.kind,
        "cuboid": {
            "corners": [
                corner if known else None
                for corner, known in zip(corners, np.all(np.isfinite(vehicle.corners), axis=1), strict=True)
            ],
            "location": _short(vehicle.location),
            "rotation_y": _short(vehicle.rotation_y),
            "size": _short(vehicle.size),
            "source": _LABELLED if vehicle.boxed else _RECONSTRUCTED,
        },
        "azimuth": _short(vehicle.azimuth),
        "agreement": _short(vehicle.agreement),
    }
    if meshes and vehicle.vertices is not None:
        entry["mesh"] = np.round(vehicle.vertices, 3).tolist()
    return entry


def _area(polygon: Sequence[float]) -> float:
    """Of COCO's polygon u, v, u, v, ... that does not cross itself (the shoelace formula)."""
    u, v = (np.reshape(polygon, (-1, 2)) - polygon[:2]).T
    return 0.5 * abs(float(u @ np.roll(v, -1) - v @ np.roll(u, -1)))


def _flagged(u: float, v: float, flag: int) -> tuple[float, float, int]:
    """COCO's three numbers of a keypoint."""
    return (u, v, flag) if flag else (0.0, 0.0, 0)


def _short(value: Any) -> Any:
    """Nested lists of numbers with six digits."""
    plain = value.tolist() if isinstance(value, np.ndarray | np.floating) else value
    return [_short(item) for item in plain] if isinstance(plain, list) else float(f"{plain:.6g}")


def read_coco_keypoints(path: str | Path) -> VehicleLabels:
    """Read what `write_coco_keypoints` wrote; the images are not opened."""
    source = Path(path)
    top = read_fields(source)
    if top.data.get("format") != COCO_KEYPOINTS_FORMAT:
        fix = "Give what `fgrecon keypoints label` wrote."
        raise InvalidInputError(f"{source}: format", top.data.get("format"), fix)
    if len(top.get("categories", list)) != 1:
        raise InvalidInputError(f"{source}: categories", f"{len(top.data['categories'])} entries", "Give one.")
    (category,) = top.each("categories")
    names = _texts(category, "keypoints")
    size = len(names)
    skeleton = _indices(category, "skeleton", 2, size + 1)
    if (skeleton < 1).any():
        raise InvalidInputError(f"{category.where}skeleton", 0, "Count keypoints from 1.")
    images: dict[int, LabelledImage] = {}
    for one in top.each("images"):
        images[one.get("id", int)] = _read_image(one, _folder_of(source))
    vehicles = [_read_annotation(item, images, size) for item in top.each("annotations")]
    faces = None
    if "mesh_faces" in category:
        count = min((len(v.vertices) for v in vehicles if v.vertices is not None), default=0)
        faces = _indices(category, "mesh_faces", 3, count)
    return VehicleLabels(
        category=category.get("name", str),
        keypoints=names,
        skeleton=tuple((int(a) - 1, int(b) - 1) for a, b in skeleton),
        vehicles=tuple(vehicles),
        faces=faces,
        info={key: str(value) for key, value in top.get("info", dict).items()},
        terms=_terms(top),
    )


def _terms(top: Fields) -> str:
    """The name of the first licence that the file has."""
    first = next(top.each("licenses", needed=False), None)
    return "" if first is None else str(first.get("name", str))


def _texts(fields: Fields, name: str) -> tuple[str, ...]:
    entries = fields.get(name, list)
    if not entries or not all(isinstance(entry, str) for entry in entries):
        raise InvalidInputError(f"{fields.where}{name}", entries, "Give a list of texts.")
    return tuple(entries)


def _indices(fields: Fields, name: str, width: int, below: int) -> NDArray[np.int64]:
    """(M, width) integers from 0 to less than `below`."""
    entries = fields.get(name, list)
    rows = fields.numbers(name, (len(entries), width))
    bad = rows[(rows != np.rint(rows)) | (rows < 0) | (rows >= below)]
    if len(bad):
        raise InvalidInputError(f"{fields.where}{name}", float(bad[0]), f"Give integers from 0 to {below - 1}.")
    return rows.astype(np.int64)


def _read_image(fields: Fields, folder: Path) -> LabelledImage:
    size = fields.get("width", int), fields.get("height", int)
    if min(size) < 1:
        raise InvalidInputError(f"{fields.where}width, height", size, "Give pixels, from 1.")
    return LabelledImage(
        path=_as_given(folder / fields.get("file_name", str)),
        size=size,
        matrix=fields.numbers("camera_matrix", (3, 3)),
        drive=fields.get("drive", str),
        frame=fields.get("frame", int),
    )


def _read_annotation(fields: Fields, images: Mapping[int, LabelledImage], size: int) -> VehicleLabel:
    image = images.get(fields.get("image_id", int))
    if image is None:
        raise InvalidInputError(f"{fields.where}image_id", fields.data["image_id"], "Give the id of an image.")
    x, y, width, height = fields.numbers("bbox", (4,))
    points = fields.numbers("keypoints", (3 * size,)).reshape(size, 3)
    if not np.isin(points[:, 2], _FLAGS).all():
        raise InvalidInputError(f"{fields.where}keypoints", points[:, 2].tolist(), "Give flags 0, 1 or 2.")
    probability = fields.numbers("keypoint_probability", (size,))
    if ((probability < 0) | (probability > 1)).any():
        raise InvalidInputError(f"{fields.where}keypoint_probability", probability.tolist(), "Give 0 to 1.")
    cuboid = fields.inner("cuboid")
    vertices = None
    if "mesh" in fields:
        mesh = fields.get("mesh", list)
        vertices = numbers(mesh, (len(mesh), 3), f"{fields.where}mesh")
    return VehicleLabel(
        image=image,
        track=fields.get("track_id", int),
        kind=fields.get("kind", str),
        box=np.array([x, y, x + width, y + height]),
        keypoints=np.where(points[:, 2:] > 0, points[:, :2], np.nan),
        probability=probability,
        covariance=fields.numbers("keypoint_covariance", (size, 2, 2)),
        corners=cuboid.numbers("corners", (_CORNERS, 2), missing=True),
        location=cuboid.numbers("location", (3,)),
        rotation_y=float(cuboid.numbers("rotation_y", ())),
        size=cuboid.numbers("size", (3,)),
        azimuth=float(fields.numbers("azimuth", ())),
        agreement=float(fields.numbers("agreement", ())),
        silhouette=_polygons(fields),
        vertices=vertices,
        boxed=cuboid.data.get("source", _LABELLED) == _LABELLED,
    )


def _polygons(fields: Fields) -> tuple[Array, ...]:
    polygons = []
    for number, corners in enumerate(fields.get("segmentation", list)):
        place = f"{fields.where}segmentation[{number}]"
        count = len(corners) // 2 if isinstance(corners, list) else 0
        if count < 3:
            raise InvalidInputError(place, corners, "Give x and y of three corners at least, one after the other.")
        polygons.append(numbers(corners, (2 * count,), place).reshape(-1, 2))
    return tuple(polygons)


def _place_of(path: Path) -> Path:
    """Where a file lies: its folder's links followed, since `..` is of where they lead, and its own not.

    Several images may be links to one file of a store.
    """
    return path.parent.resolve() / path.name


def _as_given(path: Path) -> Path:
    """An absolute path without `..`, its links not followed; as `place_of` where only that leads to the same folder."""
    plain = Path(os.path.normpath(path.absolute()))
    return plain if plain.parent.resolve() == path.parent.resolve() else _place_of(path)


def _folder_of(file: Path) -> Path:
    """The folder of a file, that of what it is a link to."""
    return _as_given(behind_links(file) if file.is_symlink() else file).parent


def _name_from(folder: Path, image: Path) -> str:
    """An image's path from a folder (`folder_of`), with `/` between its parts."""
    given = Path(os.path.relpath(_as_given(image), folder))
    if (folder / given).parent.resolve() != image.parent.resolve():
        given = Path(os.path.relpath(_place_of(image), folder.resolve()))
    return given.as_posix()
