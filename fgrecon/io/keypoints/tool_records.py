"""Instances of annotation tools' own files: Label Studio's tasks, labelme's files, CVAT's XML for images.

| from | a vehicle is | its points |
|---|---|---|
| Label Studio | a rectangle, and keypoints whose `parentID` it is; else all of a task | parts of a hundred |
| labelme | shapes of one `group_id`; else all without one | shapes `point`, by their labels; the flag `hidden` |
| CVAT | a skeleton; or points and a box of one `group_id` | by their labels, but for those outside |

OpenLABEL's and others' are in `label_records`.
A box of Label Studio that is turned is the one around it. A point that is hidden (`occluded` of CVAT) is as likely
right as wrong.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.text import one_word
from fgrecon.io.json_fields import Fields, plain_id
from fgrecon.io.keypoints.label_records import Records, label_reader

Record = dict[str, Any]
_HUNDRED = 100.0  # Label Studio's unit is a hundredth of the image


def is_tool_file(data: Any) -> bool:
    """Whether the content of a JSON file is that of an annotation tool."""
    if isinstance(data, Mapping):
        return label_reader(data) is not None or (isinstance(data.get("shapes"), list) and "imagePath" in data)
    return isinstance(data, list) and bool(data) and all(_is_task(item) for item in data)


def _is_task(item: Any) -> bool:
    return isinstance(item, Mapping) and isinstance(item.get("annotations"), list) and "data" in item


def tool_records(data: Any, where: str) -> Records:
    """The vehicles of `is_tool_file`'s content in the layout of a keypoint file; one that is malformed is its error.

    Args:
        data: The content of the file.
        where: What errors begin with.

    Raises:
        InvalidInputError: The file's frame is malformed; names the field.
    """
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
            results = Fields(annotation, place).get("result", list)
            for key, found in _of_regions(results).items():
                try:
                    record = _of_region(found, place)
                except InvalidInputError as error:
                    yield error, place
                    continue
                if record["keypoints"]:
                    yield {"id": f"{task.get('id', number)}:{key}"} | name | record, place


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


def _of_region(items: Sequence[Any], where: str) -> Record:
    record: Record = {"keypoints": {}}
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
    for group, shapes in groups.items():
        record: Record = {"id": 0 if group is None else group, "keypoints": {}}
        record["image"] = Path(fields.get("imagePath", str).replace("\\", "/")).name
        try:
            for shape in shapes:
                kind = shape.get("shape_type", str)
                if kind == "point":
                    hidden = Fields(shape.data.get("flags") or {}, f"{shape.where}flags.").data.get("hidden") is True
                    trust = Observation.confidence_midpoint if hidden else 1.0
                    record["keypoints"][shape.get("label", str)] = [*shape.numbers("points", (1, 2))[0].tolist(), trust]
                elif kind == "rectangle":
                    low, high = shape.numbers("points", (2, 2))
                    record["box"] = [*map(min, low, high), *map(max, low, high)]
                    record["kind"] = one_word(shape.get("label", str))
        except InvalidInputError as error:
            yield error, fields.where
            continue
        if record["keypoints"]:
            yield record, fields.where


def cvat_records(path: Path) -> Records:
    """The vehicles of CVAT's XML for images, as `tool_records` gives them.

    Raises:
        InvalidInputError: The file cannot be read, or is another XML; names it.
    """
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
    hidden = [Observation.confidence_midpoint] if point.get("occluded") == "1" else [1.0]
    record["keypoints"][point.get("label", "")] = [u, v, *hidden]


def _number(shape: ET.Element, name: str, where: str) -> float:
    try:
        return float(shape.get(name, ""))
    except ValueError:
        raise InvalidInputError(f"{where}{shape.tag}.{name}", shape.get(name), "Give a number.") from None
