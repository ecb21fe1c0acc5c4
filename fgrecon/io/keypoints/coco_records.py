"""Instances of COCO's keypoint JSON: annotations with their categories, and lists of results, as OpenPifPaf writes too.

The third number of a keypoint is COCO's flag (0 not labelled, 1 hidden, 2 visible) or a confidence from 0 to 1, where 0
is not found. A flag 2 becomes the confidence 1, a flag 1 that of a point as likely right as wrong. What
`fgrecon keypoints label` writes beside COCO's own fields is read as well: camera, probabilities and covariances.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.text import one_word
from fgrecon.io.json_fields import Fields, plain_id
from fgrecon.io.keypoints.names import Names, order_of
from fgrecon.io.lens_fields import read_size

Record = dict[str, Any]
_Id = int | str
NOTHING_LABELLED = "Mark keypoints of the vehicles that you want."
"""What the error about annotations without a labelled keypoint says to do."""

_FLAGS = {0.0: None, 1.0: Observation.confidence_midpoint, 2.0: 1.0}
_PARTS_OF_SCHEMES = 24, 66  # points of OpenPifPaf's cars
_PROBABLE = 0.5


def is_annotations(data: Any) -> bool:
    """Whether the content of a JSON file is COCO's annotations."""
    return isinstance(data, Mapping) and "annotations" in data and "instances" not in data


def is_result(record: Any) -> bool:
    """Whether an instance has its keypoints as COCO's results do: u, v, confidence one after the other."""
    points = record.get("keypoints") if isinstance(record, Mapping) else None
    return isinstance(points, list) and bool(points) and all(isinstance(item, int | float) for item in points)


def annotation_records(data: Mapping[str, Any], where: str) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """Instances of COCO's annotations in the layout of a keypoint file, and what errors about each begin with.

    Crowds are left out, and boxes of a category without keypoints; one that is malformed is the error that says so.
    Those without a labelled keypoint are one error in the end, since files for detection have many.

    Raises:
        InvalidInputError: A field of categories or images is missing or malformed; names it.
    """
    top = Fields(data, where)
    kinds = _kinds(top)
    images = {}
    for image in top.each("images", needed=False):
        images[_key(image, "id")] = image
    unlabelled = []
    for number, item in enumerate(top.get("annotations", list)):
        place = f"{where}annotations[{number}]."
        try:
            record = _annotation(Fields(item, place), kinds, images)
        except InvalidInputError as error:
            yield error, place
            continue
        if record is not None and not record["keypoints"]:
            unlabelled.append(number)
        elif record is not None:
            yield {"id": number} | record, place
    if unlabelled:
        place, found = f"{where}annotations[{unlabelled[0]}].", f"{len(unlabelled)} without a labelled one"
        yield InvalidInputError(f"{place}keypoints", found, NOTHING_LABELLED), place


def _annotation(fields: Fields, kinds: Mapping[_Id, _Kind], images: Mapping[_Id, Fields]) -> Record | None:
    """An annotation as an instance, maybe without a keypoint; None of a crowd, or of a category without keypoints."""
    if fields.data.get("iscrowd") == 1:
        return None
    if (number := _key(fields, "category_id")) not in kinds:
        known = ", ".join(map(str, kinds)) or "none"
        raise InvalidInputError(f"{fields.where}category_id", number, f"Give one of the file's categories: {known}.")
    kind = kinds[number]
    if not kind.keypoints:
        return None
    record = _record(fields, kind.keypoints, labelled=True) if "keypoints" in fields else {"keypoints": {}}
    if not record["keypoints"]:
        return record
    picture = images.get(_key(fields, "image_id")) if "image_id" in fields else None
    record |= _extra(fields, kind.keypoints) | ({} if picture is None else _picture(picture))
    if kind.name:
        record["kind"] = kind.name
    return record | ({"id": _key(fields, "id")} if "id" in fields else {})


def result_records(
    data: Sequence[Any], category: Category, names: Names | None, where: str
) -> Iterator[tuple[Record | InvalidInputError, str]]:
    """Instances of a list of COCO's results, or of OpenPifPaf's predictions; see `annotation_records`.

    OpenPifPaf's boxes are the extent of the points that it found, not of the car, and are left out.

    Args:
        names: What the user says of the points, which have no names here.
    """
    for number, item in enumerate(data):
        place = f"{where}[{number}]."
        try:
            fields = Fields(item, place)
            count = len(fields.get("keypoints", list)) // 3
            order = order_of(count, category, names, f"{fields.where}keypoints")
            record = _record(fields, order, labelled=False)
            if "image_id" in fields:
                record["image"] = str(_key(fields, "image_id"))
            elif count in _PARTS_OF_SCHEMES:
                record.pop("box", None)
            yield record | {"id": number}, place
        except InvalidInputError as error:
            yield error, place


@dataclass(frozen=True)
class _Kind:
    """A category of the file: its name as one word, and the names of its keypoints."""

    name: str
    keypoints: tuple[str, ...]


def _kinds(top: Fields) -> dict[_Id, _Kind]:
    """The categories; of one without keypoints no annotation is read."""
    kinds: dict[_Id, _Kind] = {}
    for kind in top.each("categories"):
        names = kind.get("keypoints", list) if "keypoints" in kind else []
        if not all(isinstance(name, str) for name in names) or len(set(names)) != len(names):
            raise InvalidInputError(f"{kind.where}keypoints", names, "Give a list of distinct names.")
        if names or "id" in kind:
            kinds[_key(kind, "id")] = _Kind(one_word(kind.data.get("name") or ""), tuple(names))
    if not any(kind.keypoints for kind in kinds.values()):
        fix = "Give a file whose categories name their keypoints."
        raise InvalidInputError(f"{top.where}categories", "no keypoint names", fix)
    return kinds


def _record(fields: Fields, names: Sequence[str | None], *, labelled: bool) -> Record:
    """Keypoints by name, those that were found alone, and the box.

    Args:
        labelled: Whether the third numbers are flags where they can be.
    """
    values = fields.get("keypoints", list)
    if len(values) != 3 * len(names):
        fix = f"Give u, v and flag for each of {len(names)} keypoints ({3 * len(names)} numbers)."
        raise InvalidInputError(f"{fields.where}keypoints", f"{len(values)} numbers", fix)
    points = fields.numbers("keypoints", (3 * len(names),)).reshape(-1, 3)
    confidence = _confidences(fields, points[:, 2], labelled=labelled)
    found = {
        name: [*point[:2].tolist(), trust]
        for name, point, trust in zip(names, points, confidence, strict=True)
        if name is not None and trust
    }
    record: Record = {"keypoints": found}
    if "bbox" in fields:
        x, y, width, height = fields.numbers("bbox", (4,)).tolist()
        record["box"] = [x, y, x + width, y + height]
    if "score" in fields:
        record["score"] = float(fields.numbers("score", ()))
    track = plain_id(fields.data.get("track_id"))
    if isinstance(track, int) and track >= 0:
        record["track"] = track
    return record


def _confidences(fields: Fields, third: NDArray[np.float64], *, labelled: bool) -> list[float | None]:
    values: list[float] = third.tolist()
    if set(values) <= set(_FLAGS) and (labelled or 2.0 in values):
        return [_FLAGS[value] for value in values]
    bad = [value for value in values if not 0.0 <= value <= 1.0]
    if bad:
        fix = "Let every third number be a flag (0, 1, 2) or a confidence from 0 to 1."
        raise InvalidInputError(f"{fields.where}keypoints", bad[0], fix)
    return [*values]


def _extra(fields: Fields, names: Sequence[str]) -> Record:
    """What fgrecon's own labels say beside COCO's fields; nothing for other programs' labels."""
    size, record = len(names), dict[str, Any]()
    if "keypoint_covariance" in fields:
        covariance = fields.numbers("keypoint_covariance", (size, 2, 2)).tolist()
        record["covariance"] = dict(zip(names, covariance, strict=True))
    if "keypoint_probability" in fields:
        probability = fields.numbers("keypoint_probability", (size,)).tolist()
        points = fields.numbers("keypoints", (3 * size,)).reshape(-1, 3)
        record["keypoints"] = {
            name: point[:2].tolist() for name, point in zip(names, points, strict=True) if point[2] > 0
        }
        record["confidence"] = dict(zip(names, probability, strict=True))
        record["confidence_midpoint"] = _PROBABLE
    return record


def _picture(image: Fields) -> Record:
    record: Record = {}
    if "file_name" in image:
        record["image"] = image.get("file_name", str)
    if "camera_matrix" in image:
        record["K"] = image.numbers("camera_matrix", (3, 3)).tolist()
        record["image_size"] = [image.get("width", int), image.get("height", int)]
    elif "width" in image and "height" in image and (size := read_size(image)) is not None:
        record["image_size"] = list(size)
    return record


def _key(fields: Fields, name: str) -> _Id:
    """An id: an integer, or a text as some programs have it."""
    value = fields.data.get(name)
    key = plain_id(value)
    if key is None:
        raise InvalidInputError(f"{fields.where}{name}", "nothing" if value is None else value, "Give an integer.")
    return key
