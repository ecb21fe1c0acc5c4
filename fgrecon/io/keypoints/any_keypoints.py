"""One entry to keypoints of any format: files, whose format follows from their content, and objects in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance, KeypointFile, parse_keypoints, refuse_other_file
from fgrecon.io.keypoints.coco_records import annotation_records, is_annotations, is_result, result_records
from fgrecon.io.keypoints.names import (
    Names,
    NamesLike,
    naming_of,
    parse_names,
    scheme_keypoints,
    shipped_schemes,
    translated,
)
from fgrecon.io.keypoints.network_results import is_network_result, network_instances, network_records, object_records
from fgrecon.io.keypoints.records import NOT_JSON, named_records
from fgrecon.io.keypoints.tool_records import is_tool_file, tool_records
from fgrecon.io.source_frames import of_one_image

_Records = Iterable[tuple[Mapping[str, Any] | InvalidInputError, str]]


def read_any_keypoints(
    path: Path, category: Category, names: NamesLike | None = None, image: str | None = None
) -> KeypointFile:
    """Read a file of keypoints: fgrecon's own JSON, that of COCO, networks or annotation tools, or one that is no JSON.

    Args:
        names: What is known of the file's names, where neither the file nor a shipped scheme says it; see `NamesLike`.
        image: Name of a photograph: of a file of several, only its vehicles are wanted.
    """
    refuse_other_file(path)
    if path.suffix.lower() not in NOT_JSON:
        return parse_any_keypoints(read_json(path), category, names, image, where=f"{path}: ")
    known = None if names is None else parse_names(names, category)
    return _parsed(named_records(path, category), category, known, image, f"{path}: ")


def parse_any_keypoints(
    data: Any, category: Category, names: NamesLike | None = None, image: str | None = None, where: str = ""
) -> KeypointFile:
    """Check the content of a JSON file of any of the formats and turn it into instances; see `read_any_keypoints`.

    Args:
        image: Name of the photograph whose vehicles are wanted.
    """
    known = None if names is None else parse_names(names, category)
    if is_annotations(data):
        return _parsed(annotation_records(data, where), category, known, image, where)
    if is_tool_file(data):
        return _parsed(tool_records(data, where), category, known, image, where)
    if (found := network_instances(data)) is not None:
        return _parsed(network_records(found, category, known, where), category, known, image, where)
    entries = data if isinstance(data, list) else [data]
    if any(is_result(entry) for entry in entries):
        return _parsed(result_records(entries, category, known, where), category, known, image, where)
    ours, unused = _own(data, category, known, where)
    return _with_unused(_of_this(parse_keypoints(ours, category, where), image, where), unused)


def keypoints_from(
    given: Any,
    names: NamesLike | None = None,
    category: Category | str | Path = "car14",
    *,
    image_size: tuple[int, int] | None = None,
    scale_to_image: bool = False,
) -> tuple[Instance, ...]:
    """Vehicles from what a keypoint network returned, as `fgrecon.reconstruct` takes them.

        for vehicle in fgrecon.keypoints_from(model("street.jpg"), names=["left_front_wheel", ...]):
            result = fgrecon.reconstruct(vehicle.observation, camera)

    Args:
        given: Results of ultralytics, torchvision, detectron2 or MMPose (of one image or a list),
            `supervision.KeyPoints`, OpenPifPaf's annotations, or the content of a JSON file that `fgrecon reconstruct`
            reads.
        names: Which points these are, where nothing says it: names in the order of the points, None for a point that
            means nothing here; a mapping from their names to those of the category, several to one for their centre;
            a shipped scheme (`apollo24`, `apollo66`, `carfusion`, `pascal12`); or a file with either.
        category: The category whose keypoints are wanted, its name or its file.
        image_size: Width and height of the picture, or of the camera's images, in pixels; None where it is not known.
        scale_to_image: Whether points are scaled to it, where `given` states another size of the same shape.

    Returns:
        The vehicles; empty where a network found none.

    Raises:
        InvalidInputError: The object is none of these, a value is malformed, or it states another size than the image
            has; names the field.
    """
    instances = _instances_of(given, names, load_category(category))
    return tuple(one.fitted(image_size, scale=scale_to_image) for one in instances)


def _instances_of(given: Any, names: NamesLike | None, kind: Category) -> tuple[Instance, ...]:
    known = None if names is None else parse_names(names, kind)
    plain = _plain(given)
    if plain is not None:
        return parse_any_keypoints(plain, kind, names).instances if plain else ()
    results = given if isinstance(given, list | tuple) else [given]
    records = [
        (dict(record) | ({"id": f"{place}:{record['id']}"} if len(results) > 1 else {}), where)
        for place, result in enumerate(results)
        for record, where in object_records(result, kind, known, f"[{place}]: " if len(results) > 1 else "")
    ]
    return _parsed(records, kind, known, None, "").instances if records else ()


def _plain(given: Any) -> Any:
    """The content of a JSON file, as which OpenPifPaf's annotations give themselves; None for other objects."""
    items = given if isinstance(given, list | tuple) else [given]
    if any(is_network_result(item) for item in items):
        return None
    if all(isinstance(item, Mapping) for item in items):
        return given
    if all(callable(getattr(item, "json_data", None)) for item in items):
        return [item.json_data() for item in items]
    return None


def _parsed(records: _Records, category: Category, names: Names | None, image: str | None, where: str) -> KeypointFile:
    """Instances of another program, in the layout of a keypoint file but for their names."""
    ours, unused, left_out = [], set[str](), list[InvalidInputError]()
    for record, place in records:
        try:
            if isinstance(record, InvalidInputError):
                raise record
            instance, unknown = translated(record, category, names, place)
        except InvalidInputError as error:
            left_out.append(error)
            continue
        ours.append(instance)
        unused |= unknown
    if not ours and left_out:
        raise left_out[0]
    if not ours:
        fix = f"Give a file with keypoints of {category.name}: {', '.join(category.keypoints)}."
        raise InvalidInputError(f"{where}keypoints", "no labelled keypoint", fix)
    file = _of_this(parse_keypoints(ours, category, where), image, where)
    return _with_unused(replace(file, left_out=(*left_out, *file.left_out)), unused)


def _with_unused(file: KeypointFile, unused: set[str]) -> KeypointFile:
    """The same, with the names of points that are no keypoint of the category."""
    more = {f"keypoint {name}" for name in unused - _expected()}
    return replace(file, ignored=tuple(sorted({*file.ignored, *more})))


@lru_cache
def _expected() -> frozenset[str]:
    """Points of other schemes, of which nobody expects that they are ours."""
    return frozenset(name for scheme in shipped_schemes() for name in scheme_keypoints(scheme))


def _own(data: Any, category: Category, names: Names | None, where: str) -> tuple[Any, set[str]]:
    """A keypoint file's content with each instance's points in the category's names, and names that are none of it."""
    unused = set[str]()

    def instance(record: Any, place: str) -> Any:
        points = record.get("keypoints") if isinstance(record, Mapping) else None
        if not isinstance(points, Mapping | list) or not points:
            return record
        ours = len(points) == category.size if isinstance(points, list) else _are_ours(points, category)
        if names is None and ours:
            return record
        try:
            changed, unknown = translated(record, category, names, place)
        except InvalidInputError as error:  # of this instance alone: its reader says so
            return error
        unused.update(unknown)
        return changed

    if isinstance(data, Mapping) and isinstance(data.get("instances"), list):
        entries = enumerate(data["instances"])
        return dict(data) | {"instances": [instance(item, f"{where}instance {i}: ") for i, item in entries]}, unused
    if isinstance(data, list):
        return [instance(item, f"{where}instance {i}: ") for i, item in enumerate(data)], unused
    return instance(data, where), unused


def _are_ours(points: Mapping[Any, Any], category: Category) -> bool:
    """Whether the names are the category's, or near enough to them for its own reader to say what is wrong."""
    known = naming_of([str(name) for name in points], category)
    return known is None or not known.groups


def _of_this(file: KeypointFile, image: str | None, where: str) -> KeypointFile:
    """The instances of one photograph, where they say of which they are."""
    if image is None or all(instance.image is None for instance in file.instances):
        return file
    same = of_one_image((i.image for i in file.instances if i.image is not None), image)
    kept = tuple(i for i in file.instances if i.image is None or i.image in same)
    if not kept:
        known = sorted({str(i.image) for i in file.instances})
        more = f" and {len(known) - 1} more" if len(known) > 1 else ""
        raise InvalidInputError(f"{where}image", image, f"Give one of the file's images, such as {known[0]}{more}.")
    return replace(file, instances=kept)
