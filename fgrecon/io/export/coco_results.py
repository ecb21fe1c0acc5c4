"""Results as COCO's list of keypoint results, which `loadRes` of pycocotools takes, with the cuboid beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.geometry import transform
from fgrecon.io.export.frames import ImageInfo, by_image, info_of, score
from fgrecon.io.export.results import NamedResult

__all__ = ["coco_results_text"]

_CATEGORY = 1
_VISIBLE = 0.5


def coco_results_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """A JSON list with an entry for each vehicle.

    `image_id` is that of the images file, else the image's name (a number where it is one). A keypoint's flag is 2
    where it is probably seen and 1 where it is hidden. `cuboid` is as in fgrecon's keypoint labels; its corners are
    `null` behind the camera, and missing where no camera is known.

    Args:
        results: Vehicles; those without a pose are left out.
        images: What is known of their images.
    """
    entries = []
    for image, items in by_image(results).items():
        number = info_of(image, images).image_id
        named: int | str = int(image) if image.isdecimal() else image
        entries += [_entry(item, named if number is None else number) for item in items]
    return json.dumps(entries, allow_nan=False) + "\n"


def _entry(item: NamedResult, image: int | str) -> dict[str, Any]:
    result = item.result
    flags = np.where(result.visibility >= _VISIBLE, 2, 1)
    pixels = result.wireframe_uv
    low, high = (pixels.min(axis=0), pixels.max(axis=0)) if item.box is None else (item.box[:2], item.box[2:])
    return {
        "image_id": image,
        "category_id": _CATEGORY,
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
    return {"corners": [uv if seen else None for uv, seen in zip(pixels.tolist(), ahead.tolist(), strict=True)]}
