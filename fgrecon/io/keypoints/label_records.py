"""Instances of files of labels: OpenLABEL, scalabel (and BDD100K), Supervisely, datumaro, FiftyOne.

| from | a vehicle is | its points | hidden |
|---|---|---|---|
| OpenLABEL | an object of a frame with `point2d` | by their names | the boolean `visible` is false |
| scalabel | a label with a `graph` | the `category` of its nodes | `visibility` is N |
| Supervisely | a graph; its rectangle has the same `instance` | by the names of the nodes, but for disabled ones | - |
| datumaro | `points`; their `bbox` has the same group | by the categories of their label | visibility 1; 0 is none |
| FiftyOne | a `Keypoint`; the `Detection` has the same `index` | by `names`, else in their order | `confidence` |

Boxes are corners in pixels; OpenLABEL's is given by its centre, datumaro's by its corner and size, FiftyOne's too,
in parts of the image. A point that is
hidden is as likely right as wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any

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
