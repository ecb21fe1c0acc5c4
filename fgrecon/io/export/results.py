"""The results that a JSON file holds, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground, lens_of
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import COMPACT, FORMAT, Reconstruction
from fgrecon.core.repr import brief_repr
from fgrecon.core.serialise import well_formed
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.json_fields import read_json
from fgrecon.solve.vehicle.model import prepare

_SAME = 2e-6
"""Metres by which wireframes may differ that were rounded to micrometres."""


class Surfaces:
    """Gives results their surfaces again.

    A result keeps its wireframe, so a prior that is not the one that it was solved with gives itself away: the result
    then stays without a surface, as where the prior is not to be found.
    """

    def __init__(self, settings: Mapping[str, Any], prior: ShapePrior | str | Path | None = None) -> None:
        """Find the prior.

        Args:
            prior: The prior; None for the one that the settings name.

        Raises:
            InvalidInputError: A prior was given that cannot be read, or the size prior is malformed.
        """
        size = settings.get("size_prior")
        self._size = None if size is None else SizePrior(size["name"], np.array(size["mean"]), np.array(size["sigma"]))
        self._prior = _found(settings) if prior is None else load_prior(prior)

    def complete(self, result: Reconstruction) -> Reconstruction:
        """The result with its surface, where that can be had and it has none yet."""
        shape, prior = result.shape, self._prior
        count = len(shape.coefficients)
        if shape.surface_vertices is not None or prior is None or prior.surface is None or count > prior.dimension:
            return result
        model = prepare(prior, self._size, None if count == prior.dimension else count).prior
        points = model.keypoints(shape.coefficients, shape.offsets)
        if points.shape != shape.wireframe.shape or not np.abs(points - shape.wireframe).max() < _SAME:
            return result
        assert model.surface is not None
        vertices = model.surface.vertices(shape.coefficients)
        shape = replace(shape, surface_vertices=vertices, surface_faces=model.surface.triangles)
        return replace(result, shape=shape)


def _found(settings: Mapping[str, Any]) -> ShapePrior | None:
    """The prior that settings name; None where its file is gone."""
    try:
        return load_prior(settings.get("prior_file") or str(settings["prior"]))
    except InvalidInputError:
        return None


_ONE = (FORMAT, COMPACT)
_MANY = ("fgrecon.reconstructions/2", "fgrecon.track/2", "fgrecon.reconstructions/1", "fgrecon.track/1")
DEMO_FORMAT = "fgrecon.demo/1"


@dataclass(frozen=True)
class NamedResult:
    """One vehicle in one image."""

    name: str  # its id
    result: Reconstruction
    box: NDArray[np.float64] | None = None  # (4,) 2D box that it was observed in, pixels, or None
    # (3,) where KITTI's label frame lies from the camera's (a labelled point is at X + offset), or None
    label_offset: NDArray[np.float64] | None = None
    image: str = ""  # name of the image; empty where the file has only one, or does not tell it
    camera: Camera | None = None  # the camera that took it, or None
    ground: Ground | None = None  # the ground plane in its frame that the settings tell, or None
    row: str = ""  # row of a batch that it is from; stands for the image where that is not known
    kind: str | None = None  # what it is by its detector, such as `Van`, or None
    score: float | None = None  # how sure its detector is, or None
    velocity: NDArray[np.float64] | None = None  # (3,) along the world's axes, m/s, or None
    track: int | None = None  # id that a tracker gave it, or None

    __repr__ = brief_repr

    @property
    def solved(self) -> bool:
        """Whether it has a pose."""
        return bool(np.isfinite(self.result.camera_T_object).all())


def read_results(path: str | Path, prior: ShapePrior | str | Path | None = None) -> list[NamedResult]:
    """Read the results of a JSON file, those that were refused left out; surfaces are made again from the prior.

    Args:
        path: What `fgrecon reconstruct --json`, `fgrecon track --json` or `fgrecon demo` wrote, or a
            `Reconstruction.to_dict()`; of this release or of one before. Or a folder of such files, as
            `fgrecon reconstruct --out` writes it.
        prior: The shape prior, where the file does not find it: a result whose prior is gone has no surface.

    Raises:
        InvalidInputError: It is none of these, or the prior that was given cannot be read.
    """
    given = None if prior is None else load_prior(prior)
    if Path(path).is_dir():
        files = sorted(Path(path).glob("*.json"))
        if not files:
            raise InvalidInputError("results", str(path), "Give a folder that `fgrecon reconstruct --out` wrote.")
        return [result for file in files for result in read_results(file, given)]
    data = read_json(Path(path))
    kind = data.get("format") if isinstance(data, dict) else None
    with well_formed(str(path), "Give the file as fgrecon wrote it."):
        if kind in _ONE:
            result = Reconstruction.from_dict(data)
            surfaces = Surfaces({"prior": result.shape.prior}, given)
            return [NamedResult(Path(path).stem, surfaces.complete(result))]
        if kind == DEMO_FORMAT:
            return [NamedResult("demo", Reconstruction.from_dict(data["result"]))]
        if kind in _MANY:
            settings = data.get("settings", {"prior": None})
            surfaces, grounds = Surfaces(settings, given), _grounds(data, settings)
            solved = [(e, image) for e, image in _with_images(data) if e["result"] is not None]
            return [_named(entry, image, surfaces, grounds) for entry, image in solved]
    fix = "Give what `fgrecon reconstruct --json`, `fgrecon track --json` or `fgrecon demo` wrote."
    raise InvalidInputError(f"{path}: format", kind, fix)


def ground_of(settings: Mapping[str, Any]) -> Ground | None:
    """The ground plane among settings as files have them, or None."""
    plane = settings.get("ground")
    return None if plane is None else Ground(np.array(plane["normal"]), plane["distance"])


def _grounds(data: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str | None, Ground | None]:
    """The ground of each image by its name, None for that of all others: estimated from its vehicles, else given."""
    scenes: list[Mapping[str, Any]] = data.get("scenes") or []
    given = ground_of(settings)
    if len(scenes) == 1:
        return {None: ground_of(scenes[0]) or given}
    return {None: given} | {scene["image"]: ground_of(scene) or given for scene in scenes}


def _with_images(data: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], str]]:
    """Each vehicle with the name of its image, an image of a track having but one.

    Where no vehicle tells its image, ids do that are `IMAGE:VEHICLE`: all of them are, and the file does not say that
    they were solved as the vehicles of one image.
    """
    entries: list[Mapping[str, Any]] = data["instances"]
    if "tracks" in data:
        return [(entry, str(entry["id"])) for entry in entries]
    names: list[Any] = [entry.get("image") for entry in entries]
    if not any(names) and len(data.get("scenes") or []) != 1:
        of_ids = [str(entry["id"]).rpartition(":")[0] for entry in entries]
        names = of_ids if all(of_ids) else names
    return [(entry, str(image or "")) for entry, image in zip(entries, names, strict=True)]


def _named(
    entry: Mapping[str, Any], image: str, surfaces: Surfaces, grounds: Mapping[str | None, Ground | None]
) -> NamedResult:
    """A vehicle of an image."""
    result = surfaces.complete(Reconstruction.from_dict(entry["result"]))
    box, labelled, track = entry.get("box"), entry.get("location_in_label_frame"), entry.get("track")
    return NamedResult(
        name=str(entry["id"]),
        result=result,
        box=None if box is None else as_finite("box", box, (4,)),
        label_offset=None if labelled is None else result.location - as_finite("location", labelled, (3,)),
        image=image,
        camera=_camera(entry.get("camera")),
        ground=grounds.get(image, grounds[None]),
        kind=entry.get("kind"),
        score=entry.get("score"),
        track=track if isinstance(track, int) else None,
    )


def _camera(fields: Mapping[str, Any] | None) -> Camera | None:
    if fields is None:
        return None
    size = fields["image_size"]
    shape = None if size is None else (size[0], size[1])
    sigma = fields.get("focal_sigma", 0.0)
    return Camera(np.array(fields["matrix"]), image_size=shape, focal_sigma=sigma, **lens_of(fields))
