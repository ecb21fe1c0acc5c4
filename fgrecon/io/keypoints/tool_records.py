"""Instances of annotation tools' own files: JSON, and CVAT's XML for images.

| from | a vehicle is | its points | hidden |
|---|---|---|---|
| Label Studio | a rectangle, and points whose `parentID` it is; else all of a task | parts of a hundred | - |
| labelme | shapes of one `group_id`; else all without one | shapes `point`, by their labels | the flag `hidden` |
| CVAT | a skeleton; or points and a box of one `group_id` | by their labels, but for those outside | `occluded` |
| OpenLABEL | an object of a frame with `point2d` | by their names | the boolean `visible` is false |
| scalabel, BDD100K | a label with a `graph` | the `category` of its nodes | `visibility` is N |
| Supervisely | a graph; its rectangle has the same `instance` | by the names of the nodes, but for disabled ones | - |
| datumaro | `points`; their `bbox` has the same group | by the categories of their label | visibility 1; 0 is none |
| FiftyOne | a `Keypoint`; the `Detection` has the same `index` | by `names`, else in their order | `confidence` |

Boxes are corners in pixels; OpenLABEL's is given by its centre, datumaro's by its corner and size, FiftyOne's too, in
parts of the image; one of Label Studio that is turned is the one around it. A point that is hidden is as likely right
as wrong.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.text import one_word
from fgrecon.io.json_fields import Fields, numbers, plain_id

Record = dict[str, Any]
Records = Iterator[tuple[Record | InvalidInputError, str]]

_HIDDEN = Observation.confidence_midpoint


def label_reader(data: Any) -> Callable[[Fields], Records] | None:
    """What reads the content of a JSON file of one of these kinds; None for others."""
    if not isinstance(data, Mapping):
        return None
    if isinstance(data.get("openlabel"), Mapping):
        return _openlabel
    if isinstance(data.get("items"), list) and isinstance(data.get("categories"), Mapping):
        return _datumaro
    if isinstance(data.get("objects"), list) and isinstance(data.get("size"), Mapping):
        return _supervisely
    if isinstance(data.get("samples"), list) and all(_is_map(one) and "filepath" in one for one in data["samples"]):
        return _fiftyone
    frames = data.get("frames")
    return _scalabel if isinstance(frames, list) and any("labels" in f for f in frames if _is_map(f)) else None


def _is_map(value: Any) -> bool:
    return isinstance(value, Mapping)


def _each(items: Mapping[Any, Any], make: Callable[[Any, Any], Record | None], where: str) -> Records:
    """The records of items that have points; one that is malformed is its error."""
    for key, item in items.items():
        try:
            record = make(key, item)
        except InvalidInputError as error:
            yield error, where
            continue
        if record is not None and record["keypoints"]:
            yield record, where


def _openlabel(fields: Fields) -> Records:
    content = fields.inner("openlabel")
    objects, streams = (content.data.get(name) or {} for name in ("objects", "streams"))
    frames = content.data.get("frames") or {"": {"objects": objects}}
    for number, frame in frames.items():
        where = f"{content.where}frames.{number}." if number else content.where
        shown = Fields(frame, where)
        properties = shown.data.get("frame_properties") or {}
        uris = [one.get("uri") for one in [*(properties.get("streams") or {}).values(), *streams.values()] if one]
        image = next(({"image": str(uri).rsplit("/", 1)[-1]} for uri in uris if uri), {})

        def made(key: str, item: Any, where: str = where, number: str = number, image: Record = image) -> Record | None:
            place = f"{where}objects.{key}."
            data = Fields(Fields(item or {}, place).data.get("object_data") or {}, f"{place}object_data.")
            points = dict(_openlabel_point(one, data.where) for one in data.data.get("point2d") or ())
            kind = Fields(objects.get(key) or {}, place).data.get("type") or "Car"
            record: Record = {"id": f"{number}:{key}" if number else key, "keypoints": points, "kind": one_word(kind)}
            for one in (data.data.get("bbox") or ())[:1]:
                u, v, width, height = Fields(one, f"{data.where}bbox.").numbers("val", (4,)).tolist()
                record["box"] = [u - width / 2, v - height / 2, u + width / 2, v + height / 2]
            return record | image

        yield from _each(shown.data.get("objects") or {}, made, where)


def _openlabel_point(item: Any, where: str) -> tuple[str, list[float]]:
    point = Fields(item, f"{where}point2d.")
    flags = (point.data.get("attributes") or {}).get("boolean") or ()
    hidden = any(flag.get("name") == "visible" and flag.get("val") is False for flag in flags)
    return point.get("name", str), [*point.numbers("val", (2,)).tolist(), _HIDDEN if hidden else 1.0]


def _scalabel(fields: Fields) -> Records:
    for frame in fields.each("frames"):
        image = str(frame.data.get("name", "")).rsplit("/", 1)[-1]

        def made(key: int, label: Fields, image: str = image) -> Record | None:
            nodes = label.inner("graph", needed=False).each("nodes", needed=False)
            record: Record = {"id": f"{image}:{label.data.get('id', key)}", "image": image}
            record["keypoints"] = {
                node.get("category", str): [
                    *node.numbers("location", (2,)).tolist(),
                    _HIDDEN if node.data.get("visibility") == "N" else 1.0,
                ]
                for node in nodes
            }
            record["kind"] = one_word(label.data.get("category") or "Car")
            if label.data.get("box2d") is not None:
                box = label.inner("box2d")
                record["box"] = [float(box.numbers(name, ())) for name in ("x1", "y1", "x2", "y2")]
            return record

        yield from _each(dict(enumerate(frame.each("labels", needed=False))), made, frame.where)


def _supervisely(fields: Fields) -> Records:
    found: dict[Any, list[Fields]] = defaultdict(list)
    for number, figure in enumerate(fields.each("objects")):
        found[plain_id(figure.data.get("instance")) or f"figure {number}"].append(figure)

    def made(key: Any, figures: list[Fields]) -> Record | None:
        record: Record = {"id": key, "keypoints": {}}
        for figure in figures:
            if figure.data.get("geometryType") == "graph":
                nodes = figure.inner("nodes")
                for name in nodes.data:
                    node = nodes.inner(name)
                    if not node.data.get("disabled"):
                        record["keypoints"][name] = node.numbers("loc", (2,)).tolist()
            elif figure.data.get("geometryType") == "rectangle":
                low, high = figure.inner("points").numbers("exterior", (2, 2))
                record["box"] = [*map(min, low, high), *map(max, low, high)]
            record["kind"] = one_word(figure.data.get("classTitle") or "Car")
        return record

    yield from _each(found, made, fields.where)


def _datumaro(fields: Fields) -> Records:
    categories = fields.inner("categories")
    of_kinds = categories.inner("label", needed=False).each("labels", needed=False)
    labels = [one.data.get("name") for one in of_kinds]
    of_points = categories.inner("points", needed=False).each("items", needed=False)
    names = {plain_id(one.data.get("label_id")): one.data.get("labels") for one in of_points}
    for entry in fields.each("items"):
        path = str(entry.inner("image", needed=False).data.get("path") or entry.data.get("id", ""))
        groups: dict[Any, list[Fields]] = defaultdict(list)
        for annotation in entry.each("annotations", needed=False):
            groups[plain_id(annotation.data.get("group")) or "0"].append(annotation)

        def made(key: Any, group: list[Fields], path: str = path) -> Record | None:
            record: Record = {"id": f"{path}:{key}", "image": path.rsplit("/", 1)[-1], "keypoints": {}}
            for one in group:
                label = plain_id(one.data.get("label_id"))
                if one.data.get("type") == "points":
                    record["keypoints"] |= _datumaro_points(one, names.get(label))
                elif one.data.get("type") == "bbox":
                    x, y, width, height = one.numbers("bbox", (4,)).tolist()
                    record["box"] = [x, y, x + width, y + height]
                if isinstance(label, int) and 0 <= label < len(labels):
                    record["kind"] = one_word(labels[label])
            return record

        yield from _each(groups, made, entry.where)


def _datumaro_points(points: Fields, names: Any) -> dict[str, list[float]]:
    if not isinstance(names, list):
        fix = "Give categories of points with a list of names for it."
        raise InvalidInputError(f"{points.where}label_id", points.data.get("label_id"), fix)
    values = points.numbers("points", (2 * len(names),)).reshape(-1, 2).tolist()
    visible = points.numbers("visibility", (len(names),)).tolist() if "visibility" in points else [2] * len(names)
    pairs = zip(names, values, visible, strict=True)
    return {str(name): [*value, _HIDDEN if seen == 1 else 1.0] for name, value, seen in pairs if seen}


def _fiftyone(fields: Fields) -> Records:
    for sample in fields.each("samples"):
        image = sample.get("filepath", str).replace("\\", "/").rsplit("/", 1)[-1]
        found: dict[Any, dict[str, Fields]] = defaultdict(dict)
        for name, content in sample.data.items():
            kind = content.get("_cls") if _is_map(content) else None
            if kind not in ("Detections", "Keypoints"):
                continue
            for at, label in enumerate(sample.inner(name).each(kind.lower())):
                index = plain_id(label.data.get("index"))
                found[f"{kind} {at}" if index is None else index][kind] = label

        def made(key: Any, labels: dict[str, Fields], sample: Fields = sample, image: str = image) -> Record | None:
            if "Keypoints" not in labels:
                return None
            about = sample.inner("metadata", needed=False)
            size = [about.whole(side, 1) for side in ("width", "height")]
            kind = labels["Keypoints"].data.get("label") or "Car"
            record: Record = {"id": f"{image}:{key}", "image": image, "kind": one_word(kind)}
            record["keypoints"] = _fiftyone_points(labels["Keypoints"], size)
            if "Detections" in labels:
                x, y, width, height = labels["Detections"].numbers("bounding_box", (4,)).tolist()
                record["box"] = [x * size[0], y * size[1], (x + width) * size[0], (y + height) * size[1]]
            return record

        yield from _each(found, made, sample.where)


def _fiftyone_points(label: Fields, size: list[int]) -> dict[str, list[float]]:
    """The points by name; FiftyOne has NaN for those that are not there."""
    points = label.get("points", list)
    names = label.get("names", list) if "names" in label else [str(at) for at in range(len(points))]
    trust = label.get("confidence", list) if "confidence" in label else [1.0] * len(points)
    if not len(points) == len(names) == len(trust):
        fix = f"Give as many names and confidences as the {len(points)} points."
        raise InvalidInputError(f"{label.where}names", f"{len(names)} and {len(trust)}", fix)
    found = {}
    for at, (name, point, sure) in enumerate(zip(names, points, trust, strict=True)):
        if isinstance(point, list) and any(value != value for value in point):
            continue
        u, v = numbers(point, (2,), f"{label.where}points[{at}]").tolist()
        found[str(name)] = [u * size[0], v * size[1], float(numbers(sure, (), f"{label.where}confidence[{at}]"))]
    return found


_HUNDRED = 100.0  # Label Studio's unit is a hundredth of the image


def is_tool_file(data: Any) -> bool:
    """Whether the content of a JSON file is that of an annotation tool."""
    if isinstance(data, Mapping):
        return label_reader(data) is not None or (isinstance(data.get("shapes"), list) and "imagePath" in data)
    return isinstance(data, list) and bool(data) and all(_is_task(item) for item in data)


def _is_task(item: Any) -> bool:
    return isinstance(item, Mapping) and isinstance(item.get("annotations"), list) and "data" in item


def tool_records(data: Any, where: str) -> Records:
    """The vehicles of `is_tool_file`'s content in the layout of a keypoint file; one that is malformed is its error."""
    if isinstance(data, Mapping):
        return (label_reader(data) or _labelme)(Fields(data, where))
    return _label_studio(data, where)


def _label_studio(tasks: Sequence[Any], where: str) -> Records:
    for number, task in enumerate(tasks):
        shown = Fields(task["data"], f"{where}[{number}].data.").data
        image = next((value for value in shown.values() if isinstance(value, str)), None)
        name = {} if image is None else {"image": image.rsplit("/", 1)[-1].partition("?")[0]}
        if task.get("predictions") and not task["annotations"]:
            fix = "Accept them in Label Studio (submit the task), and export the annotations."
            yield InvalidInputError(f"{where}[{number}].annotations", "predictions alone", fix), where
        for at, annotation in enumerate(task["annotations"]):
            place = f"{where}[{number}].annotations[{at}]."
            regions = _of_regions(Fields(annotation, place).get("result", list))
            made = partial(_of_region, f"{task.get('id', number)}:", name, place)
            yield from _each(regions, made, place)


def _of_regions(results: Sequence[Any]) -> dict[str, list[Any]]:
    """The regions of each vehicle, by the rectangle; of points without one all of a task."""
    boxes = [item for item in results if isinstance(item, Mapping) and item.get("type") == "rectanglelabels"]
    known = {str(box.get("id")) for box in boxes}
    only = next(iter(known)) if len(known) == 1 else "0"
    found: dict[str, list[Any]] = defaultdict(list)
    for item in results:
        kind = item.get("type") if isinstance(item, Mapping) else None
        if kind == "rectanglelabels":
            found[str(item.get("id"))].append(item)
        elif kind == "keypointlabels":
            parent = str(item.get("parentID"))
            found[parent if parent in known else only].append(item)
    return found


def _of_region(task: str, image: Record, where: str, key: str, items: Sequence[Any]) -> Record:
    record: Record = {"id": f"{task}{key}", **image, "keypoints": {}}
    for item in items:
        fields = Fields(item, f"{where}{item.get('id')}.")
        value = fields.inner("value")
        size = [float(fields.numbers(name, ())) / _HUNDRED for name in ("original_width", "original_height")]
        x, y = (float(value.numbers(name, ())) * unit for name, unit in zip("xy", size, strict=True))
        label = _first(value, str(item["type"]))
        if item["type"] == "keypointlabels":
            record["keypoints"][label] = [x, y]
            continue
        width, height = (float(value.numbers(n, ())) * u for n, u in zip(("width", "height"), size, strict=True))
        turn = math.radians(float(value.numbers("rotation", ()))) if "rotation" in value else 0.0
        across, down = (
            (width * math.cos(turn), width * math.sin(turn)),
            (-height * math.sin(turn), height * math.cos(turn)),
        )
        corners = [(x + i * across[0] + j * down[0], y + i * across[1] + j * down[1]) for i in (0, 1) for j in (0, 1)]
        us, vs = zip(*corners, strict=True)
        record |= {"box": [min(us), min(vs), max(us), max(vs)], "kind": one_word(label)}
    return record


def _first(value: Fields, name: str) -> str:
    labels = value.get(name, list)
    if not labels:
        raise InvalidInputError(f"{value.where}{name}", "none", "Give the label of the region.")
    return str(labels[0])


def _labelme(fields: Fields) -> Records:
    groups: dict[Any, list[Fields]] = defaultdict(list)
    for shape in fields.each("shapes"):
        groups[plain_id(shape.data.get("group_id"))].append(shape)
    name = Path(fields.get("imagePath", str).replace("\\", "/")).name

    def made(group: Any, shapes: list[Fields]) -> Record:
        record: Record = {"id": 0 if group is None else group, "keypoints": {}, "image": name}
        for shape in shapes:
            kind = shape.get("shape_type", str)
            if kind == "point":
                hidden = Fields(shape.data.get("flags") or {}, f"{shape.where}flags.").data.get("hidden") is True
                at = shape.numbers("points", (1, 2))[0].tolist()
                record["keypoints"][shape.get("label", str)] = [*at, _HIDDEN if hidden else 1.0]
            elif kind == "rectangle":
                low, high = shape.numbers("points", (2, 2))
                record["box"] = [*map(min, low, high), *map(max, low, high)]
                record["kind"] = one_word(shape.get("label", str))
        return record

    yield from _each(groups, made, fields.where)


def cvat_records(path: Path) -> Records:
    """The vehicles of CVAT's XML for images, as `tool_records` gives them."""
    try:
        root = ET.parse(path).getroot()  # noqa: S314  # expat bounds what entities may expand to
    except (OSError, ET.ParseError) as error:
        raise InvalidInputError(str(path), str(error), "Give an XML file of CVAT.") from error
    if root.tag != "annotations" or root.find("image") is None:
        raise InvalidInputError(str(path), root.tag, "Give CVAT's XML for images (CVAT for images 1.1).")
    for image in root.iter("image"):
        name, where = image.get("name", ""), f"{path}: image {image.get('name')}: "
        found: dict[str, Record] = {}
        try:
            for number, shape in enumerate(image):
                _take(shape, number, found, where)
        except InvalidInputError as error:
            yield error, where
            continue
        for key, record in found.items():
            if record["keypoints"]:
                yield {"id": f"{image.get('id', '')}:{key}", "image": Path(name).name} | record, where


def _take(shape: ET.Element, number: int, found: dict[str, Record], where: str) -> None:
    """Put a shape of an image to its vehicle."""
    group = shape.get("group_id")
    if shape.tag == "skeleton":
        record = found.setdefault(f"skeleton{number}" if group is None else group, {"keypoints": {}})
        record["kind"] = one_word(shape.get("label", ""))
        for point in shape.iter("points"):
            _point(point, record, where)
    elif shape.tag == "points":
        _point(shape, found.setdefault(group or "0", {"keypoints": {}}), where)
    elif shape.tag == "box" and group is not None:
        corners = [_number(shape, name, where) for name in ("xtl", "ytl", "xbr", "ybr")]
        found.setdefault(group, {"keypoints": {}})["box"] = corners


def _point(point: ET.Element, record: Record, where: str) -> None:
    if point.get("outside") == "1":
        return
    words = point.get("points", "").split(",")
    try:
        u, v = (float(word) for word in words)
    except ValueError:
        label = point.get("label")
        raise InvalidInputError(f"{where}{label}", point.get("points"), "Give one point: u,v.") from None
    hidden = [_HIDDEN] if point.get("occluded") == "1" else [1.0]
    record["keypoints"][point.get("label", "")] = [u, v, *hidden]


def _number(shape: ET.Element, name: str, where: str) -> float:
    try:
        return float(shape.get(name, ""))
    except ValueError:
        raise InvalidInputError(f"{where}{shape.tag}.{name}", shape.get(name), "Give a number.") from None
