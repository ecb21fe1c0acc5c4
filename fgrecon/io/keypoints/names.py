"""Keypoint names of other programs: which of their points, or the centre of which, is a keypoint of ours.

A scheme is a JSON file in `fgrecon/data/names`: the names of another program in its order (`keypoints`) and, under the
name of a category, the points whose centre each of its keypoints is. A user gives one of these by name, or names of
his own: `theirs=ours` pairs, a file with an object `{"theirs": "ours"}`, or a file with a list of names in the order of
the points. An instance in such names is brought to a category's (`translated`); the rest of it is left as it is.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.json_fields import numbers, read_json, read_toml

_FIX = "Give a scheme ({}), pairs theirs=ours, or a file (JSON, TOML) with such pairs or with a list of names."


@dataclass(frozen=True)
class Names:
    """What is known of another program's names."""

    # names in the order of the points, None for a point without a name; None where the order is not known
    order: tuple[str | None, ...] | None
    groups: Mapping[str, tuple[str, ...]]  # for each keypoint of ours the points whose centre it is


NamesLike = Names | str | Path | Mapping[str, str] | Sequence[str | None]
"""Name of a scheme, file, pairs `theirs=ours`, mapping from their names to ours, or names in the order of points."""


@dataclass(frozen=True)
class _Scheme:
    name: str
    keypoints: tuple[str, ...]
    groups: Mapping[str, Mapping[str, tuple[str, ...]]]  # category -> ours -> theirs


def shipped_schemes() -> tuple[str, ...]:
    """Names of the schemes that come with fgrecon."""
    return tuple(_schemes())


def scheme_keypoints(name: str) -> tuple[str, ...]:
    """The points of a shipped scheme, in its order."""
    return _schemes()[name].keypoints


@lru_cache
def _schemes() -> dict[str, _Scheme]:
    found = {}
    folder = resources.files("fgrecon").joinpath("data", "names")
    for file in sorted(folder.iterdir(), key=lambda item: item.name):
        data = json.loads(file.read_text(encoding="utf-8-sig"))
        groups = {
            category: {ours: tuple(theirs) for ours, theirs in data[category].items()}
            for category in data.keys() - {"name", "source", "keypoints"}
        }
        found[data["name"]] = _Scheme(data["name"], tuple(data["keypoints"]), groups)
    return found


def parse_names(given: NamesLike, category: Category, field: str = "names") -> Names:
    """Names as a user gives them.

    Args:
        given: A scheme, pairs, a file, a mapping or a list; see `NamesLike`.

    Raises:
        InvalidInputError: Neither of these, or a keypoint that the category does not have.
    """
    if isinstance(given, Names):
        return given
    value: Any = given
    if isinstance(value, str) and value in _schemes():
        scheme = _schemes()[value]
        return Names(scheme.keypoints, _groups_of(scheme, category, field))
    if isinstance(value, str) and "=" in value and not _is_file(Path(value)):
        value = _pairs(value, field)
    elif isinstance(value, str | Path):
        field, value = str(value), _read(Path(value), field)
    if isinstance(value, Mapping):
        if set(value) == {"names"}:  # TOML has no file that is a list
            value = value["names"]
        else:
            return Names(None, _inverted(value, category, field))
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return _listed(value, category, field)
    raise InvalidInputError(field, given, _fix())


def naming_of(theirs: Collection[str], category: Category) -> Names | None:
    """The scheme that most of these names are of; the category's own names mean themselves. None where none is known.

    Capital letters make no difference: programs that write CarFusion's names do not agree on them.
    """
    lowered = {name.lower() for name in theirs}
    best, most = None, 0
    for scheme in _schemes().values():
        shared = len(lowered & {name.lower() for name in scheme.keypoints})
        if shared > most and (category.name in scheme.groups or scheme.keypoints == category.keypoints):
            best, most = scheme, shared
    own = len(set(theirs) & set(category.keypoints))
    if own >= max(most, 1):
        return Names(None, {})
    if best is None:
        return None
    spelt = {name.lower(): name for name in theirs}
    groups = _groups_of(best, category, "names")
    return Names(None, {ours: tuple(spelt.get(name.lower(), name) for name in of) for ours, of in groups.items()})


def order_of(count: int, category: Category, names: Names | None, field: str) -> tuple[str | None, ...]:
    """Names of points that a file gives in an order alone: the user's, the category's own, or a scheme of this size.

    Raises:
        InvalidInputError: Nobody knows the order, or it is one of another number of points.
    """
    if names is not None and names.order is not None:
        if len(names.order) != count:
            fix = f"Give names for {count} points: `names` (--names) says {len(names.order)}."
            raise InvalidInputError(field, f"{count} points", fix)
        return names.order
    if names is not None and names.groups:  # pairs: points without names are called by their numbers
        return tuple(str(number) for number in range(count))
    if count == category.size:
        return category.keypoints
    known = [scheme for scheme in _schemes().values() if len(scheme.keypoints) == count]
    if len(known) == 1 and category.name in known[0].groups:
        return known[0].keypoints
    fix = f"Say by `names` (--names) which points these are: {_fix()}"
    raise InvalidInputError(field, f"{count} points without names", fix)


def _groups_of(scheme: _Scheme, category: Category, field: str) -> Mapping[str, tuple[str, ...]]:
    if scheme.keypoints == category.keypoints:
        return {}
    if category.name not in scheme.groups:
        known = ", ".join(sorted(scheme.groups))
        raise InvalidInputError(field, scheme.name, f"It is known for {known}; give names for {category.name}.")
    return scheme.groups[category.name]


def _inverted(pairs: Mapping[Any, Any], category: Category, field: str) -> dict[str, tuple[str, ...]]:
    groups: dict[str, tuple[str, ...]] = {}
    for theirs, ours in pairs.items():
        if not isinstance(ours, str):
            raise InvalidInputError(f"{field}: {theirs}", ours, f"Give the name of a keypoint of {category.name}.")
        category.index(ours, f"{field}: {theirs}")
        groups[ours] = (*groups.get(ours, ()), str(theirs))
    if not groups:
        raise InvalidInputError(field, dict(pairs), _fix())
    return groups


def _listed(names: Sequence[Any], category: Category, field: str) -> Names:
    for number, name in enumerate(names):
        if not isinstance(name, str | None):
            raise InvalidInputError(f"{field}[{number}]", name, "Give a text, or null for a point to leave out.")
    given = [name for name in names if name]
    if len(set(given)) != len(given) or not given:
        raise InvalidInputError(field, list(names), "Give a list of distinct names in the order of the points.")
    known = naming_of(given, category)
    if known is None:
        fix = f"Use names of {category.name}: {', '.join(category.keypoints)}."
        raise InvalidInputError(field, given, fix)
    return Names(tuple(name or None for name in names), known.groups)


def _pairs(text: str, field: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for part in text.split(","):
        theirs, equals, ours = (piece.strip() for piece in part.partition("="))
        if not (theirs and equals and ours) or theirs in pairs:
            raise InvalidInputError(field, text, "Give pairs theirs=ours, separated by commas, each point once.")
        pairs[theirs] = ours
    return pairs


def _read(path: Path, field: str) -> Any:
    if path.suffix.lower() == ".toml":
        return read_toml(path)
    if not _is_file(path):
        raise InvalidInputError(field, str(path), _fix())
    return read_json(path)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # longer than a name may be, as pairs are
        return False


def _fix() -> str:
    return _FIX.format(", ".join(shipped_schemes()))


_EXTRA: Mapping[str, tuple[int, ...]] = {"confidence": (), "covariance": (2, 2)}
"""What may stand beside keypoints for each of them, and its shape."""


def translated(
    record: Mapping[str, Any], category: Category, names: Names | None, where: str
) -> tuple[dict[str, Any], set[str]]:
    """An instance in the layout of `fgrecon.io.keypoint_file`, its keypoints by the category's names.

    A keypoint that is the centre of several points is found where all of them are.

    Args:
        record: The instance; its points by name, or in an order that is the user's, the category's or a scheme's.
        names: What the user says of the names, or None.

    Returns:
        The instance, and the names of points that are no keypoint of the category.

    Raises:
        InvalidInputError: No point is a keypoint of the category, or a value is malformed; names the field.
    """
    points = _named(record, "keypoints", category, names, where)
    extra = {field: _named(record, field, category, names, where) for field in _EXTRA if record.get(field) is not None}
    known = names if names is not None and (names.groups or names.order) else naming_of(points, category)
    if known is None:
        fix = f"Say by `names` (--names) which keypoints of {category.name} these are."
        raise InvalidInputError(f"{where}keypoints", ", ".join(points) or "no name", fix)
    groups = {ours: known.groups.get(ours, (ours,)) for ours in category.keypoints}
    used = {theirs for group in groups.values() for theirs in group}
    if not used & set(points):
        fix = f"None is a keypoint of {category.name}; say by `names` (--names) which ones these are."
        raise InvalidInputError(f"{where}keypoints", ", ".join(points), fix)
    result = dict(record) | {"keypoints": _centres(points, groups, None, f"{where}keypoints")}
    for field, values in extra.items():
        result[field] = _centres(values, groups, _EXTRA[field], f"{where}{field}")
    return result, set(points) - used


def _named(
    record: Mapping[str, Any], field: str, category: Category, names: Names | None, where: str
) -> dict[str, Any]:
    """Values by name; names that are numbers are places in the user's order, where there is one."""
    given = record.get(field)
    if isinstance(given, Mapping):
        order = () if names is None or names.order is None else names.order
        places = {str(number): name for number, name in enumerate(order)}
        numbered = all(str(name) in places for name in given)
        named = {(places[str(name)] if numbered else str(name)): value for name, value in given.items()}
        return {name: value for name, value in named.items() if name is not None}
    if not isinstance(given, list):
        fix = "Give points by name, or a list of points."
        raise InvalidInputError(f"{where}{field}", "nothing" if given is None else given, fix)
    order = order_of(len(given), category, names, f"{where}{field}")
    return {name: value for name, value in zip(order, given, strict=True) if name is not None}


def _centres(
    values: Mapping[str, Any], groups: Mapping[str, tuple[str, ...]], shape: tuple[int, ...] | None, field: str
) -> dict[str, Any]:
    """Mean value of each group of which every member has one; without a shape they are points of 2 or 3 numbers."""
    centres: dict[str, Any] = {}
    for ours, theirs in groups.items():
        rows = [
            numbers(value, _shape_of(value) if shape is None else shape, f"{field}.{name}", missing=True)
            for name in theirs
            if (value := values.get(name)) is not None
        ]
        if len(rows) < len(theirs) or any(np.isnan(row).any() for row in rows):
            continue
        if len({row.shape for row in rows}) > 1:
            raise InvalidInputError(f"{field}.{theirs[0]}", values[theirs[0]], "Give all points a confidence, or none.")
        centres[ours] = np.mean(rows, axis=0).tolist()
    return centres


def _shape_of(value: Any) -> tuple[int, ...]:
    return (3,) if isinstance(value, list) and len(value) == 3 else (2,)
