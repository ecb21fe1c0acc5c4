"""Results as files of annotation tools, for people to correct.

| kind | images | 2D box | keypoints | hidden | one vehicle |
|---|---|---|---|---|---|
| `cvat` | all | `box` | a `skeleton` | `occluded` | `group_id` |
| `label_studio` | all | `rectanglelabels` | `keypointlabels` with the rectangle as parent | - | the parent |
| `scalabel` | all | `box2d` | a `graph` | `visibility` N | `id` |
| `labelme` | one | `rectangle` | `point` shapes | the flag `hidden` | `group_id` |
| `supervisely` | one | `rectangle`, whole pixels | a `graph`, whole pixels | - | `instance` |
| `datumaro` | all | `bbox` | `points` | visibility 1 | `group` |
| `fiftyone` | all | `Detection` in parts of the image | `Keypoint` with `names` | confidence below 0.5 | `index` |

Of the 3D box CVAT (`cuboid`, front first), datumaro (`cuboid_2d`) and FiftyOne (`Polyline`) have the corners' pixels,
where all are ahead, scalabel `box3d` in the camera's frame, by its centre; the others have nothing of it. The size of
the images must be known, by the results' camera, for all but CVAT and labelme: an `InvalidInputError` says so, and
where vehicles are of several images for a file of one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.lens import OPENCV
from fgrecon.io.export.image_info import (
    VISIBLE,
    ImageInfo,
    by_image,
    image_box,
    info_of,
    keypoint_names,
    score,
    track_of,
)
from fgrecon.io.export.results import NamedResult

_CVAT_CORNERS = ("tl1", "bl1", "tr1", "br1", "tl2", "bl2", "tr2", "br2")
_CVAT_ORDER = (7, 5, 6, 4, 3, 1, 2, 0)
"""Of `box_corners` (rear before front, bottom before top, right before left); left and right are the vehicle's."""
_HUNDRED = 100.0  # Label Studio's unit is a hundredth of the image


def cvat_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """CVAT's XML for images, version 1.1."""
    root = ET.Element("annotations")
    ET.SubElement(root, "version").text = "1.1"
    labels = ET.SubElement(ET.SubElement(ET.SubElement(root, "meta"), "task"), "labels")
    solved = [item for item in results if item.solved]
    kinds = dict.fromkeys(item.kind or "Car" for item in solved)
    for name in dict.fromkeys([*kinds, *(name for item in solved for name in keypoint_names(item))]):
        label = ET.SubElement(labels, "label")
        ET.SubElement(label, "name").text = name
        ET.SubElement(label, "type").text = "any" if name in kinds else "points"
        ET.SubElement(label, "attributes")
    for number, (name, items) in enumerate(by_image(results).items()):
        size = image_size(items)
        wide = {} if size is None else {"width": str(size[0]), "height": str(size[1])}
        known = info_of(name, images).image_id
        key = str(known if isinstance(known, int) else number)
        image = ET.SubElement(root, "image", {"id": key, "name": name, **wide})
        for group, item in enumerate(items, start=1):
            _cvat_shapes(image, item, str(group))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _cvat_shapes(image: ET.Element, item: NamedResult, group: str) -> None:
    shared = {"label": item.kind or "Car", "source": "auto", "z_order": "0", "group_id": group}
    skeleton = ET.SubElement(image, "skeleton", shared)
    for name, uv, visible in keypoints_of(item):
        u, v = uv.tolist()
        place = {"points": f"{u!r},{v!r}", "outside": "0", "occluded": str(int(not visible))}
        ET.SubElement(skeleton, "points", {"label": name, "source": "auto", **place})
    box = dict(zip(("xtl", "ytl", "xbr", "ybr"), map(repr, image_box(item).tolist()), strict=True))
    ET.SubElement(image, "box", {**shared, "occluded": "0", **box})
    pixels = corner_pixels(item)
    if pixels is not None:
        ends = dict(zip(_CVAT_CORNERS, pixels[list(_CVAT_ORDER)].tolist(), strict=True))
        placed = {f"{axis}{end}": repr(uv[i]) for end, uv in ends.items() for i, axis in enumerate("xy")}
        ET.SubElement(image, "cuboid", {**shared, "occluded": "0", **placed})


def label_studio_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """Label Studio's tasks with predictions, for the controls `box` and `keypoint` of an image."""
    tasks = []
    for number, (name, items) in enumerate(by_image(results).items(), start=1):
        size = known_size(name, items)
        regions = [region for item in items for region in _label_studio_regions(item, size)]
        scores = [score(item) for item in items]
        made = {"id": number, "result": regions, "score": float(np.mean(scores)), "model_version": "fgrecon"}
        tasks.append({"id": number, "data": {"image": name}, "annotations": [], "predictions": [made]})
    return json.dumps(tasks, allow_nan=False) + "\n"


def _label_studio_regions(item: NamedResult, size: tuple[int, int]) -> list[dict[str, Any]]:
    unit = _HUNDRED / np.array(size)
    shared: dict[str, Any] = {
        "to_name": "image",
        "image_rotation": 0,
        "original_width": size[0],
        "original_height": size[1],
    }
    low, high = np.clip(image_box(item).reshape(2, 2) * unit, 0.0, _HUNDRED)  # its schema takes nothing beyond
    extent = dict(zip(("width", "height"), (high - low).tolist(), strict=True))
    place = dict(zip("xy", low.tolist(), strict=True)) | extent | {"rotation": 0}
    box: dict[str, Any] = {
        "id": item.name,
        "type": "rectanglelabels",
        "from_name": "box",
        "score": score(item),
        "value": {**place, "rectanglelabels": [item.kind or "Car"]},
    }
    points: list[dict[str, Any]] = [
        {
            "id": f"{item.name}-{name}",
            "type": "keypointlabels",
            "from_name": "keypoint",
            "parentID": item.name,
            "value": {**dict(zip("xy", (uv * unit).tolist(), strict=True)), "width": 0.5, "keypointlabels": [name]},
        }
        for name, uv, _ in keypoints_inside(item, size)
    ]
    return [shared | region for region in [box, *points]]


def scalabel_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """Scalabel's frames, as BDD100K's; of a camera with a lens graph and box are in the image, as all pixels."""
    frames = []
    for number, (name, items) in enumerate(by_image(results).items()):
        width, height = known_size(name, items)
        time = info_of(name, images).timestamp
        frames.append(
            {
                "name": name,
                "url": None,
                "videoName": None,
                "frameIndex": number,
                "intrinsics": _intrinsics(items),
                "size": {"width": width, "height": height},
                **({} if time is None else {"timestamp": round(1000.0 * time)}),
                "labels": [_scalabel_label(item) for item in items],
            }
        )
    kinds = dict.fromkeys(item.kind or "Car" for item in results if item.solved)
    categories = [{"name": kind, "subcategories": None, "color": None} for kind in kinds]
    config = {"categories": categories, "imageSize": None, "attributes": None, "poseSigmas": None}
    return json.dumps({"frames": frames, "groups": None, "config": config}, allow_nan=False) + "\n"


def _scalabel_label(item: NamedResult) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation

    result = item.result
    length, width, height = result.box_size.tolist()
    pose = result.camera_T_object
    # Its library turns about the camera's y axis, then z, then x.
    about_y, about_z, about_x = Rotation.from_matrix(pose[:3, :3]).as_euler("yzx").tolist()
    x, _, z = pose[:3, 3]
    nodes = [
        {"id": name, "category": name, "location": uv.tolist(), "visibility": "V" if shown else "N", "type": "keypoint"}
        for name, uv, shown in keypoints_of(item)
    ]
    names = keypoint_names(item)
    edges = [{"source": names[a], "target": names[b]} for a, b in result.shape.edges.tolist()]
    return {
        "id": track_of(item),
        "category": item.kind or "Car",
        "score": score(item),
        "poly2d": None,
        "rle": None,
        "box2d": dict(zip(("x1", "y1", "x2", "y2"), image_box(item).tolist(), strict=True)),
        "box3d": {
            "alpha": float(about_y - np.arctan2(x, z)),
            "orientation": [about_x, about_y, about_z],
            "location": (pose[:3, 3] - pose[:3, 1] * height / 2.0).tolist(),
            "dimension": [height, width, length],
        },
        "graph": {"nodes": nodes, "edges": edges, "type": "Pose2D"},
    }


def _intrinsics(items: Sequence[NamedResult]) -> dict[str, Any] | None:
    camera = _camera(items)
    if camera is None or (camera.distortion is not None and camera.distortion_model != OPENCV):
        return None
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    k1, k2, p1, p2, k3 = [*([] if camera.distortion is None else camera.distortion.tolist()), *[0.0] * 5][:5]
    return {"focal": [fx, fy], "center": [cx, cy], "skew": skew, "radial": [k1, k2, k3], "tangential": [p1, p2]}


def keypoints_of(item: NamedResult) -> list[tuple[str, Array, bool]]:
    """Names, pixels and whether they are probably seen, of the keypoints."""
    visible = (item.result.diagnostics.visibility >= VISIBLE).tolist()
    return list(zip(keypoint_names(item), item.result.pose.wireframe_uv, visible, strict=True))


def keypoints_inside(item: NamedResult, size: tuple[int, int]) -> list[tuple[str, Array, bool]]:
    """Those in the image: Label Studio takes no others, and Supervisely drops all of a vehicle for one that is not."""
    last = np.subtract(size, 1.0)
    return [one for one in keypoints_of(item) if ((one[1] >= 0.0) & (one[1] <= last)).all()]


def _camera(items: Sequence[NamedResult]) -> Camera | None:
    return next((item.camera for item in items if item.camera is not None), None)


def image_size(items: Sequence[NamedResult]) -> tuple[int, int] | None:
    """Width and height of the image that vehicles are of; None where it is not known."""
    camera = _camera(items)
    return None if camera is None else camera.image_size


def known_size(name: str, items: Sequence[NamedResult]) -> tuple[int, int]:
    """Width and height of an image."""
    size = image_size(items)
    if size is None:
        fix = "Give results whose camera knows the size of its images (`image_size`), or another --format."
        raise InvalidInputError("results", f"an image of unknown size, {name}", fix)
    return size


def corner_pixels(item: NamedResult) -> Array | None:
    """(8, 2) pixels of the box's corners; None without a camera, or where one is behind it."""
    corners = transform(item.result.camera_T_object, box_corners(item.result.box_size))
    if item.camera is None or not (corners[:, 2] >= MIN_DEPTH).all():
        return None
    return item.camera.distort(item.camera.project(corners))


_RING = [7, 6, 2, 3, 5, 4, 0, 1]
"""Of `box_corners`: the top's front left, front right, rear right and rear left, then the bottom's below them."""
_FACES = ([5, 4, 6, 7], [1, 0, 2, 3], [7, 6, 2, 3], [5, 4, 0, 1])
"""Of `box_corners`: the front, the rear, the top and the bottom, each round."""


def labelme_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:  # noqa: ARG001 - as all
    """A file of labelme for an image, to be put beside it."""
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
    """Supervisely's annotation of an image; its project has for each kind `Car` with the keypoints, and `Car box`."""
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
    """The own file of datumaro, for its folder `annotations`."""
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
    """FiftyOne's `samples.json`: each sample is one for `fiftyone.Sample.from_dict`."""
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
    """The image that all vehicles are of, and the vehicles."""
    found = by_image(results)
    if len(found) != 1:
        fix = f"Write a file for each image (fgrecon.io.export.export): {tool} has them so."
        raise InvalidInputError("results", f"vehicles of {len(found)} images", fix)
    return next(iter(found.items()))


def _kind(item: NamedResult) -> str:
    return item.kind or "Car"


def _json(content: Any) -> str:
    return json.dumps(content, allow_nan=False) + "\n"
