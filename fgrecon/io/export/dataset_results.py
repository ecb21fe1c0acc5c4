"""Results as lines of KITTI and as JSON of COCO; the camera's poses over a run as lines of TUM and of KITTI."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.metrics import wrap_angle
from fgrecon.io.export.image_info import EVERY, ImageInfo, by_image, image_box, info_of, quaternion, score
from fgrecon.io.export.results import NamedResult
from fgrecon.io.kitti_files import UNKNOWN, Objects, format_results

_KITTI_KINDS = {kind.lower(): kind for kind in ("Car", "Van", "Truck", "Tram", "Misc")}
_COCO_CATEGORY = 1
_VISIBLE_PROBABILITY = 0.5  # keypoints above it have COCO's flag of visible ones


def kitti_text(results: Sequence[NamedResult]) -> str:
    """`kitti_objects` of the vehicles as lines."""
    return format_results(kitti_objects(results))


def kitti_objects(results: Sequence[NamedResult]) -> Objects:
    """One object per vehicle with a pose: kind, box, size, location in the label frame, yaw and score.

    Where the offset of the label frame is not known, the location is in the camera's.
    The kind is its detector's, else `Car`. The 2D box is the observed one, else that of the projected surface, cut at
    the image's edges. The score is its detector's, else the mean weight of the keypoints that the pose shows: it tells
    how much of what should be seen was found where it should be.

    Raises:
        InvalidInputError: The vehicles are of several images, each of which has a file of its own in KITTI.
    """
    solved = [item for item in results if item.solved]
    if len(images := {item.image for item in solved}) > 1:
        value = f"vehicles of {len(images)} images"
        fix = "Write a file for each image (fgrecon.io.export.export): KITTI's lines do not tell it. Or give .csv."
        raise InvalidInputError("results", value, fix)
    rows = [_row(item) for item in solved]
    kinds = [_KITTI_KINDS.get((item.kind or "Car").lower(), item.kind or "Car") for item in solved]
    return Objects.of_rows(kinds, np.array(rows))


def _row(item: NamedResult) -> list[float]:
    """The numeric columns of a result line."""
    result = item.result
    x, y, z = result.location - (0.0 if item.label_offset is None else item.label_offset)
    length, width, height = result.box_size
    yaw = result.rotation_y
    alpha = float(wrap_angle(yaw - np.arctan2(x, z)))
    return [UNKNOWN, UNKNOWN, alpha, *image_box(item), height, width, length, x, y, z, yaw, score(item)]


def coco_results_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """A JSON list with an entry for each vehicle.

    `image_id` is that of the images file, else the image's name (a number where it is one). A keypoint's flag is 2
    where it is probably seen and 1 where it is hidden. `cuboid` is as in fgrecon's keypoint labels; its corners are
    `null` behind the camera, and missing where no camera is known.
    """
    entries = []
    for image, items in by_image(results).items():
        number = info_of(image, images).image_id
        named: int | str = int(image) if image.isdecimal() else image
        entries += [_coco_entry(item, named if number is None else number) for item in items]
    return json.dumps(entries, allow_nan=False) + "\n"


def _coco_entry(item: NamedResult, image: int | str) -> dict[str, Any]:
    result = item.result
    flags = np.where(result.diagnostics.visibility >= _VISIBLE_PROBABILITY, 2, 1)
    pixels = result.pose.wireframe_uv
    box = image_box(item)
    low, high = box[:2], box[2:]
    return {
        "image_id": image,
        "category_id": _COCO_CATEGORY,
        "id": item.name,
        "keypoints": [n for (u, v), f in zip(pixels.tolist(), flags.tolist(), strict=True) for n in (u, v, f)],
        "bbox": [*low.tolist(), *(high - low).tolist()],
        "score": score(item),
        "cuboid": {
            **_corners(item),
            "location": result.location.tolist(),
            "rotation_y": result.rotation_y,
            "size": result.box_size.tolist(),
        },
    }


def _corners(item: NamedResult) -> dict[str, Any]:
    """(8, 2) pixels of the box, where the camera is known."""
    if item.camera is None:
        return {}
    pose = item.result.camera_T_object
    points = transform(pose, box_corners(item.result.box_size))
    ahead = points[:, 2] >= MIN_DEPTH
    pixels = item.camera.distort(item.camera.project(np.where(ahead[:, None], points, [0.0, 0.0, 1.0])))
    return {"corners": [uv if shown else None for uv, shown in zip(pixels.tolist(), ahead.tolist(), strict=True)]}


_FIX = "Give a run whose camera moves (--poses, --estimate-motion, a data set), or `world_T_camera` in --images."


def tum_text(images: Mapping[str, ImageInfo]) -> str:
    """Lines `time tx ty tz qx qy qz qw` of world_T_camera in order of time, seconds; without a pose there is none.

    Raises:
        InvalidInputError: No image has a pose, or one with a pose has no time; names it.
    """
    lines = {}
    for name, info, pose in _posed(images):
        if info.timestamp is None:
            raise InvalidInputError(f"images.{name}.timestamp", "nothing", "Give its time, or `--format kitti_poses`.")
        numbers = [*pose[:3, 3].tolist(), *quaternion(pose[:3, :3])]
        lines[info.timestamp] = " ".join(f"{value:.9f}" for value in (info.timestamp, *numbers))
    return "".join(f"{line}\n" for _, line in sorted(lines.items()))


def kitti_poses_text(images: Mapping[str, ImageInfo]) -> str:
    """A line an image: the twelve numbers of the upper rows of world_T_camera.

    Raises:
        InvalidInputError: An image has no pose, which a line of KITTI cannot say; names it.
    """
    lines = [pose[:3].ravel() for _, _, pose in _posed(images, whole=True)]
    return "".join(" ".join(f"{value:.12e}" for value in line) + "\n" for line in lines)


def _posed(
    images: Mapping[str, ImageInfo], *, whole: bool = False
) -> Iterator[tuple[str, ImageInfo, NDArray[np.float64]]]:
    """The images with a pose; with `whole` one without is refused."""
    found = [(name, info, info.world_T_camera) for name, info in images.items() if name != EVERY]
    missing = [name for name, _, pose in found if pose is None]
    if not found or len(missing) == len(found) or (whole and missing):
        raise InvalidInputError(f"images.{missing[0] if missing else EVERY}.world_T_camera", "nothing", _FIX)
    for name, info, pose in found:
        if pose is not None:
            yield name, info, pose
