"""Results as files of labels of more tools: labelme, Supervisely, datumaro, FiftyOne.

| kind | images | 2D box | keypoints | hidden | one vehicle |
|---|---|---|---|---|---|
| `labelme` | one | `rectangle` | `point` shapes | the flag `hidden` | `group_id` |
| `supervisely` | one | `rectangle`, whole pixels | a `graph`, whole pixels | - | `instance` |
| `datumaro` | all | `bbox` | `points` | visibility 1 | `group` |
| `fiftyone` | all | `Detection` in parts of the image | `Keypoint` with `names` | confidence below 0.5 | `index` |

Of the 3D box datumaro (`cuboid_2d`) and FiftyOne (`Polyline`) have the corners' pixels, where all are ahead; the
others have nothing of it. The size of the images must be known, by the results' camera, for all but labelme.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.annotation_files import (
    corner_pixels,
    image_size,
    keypoints_inside,
    keypoints_of,
    known_size,
)
from fgrecon.io.export.image_info import ImageInfo, by_image, image_box, keypoint_names, score
from fgrecon.io.export.results import NamedResult

_RING = [7, 6, 2, 3, 5, 4, 0, 1]
"""Of `box_corners`: the top's front left, front right, rear right and rear left, then the bottom's below them."""
_FACES = ([5, 4, 6, 7], [1, 0, 2, 3], [7, 6, 2, 3], [5, 4, 0, 1])
"""Of `box_corners`: the front, the rear, the top and the bottom, each round."""


def labelme_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """A file of labelme for an image, to be put beside it.

    Raises:
        InvalidInputError: The vehicles are of several images, each of which has a file.
    """
    name, items = one_image(results, "labelme")
    shapes: list[dict[str, Any]] = []
    for group, item in enumerate(items):
        box: dict[str, Any] = {
            "label": _kind(item),
            "shape_type": "rectangle",
            "points": image_box(item).reshape(2, 2).tolist(),
        }
        points = [
            {"label": label, "shape_type": "point", "points": [uv.tolist()], "flags": {"hidden": not visible}}
            for label, uv, visible in keypoints_of(item)
        ]
        shapes += [{"flags": {}, **shape, "group_id": group} for shape in (box, *points)]
    width, height = image_size(items) or (None, None)
    about: dict[str, Any] = {"version": "6.3.1", "flags": {}, "imagePath": name, "imageData": None}
    return _json({**about, "shapes": shapes, "imageHeight": height, "imageWidth": width})


def supervisely_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """Supervisely's annotation of an image; its project has `Car` with the keypoints, and `Car box` (so for each kind).

    Raises:
        InvalidInputError: The vehicles are of several images, or the size of theirs is not known.
    """
    name, items = one_image(results, "Supervisely")
    width, height = known_size(name, items)
    objects: list[dict[str, Any]] = []
    for item in items:
        low, high = np.round(image_box(item)).astype(int).reshape(2, 2).tolist()
        nodes = {
            label: {"loc": np.round(uv).astype(int).tolist()}
            for label, uv, _ in keypoints_inside(item, (width, height))
        }
        box: dict[str, Any] = {"shape": "rectangle", "points": {"exterior": [low, high], "interior": []}}
        shapes = {f"{_kind(item)} box": box, _kind(item): {"shape": "graph", "nodes": nodes}}
        objects += [
            {"classTitle": title, "tags": [], "geometryType": shape["shape"], **shape, "instance": item.name}
            for title, shape in shapes.items()
        ]
    return _json({"description": "", "size": {"height": height, "width": width}, "tags": [], "objects": objects})


def datumaro_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """The own file of datumaro, for its folder `annotations`.

    Raises:
        InvalidInputError: The size of an image is not known.
    """
    found = by_image(results)
    vehicles = [item for items in found.values() for item in items]
    kinds = list(dict.fromkeys(_kind(item) for item in vehicles))
    entries = []
    for name, items in found.items():
        width, height = known_size(name, items)
        shapes: list[dict[str, Any]] = []
        for group, item in enumerate(items, start=1):
            low, high = image_box(item).reshape(2, 2)
            points = keypoints_of(item)
            told = {"score": float(score(item))} | ({} if item.track is None else {"track_id": item.track})
            shared = {"label_id": kinds.index(_kind(item)), "group": group, "attributes": {}, "z_order": 0}
            box = [*low.tolist(), *(high - low).tolist()]
            shapes.append({"type": "bbox", "bbox": box, **shared, "attributes": told})
            pixels = [value for _, uv, _ in points for value in uv.tolist()]
            visible = [2 if seen else 1 for _, _, seen in points]
            shapes.append({"type": "points", "points": pixels, "visibility": visible, **shared})
            if (corners := corner_pixels(item)) is not None:
                shapes.append({"type": "cuboid_2d", "points": corners[_RING].tolist(), **shared})
        shapes = [{"id": number, **shape} for number, shape in enumerate(shapes)]
        image = {"path": name, "size": [height, width]}
        entries.append({"id": name.rsplit(".", 1)[0], "annotations": shapes, "image": image})
    labels = [{"name": kind, "parent": "", "attributes": []} for kind in kinds]
    names = {_kind(item): list(keypoint_names(item)) for item in vehicles}
    points_of = [{"label_id": kinds.index(kind), "labels": found, "joints": []} for kind, found in names.items()]
    categories = {"label": {"labels": labels, "label_groups": [], "attributes": []}, "points": {"items": points_of}}
    about = {"dm_format_version": "1.0", "media_type": 2, "infos": {}}
    return _json({**about, "categories": categories, "items": entries})


def fiftyone_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """FiftyOne's `samples.json`: each sample is one for `fiftyone.Sample.from_dict`.

    Raises:
        InvalidInputError: The size of an image is not known.
    """
    samples = []
    for name, items in by_image(results).items():
        size = known_size(name, items)
        boxes, points, cuboids = [], [], []
        for number, item in enumerate(items):
            index = number if item.track is None else item.track
            low, high = image_box(item).reshape(2, 2) / size
            shared = {"label": _kind(item), "index": index, "tags": [], "attributes": {}}
            box = [*low.tolist(), *(high - low).tolist()]
            boxes.append({"_cls": "Detection", **shared, "bounding_box": box, "confidence": float(score(item))})
            pairs = [(uv / size).tolist() for uv in item.result.pose.wireframe_uv]
            visibility = item.result.diagnostics.visibility.tolist()
            names = list(keypoint_names(item))
            points.append({"_cls": "Keypoint", **shared, "points": pairs, "confidence": visibility, "names": names})
            if (corners := corner_pixels(item)) is not None:
                faces = [(corners[face] / size).tolist() for face in _FACES]
                cuboids.append({"_cls": "Polyline", **shared, "points": faces, "closed": True, "filled": False})
        samples.append(
            {
                "filepath": name,
                "tags": [],
                "metadata": {"_cls": "ImageMetadata", "width": size[0], "height": size[1]},
                "detections": {"_cls": "Detections", "detections": boxes},
                "keypoints": {"_cls": "Keypoints", "keypoints": points},
                "cuboids": {"_cls": "Polylines", "polylines": cuboids},
            }
        )
    return _json({"samples": samples})


def one_image(results: Sequence[NamedResult], tool: str) -> tuple[str, list[NamedResult]]:
    """The image that all vehicles are of, and the vehicles.

    Raises:
        InvalidInputError: They are of several images.
    """
    found = by_image(results)
    if len(found) != 1:
        fix = f"Write a file for each image (fgrecon.io.export.export): {tool} has them so."
        raise InvalidInputError("results", f"vehicles of {len(found)} images", fix)
    return next(iter(found.items()))


def _kind(item: NamedResult) -> str:
    return item.kind or "Car"


def _json(content: Any) -> str:
    return json.dumps(content, allow_nan=False) + "\n"
