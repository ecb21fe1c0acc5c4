"""Categories and shape priors from files: the shipped ones by name, others by path.

A category is a JSON file, a prior an npz file without pickled content. In a prior's file:

| array | shape | content |
|---|---|---|
| `format` | () | `fgrecon.shape_prior/1` |
| `category`, `provenance` | () | JSON text |
| `name` | () | text |
| `mean`, `basis`, `offset_sigma`, `explained` | (K, 3), (N, K, 3), (K,), (N,) | as in `ShapePrior` |
| `mean_sigma` | (K, 3) | metres: how far the mean would move with other vehicles (`ShapePrior`); where it is known |
| `surface_mean`, `surface_basis`, `surface_faces` | (V, 3), (N, V, 3), (F, 3) | as in `Surface`; all or none |
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import as_instance, as_path
from fgrecon.core.choices import ClassScheme
from fgrecon.core.detector_calibration import BoxSource, DetectorCalibration
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.core.size_prior import SIZE_PRIORS, ClassOdds, ClassSizes, SizePrior, SizesLike, size_prior
from fgrecon.io.arrays import read_arrays, write_arrays
from fgrecon.io.files import check_hash, write_text
from fgrecon.io.json_fields import Fields, parse_json, read_fields, within

PRIOR_FORMAT = "fgrecon.shape_prior/1"
_SURFACE = ("surface_mean", "surface_basis", "surface_faces")
_ARRAYS = ("mean", "basis", "offset_sigma", "explained")
_LEAST_SHARE = 1e-3  # of a class of vehicles in its odds


def shipped_categories() -> tuple[str, ...]:
    """Names of the categories that come with fgrecon."""
    return _shipped("categories", ".json")


def shipped_priors() -> tuple[str, ...]:
    """Names of the shape priors that come with fgrecon."""
    return _shipped("priors", ".npz")


def load_category(source: Category | str | Path) -> Category:
    """A category by its name (`car14`) or from its JSON file; a category is returned as it is.

    Raises:
        InvalidInputError: Neither a known name nor a readable file, or a field is wrong; names file and field.
    """
    if isinstance(source, Category):
        return source
    if isinstance(source, str) and source in shipped_categories():
        return _shipped_category(source)
    content = _read(as_path("category", source), "category", shipped_categories())
    return _category_from_json(str(source), content)


def load_prior(source: ShapePrior | str | Path) -> ShapePrior:
    """A shape prior by its name (`car14`) or from an npz file; a prior is returned as it is.

    The arrays of a loaded prior are read-only, since a shipped prior is read once and shared.

    Raises:
        InvalidInputError: Neither a known name nor a readable file, pickled content, or an array is missing or
            wrong; names file and field.
    """
    if isinstance(source, ShapePrior):
        return source
    if not isinstance(source, str | Path):
        raise InvalidInputError("prior", source, f"Give a prior, a path, or one of {', '.join(shipped_priors())}.")
    if isinstance(source, str) and source in shipped_priors():
        return _shipped_prior(source)
    return _prior_from_npz(str(source), _read(Path(source), "prior", shipped_priors()))


def class_of_kind(kind: str | None) -> VehicleClass | None:
    """The class of a vehicle that a file calls by one word; None where no scheme has the word.

    KITTI's begin with a capital: its `Truck` is a lorry, a detector's `truck`, as COCO calls them, may be a van.
    """
    if kind is None:
        return None
    first = ClassScheme.KITTI if kind[:1].isupper() else ClassScheme.COCO
    schemes, name = shipped_class_sizes().schemes, kind.lower()
    known = next((one for one in (first, *ClassScheme) if name in schemes.get(one.value, {})), None)
    return None if known is None else VehicleClass(name, known)


@lru_cache
def coarse_prior(name: str, keypoints: tuple[str, ...]) -> ShapePrior | None:
    """A coarse shape of vehicles that no prior has, with keypoints of these names; None where it has others.

    It is a cuboid of eight corners, each side of which is parted into cells, on which the keypoints lie.

    Args:
        name: Of its category.
        keypoints: Names of the keypoints that vehicles have.
    """
    data = _json(f"{name}.json", _folder("sizes").joinpath(f"{name}.json").read_bytes())
    category = load_category(name)
    if category.keypoints != keypoints:
        return None
    length, width, height = data["size"]
    scale = np.array([length, height, width])
    mean = scale * np.array([data["keypoints"][name] for name in keypoints])
    corners, cells = scale * np.array(data["corners"], dtype=np.float64), dict(zip("xzy", data["cells"], strict=True))
    sides = [_side(corners[quad], cells) for quad in np.array(data["quads"])]
    vertices = np.concatenate([points for points, _ in sides])
    starts = np.cumsum([0, *(len(points) for points, _ in sides[:-1])])
    faces = np.concatenate([start + triangles for start, (_, triangles) in zip(starts, sides, strict=True)])
    change = np.array(data["spread"])[:, None, None] * np.eye(3)[[0, 2, 1]][:, None]  # of x, z and y
    surface = Surface(vertices, vertices * change, faces.astype(np.int32))
    sigma, third = np.full(len(keypoints), float(data["offset_sigma"])), np.full(3, 1.0 / 3.0)
    return ShapePrior(category, mean, mean * change, sigma, third, surface, "cuboid")


def _side(corners: NDArray[np.float64], cells: Mapping[str, int]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Vertices (V, 3) and triangles (F, 3) of a side with corners (4, 3) in their order around, in cells by axis."""
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    first, second = (cells["xyz"[int(np.abs(edge).argmax())]] for edge in (along, across))
    u, v = np.meshgrid(np.linspace(0.0, 1.0, first + 1), np.linspace(0.0, 1.0, second + 1), indexing="ij")
    vertices = corners[0] + u.reshape(-1, 1) * along + v.reshape(-1, 1) * across
    at = (np.arange(first)[:, None] * (second + 1) + np.arange(second)).ravel()
    one, other = np.stack([at, at + second + 1, at + second + 2], 1), np.stack([at, at + second + 2, at + 1], 1)
    return vertices, np.concatenate([one, other])


@lru_cache
def shipped_class_sizes() -> ClassSizes:
    """The sizes of classes of vehicles that come with fgrecon (`data/sizes/kitti.md`)."""
    data = _json("kitti.json", _folder("sizes").joinpath("kitti.json").read_bytes())
    classes, detector = data["classes"], data["detector"]
    share = {name: float(one["share"]) for name, one in classes.items()}
    return ClassSizes(
        name=data["name"],
        mean={name: np.array(one["mean"]) for name, one in classes.items()},
        covariance={name: np.array(one["covariance"]) for name, one in classes.items()},
        share=share,
        odds={
            name: ClassOdds(**{"fleet": _by_share(name, share), **one.get("odds", {})}) for name, one in classes.items()
        },
        coarse={name: one["shape"] for name, one in classes.items() if "shape" in one},
        schemes=data["schemes"],
        detector_odds=(detector["offset"], detector["slope"]),
    )


def _by_share(name: str, share: Mapping[str, float]) -> float:
    """Log odds of a class beside the first one by how often both are; one that is not there is as a rare one."""
    return math.log(max(share[name], _LEAST_SHARE) / share[next(iter(share))])


@lru_cache(maxsize=16)  # one object for one text, so that what is prepared for it is found again
def _fleet_from_json(source: str, content: bytes) -> SizePrior:
    """A fleet by its classes, each with its share; what else a class does not say is as with the package's."""
    known, given = shipped_class_sizes(), Fields(_json(source, content), f"{source}: ")
    classes = given.inner("classes")
    share, mean, covariance = dict.fromkeys(known.mean, 0.0), {**known.mean}, {**known.covariance}
    for name in classes.data:
        one = classes.inner(name)
        share[name] = float(one.numbers("share", ()))
        if name in known.mean and "mean" not in one:
            continue
        mean[name], covariance[name] = one.numbers("mean", (3,)), one.numbers("covariance", (3, 3))
        with within(one.where):
            SizePrior(name, mean[name], np.sqrt(np.diag(covariance[name]).clip(1e-8)), covariance[name])
    if min(share.values()) < 0.0 or not share[known.usual] > 0.0:
        fix = f"Give the share of each class, that of {known.usual} positive, and none negative."
        raise InvalidInputError(f"{source}: classes", share, fix)
    total = sum(share.values())
    share = {name: value / total for name, value in share.items()}
    odds = {name: ClassOdds(_by_share(name, share)) for name in share}
    for name, other in known.odds.items():  # by as much more or less than its share
        odds[name] = replace(other, fleet=other.fleet + odds[name].fleet - _by_share(name, known.share))
    own = {**known.schemes["fgrecon"], **{name: {name: 1.0} for name in share}}
    schemes = {**known.schemes, "fgrecon": own}
    sizes = replace(known, name=given.get("name", str), mean=mean, covariance=covariance, share=share)
    return replace(sizes, odds=odds, schemes=schemes).fleet()


def load_size_prior(source: SizesLike | Path) -> SizePrior:
    """A size prior by its name, by numbers (`fgrecon.core.size_prior.size_prior`), or a fleet from its JSON file.

    Raises:
        InvalidInputError: It is none of these, or a field of the file is wrong; names file and field.
    """
    if isinstance(source, Path) or (isinstance(source, str) and source.endswith(".json")):
        return _fleet_from_json(str(source), _read(Path(source), "size_prior", tuple(SIZE_PRIORS)))
    return size_prior(source)


def save_prior(prior: ShapePrior, path: str | Path) -> Path:
    """Write a prior to an npz file, whole or not at all; `load_prior` reads the same numbers back.

    Arrays are stored as float32 where that loses nothing. The same prior gives the same bytes.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: The file does not end in `.npz`, or cannot be written.
    """
    as_instance("prior", prior, ShapePrior)
    path = as_path("path", path)
    if path.suffix != ".npz":
        raise InvalidInputError(str(path), path.suffix, "Give a file name that ends in .npz.")
    arrays: dict[str, Any] = {
        "format": np.array(PRIOR_FORMAT),
        "category": np.array(json.dumps(prior.category.to_dict())),
        "provenance": np.array(json.dumps(dict(prior.provenance))),
        "name": np.array(prior.name),
        **{field: _compact(getattr(prior, field)) for field in _ARRAYS},
    }
    if prior.mean_sigma is not None:
        arrays["mean_sigma"] = _compact(prior.mean_sigma)
    if prior.surface is not None:
        arrays["surface_mean"] = _compact(prior.surface.mean)
        arrays["surface_basis"] = _compact(prior.surface.basis)
        arrays["surface_faces"] = prior.surface.faces
    return write_arrays(path, **arrays)


def _folder(kind: str) -> Traversable:
    return resources.files("fgrecon").joinpath("data", kind)


@lru_cache
def _shipped(kind: str, suffix: str) -> tuple[str, ...]:
    names = (file.name for file in _folder(kind).iterdir())
    return tuple(sorted(name.removesuffix(suffix) for name in names if name.endswith(suffix)))


@lru_cache
def _shipped_category(name: str) -> Category:
    file = _folder("categories").joinpath(f"{name}.json")
    return _category_from_json(file.name, file.read_bytes())


@lru_cache
def _shipped_prior(name: str) -> ShapePrior:
    file = _folder("priors").joinpath(f"{name}.npz")
    content = file.read_bytes()
    check_hash(Path(str(file)), content)
    return _prior_from_npz(file.name, content)


def _read(path: Path, kind: str, names: tuple[str, ...]) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        fix = f"Give a file that exists, or one of the shipped names: {', '.join(names)}."
        raise InvalidInputError(kind, str(path), fix) from None
    except OSError as error:
        raise InvalidInputError(kind, str(path), f"Give a readable file ({error.strerror or error}).") from error


def _json(field: str, content: str | bytes) -> Mapping[str, Any]:
    try:
        data = parse_json(content.decode() if isinstance(content, bytes) else content)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(field, f"no JSON: {error}", "Give a file with one JSON object.") from error
    if not isinstance(data, dict):
        raise InvalidInputError(field, f"a JSON {type(data).__name__}", "Give a file with one JSON object.")
    return data


def _category_from_json(source: str, content: str | bytes) -> Category:
    data = _json(source, content)
    with within(f"{source}: "):
        return Category.from_dict(data)


@lru_cache(maxsize=16)  # one object for one content, so that what is prepared for it is found again
def _prior_from_npz(source: str, content: bytes) -> ShapePrior:
    fix = "Give an npz file that `fgrecon.io.catalogue.save_prior` or `fgrecon prior` wrote."
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise InvalidInputError(source, "not an npz file", fix)
    arrays = read_arrays(content, source, fix)
    return _prior_from_arrays(source, arrays, fix)


def _prior_from_arrays(source: str, arrays: Mapping[str, NDArray[Any]], fix: str) -> ShapePrior:
    def text(field: str) -> str:
        if arrays[field].dtype.kind != "U" or arrays[field].ndim != 0:
            raise InvalidInputError(f"{source}: {field}", f"{arrays[field].dtype} {arrays[field].shape}", fix)
        return str(arrays[field])

    surface_fields = _SURFACE if any(field in arrays for field in _SURFACE) else ()
    for field in ("format", "category", "provenance", "name", *_ARRAYS, *surface_fields):
        if field not in arrays:
            raise InvalidInputError(f"{source}: {field}", "no such array", fix)
    if text("format") != PRIOR_FORMAT:
        raise InvalidInputError(f"{source}: format", text("format"), f"Give a file in the format {PRIOR_FORMAT}.")
    with within(f"{source}: "):
        surface = Surface(*(arrays[field] for field in _SURFACE)) if surface_fields else None
        return ShapePrior(
            category=_category_from_json("category", text("category")),
            mean=arrays["mean"],
            basis=arrays["basis"],
            offset_sigma=arrays["offset_sigma"],
            explained=arrays["explained"],
            surface=surface,
            name=text("name"),
            provenance={str(key): str(value) for key, value in _json("provenance", text("provenance")).items()},
            mean_sigma=arrays.get("mean_sigma"),
        )


def _compact(array: NDArray[np.float64]) -> NDArray[Any]:
    """The array as float32 where that loses nothing, else as it is."""
    with np.errstate(over="ignore"):  # numbers beyond float32 are kept as they are
        short = array.astype(np.float32)
    return short if np.array_equal(short.astype(np.float64), array) else array


DETECTOR_FORMAT = "fgrecon.detector/1"


def load_calibration(path: str | Path) -> DetectorCalibration:
    """Read a detector's calibration.

    Raises:
        InvalidInputError: The file cannot be read, is of another format, or a number is missing or out of range; names
            file and field.
    """
    file, where = as_path("calibration", path), f"{path}: "
    data = read_fields(file)
    stated = data.get("format", str)
    if stated != DETECTOR_FORMAT:
        raise InvalidInputError(f"{where}format", stated, f"Give a file of {DETECTOR_FORMAT}: `fgrecon calibrate`.")
    numbers = {name: float(data.numbers(name, ())) for name in DetectorCalibration().numbers}
    edges: dict[str, float] | None = None
    if "boxes" in data:
        box_fields = data.inner("boxes")
        edges = {entry.name: float(box_fields.numbers(entry.name, ())) for entry in fields(BoxSource)}
    with within(where):
        source = None if edges is None else BoxSource(**edges)
        return DetectorCalibration(**numbers, provenance=data.get("provenance", dict), boxes=source)


def save_calibration(calibration: DetectorCalibration, path: str | Path) -> Path:
    """Write a detector's calibration, whole or not at all.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    as_instance("calibration", calibration, DetectorCalibration)
    content = {"format": DETECTOR_FORMAT, **calibration.numbers, "provenance": dict(calibration.provenance)}
    if calibration.boxes is not None:
        content["boxes"] = asdict(calibration.boxes)
    return write_text(as_path("path", path), json.dumps(content, indent=1, allow_nan=False) + "\n")
