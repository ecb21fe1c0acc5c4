"""Results as nuScenes takes them for its detection task: boxes in the world's frame, by sample."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.frames import ImageInfo, box_in, by_image, info_of, quaternion, score
from fgrecon.io.export.results import NamedResult

__all__ = ["nuscenes_text"]

_META = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": True}


def nuscenes_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of a submission. Velocities are zero and attributes empty: a single image tells neither.

    Args:
        results: Vehicles; those without a pose are left out.
        images: `sample_token` and `world_T_camera` of their images. A sample without a vehicle has an empty list.

    Raises:
        InvalidInputError: Either is missing for an image; names it.
    """
    found: dict[str, list[dict[str, Any]]] = {i.sample_token: [] for i in images.values() if i.sample_token}
    for image, items in by_image(results).items():
        info = info_of(image, images)
        for field in ("sample_token", "world_T_camera"):
            if getattr(info, field) is None:
                fix = "Give a file of images (--images) that tells it."
                raise InvalidInputError(f"images.{image or '*'}.{field}", "nothing", fix)
        assert info.sample_token is not None
        found.setdefault(info.sample_token, []).extend(_entry(item, info) for item in items)
    return json.dumps({"meta": _META, "results": found}, allow_nan=False) + "\n"


def _entry(item: NamedResult, info: ImageInfo) -> dict[str, Any]:
    length, width, height = item.result.box_size.tolist()
    centre, axes = box_in(info, item.result.camera_T_object, item.result.box_size)
    x, y, z, w = quaternion(axes)
    return {
        "sample_token": info.sample_token,
        "translation": centre.tolist(),
        "size": [width, length, height],
        "rotation": [w, x, y, z],
        "velocity": [0.0, 0.0],
        "detection_name": "car",
        "detection_score": score(item),
        "attribute_name": "",
    }
