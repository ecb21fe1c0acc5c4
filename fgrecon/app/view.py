"""What the page shows of an upload, as plain values and files made by a worker."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded, solve
from fgrecon.batch.file_service import SolvedFile
from fgrecon.batch.solve_tasks import Outcome, with_closest
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.vehicle_mesh import ClosestModel, VehicleMesh
from fgrecon.io.catalogue import load_prior
from fgrecon.io.export.mesh import glb_bytes
from fgrecon.io.export.results import NamedResult
from fgrecon.io.export.table import csv_text
from fgrecon.io.images import read_image
from fgrecon.io.keypoint_file import Instance
from fgrecon.io.models import read_models
from fgrecon.viz import style
from fgrecon.viz.from_above import draw_scene_from_above, ellipse_scale, extent_from_above
from fgrecon.viz.geometry import BOX_EDGES, image_points, level_axes, outline_corners, resolution
from fgrecon.viz.outcomes import cells_of, drawn_of, message_of, recordings
from fgrecon.viz.picture import as_rgb, new_figure, place_axes
from fgrecon.viz.scene_picture import scene_picture
from fgrecon.viz.subjects import DrawnScene, jpeg, result_step

_QUALITY = 90
_ABOVE = 4.0  # inches, of the view from above
_FAR = 1e4  # metres, of the horizon

Pixels = list[list[float] | None]


@dataclass(frozen=True)
class ShownStep:
    """The estimate of a vehicle at one step: its wireframe in the image, weights, and energy by term in nats."""

    title: str
    wireframe: Pixels
    weights: list[float]
    energies: dict[str, float]


@dataclass(frozen=True)
class ShownCar:
    """A vehicle as the page shows it."""

    name: str  # its id
    cells: list[str]  # of the table, see `fgrecon.viz.outcomes.HEADINGS`; then its message
    colour: str  # as CSS has it
    instance: dict[str, Any]  # it as a keypoint file has it
    keypoints: list[str]  # names of the keypoints
    edges: list[list[int]]  # of the wireframe
    steps: list[ShownStep]  # from the start to the result; empty where there is none
    frame: list[Pixels] = field(default_factory=list)  # the edges of its 3D box in the image
    # probability, nats above the result, yaw in degrees and place in metres of other poses
    others: list[list[str]] = field(default_factory=list)
    factors: dict[str, int] = field(default_factory=dict)  # how many factors of each term its graph has

    def is_trusted(self, keypoint: int) -> bool:
        """Whether a keypoint was given as rather right than wrong."""
        confidence = self.instance.get("confidence")
        if confidence is None:
            return True
        midpoint = self.instance["confidence_midpoint"] or Observation.confidence_midpoint
        return bool((confidence[keypoint] or 0.0) >= midpoint)


@dataclass(frozen=True)
class PageView:
    """What the page shows of an upload."""

    size: tuple[int, int]  # width and height of the image in pixels
    photograph: bytes  # JPEG; empty where there is none
    cars: list[ShownCar]  # the vehicles
    camera: dict[str, Any]  # K and distortion, as a keypoint file has them
    horizon: Pixels  # its two ends in the image
    warnings: list[str]  # what there is to warn of
    files: dict[str, bytes]  # what can be downloaded, by name
    height: float = 0.0  # metres of the camera above the middle one of the cars' lowest points; 0 where none has a pose
    closest: list[str] = field(default_factory=list)  # the closest car model of each, in words


def view_of(folder: Path, uploaded: Uploaded, requested: Requested, models: Path | None = None) -> PageView:
    """Solve an upload and make all that the page shows of it.

    Args:
        folder: Where the files are.
        uploaded: Their names.
        models: Car models that cars are compared with, a folder or file; or None.
    """
    try:
        solved = solve(folder, uploaded, requested, history=True)
    except InvalidInputError as error:
        if error.field != "detect":
            raise
        return _without_cars(folder / uploaded.main, str(error))
    camera = solved.outcomes[0].task.camera
    pixels = solved.read.source.image
    width, height = resolution(camera, pixels)
    text = solved.document(history=True, path=Path(uploaded.main))
    files = {"results.json": text.encode()}
    named = [NamedResult(one.name, one.result) for one in solved.outcomes if one.result is not None]
    posed = [item for item in named if item.solved]
    known = {} if models is None else _closest(solved.outcomes, models, requested)
    if posed:
        files |= {"cars.csv": csv_text(named).encode(), "cars.glb": glb_bytes(posed)}
        if known:
            meshes = {name: one.model for name, one in known.items()}
            files["models.glb"] = glb_bytes([item for item in posed if item.name in known], meshes)
        files["above.png"] = _above(solved, camera, (width, height))
    return PageView(
        size=(round(width), round(height)),
        photograph=b"" if pixels is None else jpeg(pixels, _QUALITY),
        cars=[_car(number, outcome) for number, outcome in enumerate(solved.outcomes)],
        camera={"K": camera.matrix.tolist(), "image_size": [round(width), round(height)], **camera.lens_fields},
        horizon=_horizon(solved, camera, width),
        warnings=[line.replace(f"{folder}/", "") for line in solved.warnings],
        files=files,
        closest=[f"{name}: {one}" for name, one in known.items()],
        height=float(np.median([item.result.location[1] for item in posed])) if posed else 0.0,
    )


def _closest(outcomes: Sequence[Outcome], models: Path, requested: Requested) -> dict[str, ClosestModel]:
    """The closest model of each car with a pose, by its name."""
    compared = with_closest(outcomes, _models(models, requested.prior or "car14"))
    return {outcome.name: outcome.closest for outcome in compared if outcome.closest is not None}


@lru_cache(maxsize=1)
def _models(path: Path, prior: str) -> list[VehicleMesh]:
    return read_models(path, load_prior(prior).category)


def _without_cars(photograph: Path, words: str) -> PageView:
    """A photograph in which no car was detected: boxes can be drawn."""
    pixels = read_image(photograph)
    return PageView((pixels.shape[1], pixels.shape[0]), jpeg(pixels, _QUALITY), [], {}, [], [words], {})


def picture_of(folder: Path, uploaded: Uploaded, requested: Requested) -> bytes:
    """The picture of `fgrecon reconstruct --picture` as PNG."""
    solved = solve(folder, uploaded, requested, history=False)
    camera = solved.outcomes[0].task.camera
    figure = scene_picture(solved.read.source.image, drawn_of(solved.outcomes), camera, ground=solved.ground)
    return _png(as_rgb(figure, 200))


def recording_of_upload(folder: Path, uploaded: Uploaded, requested: Requested) -> bytes:
    """The recording of `fgrecon reconstruct --save`, for rerun's viewer."""
    solved = solve(folder, uploaded, requested, history=True)
    image = solved.outcomes[0].task.instance.image
    made = recordings(solved.outcomes, solved.read.source.image, {image: solved.ground})
    path = folder / "recording.rrd"
    made[0][1].write(path)
    return path.read_bytes()


def _png(image: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    Image.fromarray(image).save(out := io.BytesIO(), "png", compress_level=3)
    return out.getvalue()


def _above(solved: SolvedFile, camera: Camera, size: tuple[float, float]) -> bytes:
    scene = DrawnScene(drawn_of(solved.outcomes), camera, size, solved.ground)
    extent = extent_from_above(scene)
    across, ahead = extent[1] - extent[0]
    if across < ahead:
        extent[:, 0] += np.array([-0.5, 0.5]) * (ahead - across)
    else:
        extent[1, 1] += across - ahead
    figure = new_figure(_ABOVE, _ABOVE)
    axes = place_axes(figure, 0.42, 0.36, _ABOVE - 0.5, _ABOVE - 0.44)
    draw_scene_from_above(axes, scene, extent, ellipse_scale(scene, (extent[1, 0] - extent[0, 0]) / (_ABOVE * 25.4)))
    return _png(as_rgb(figure, 180))


def _pixels(points: Array) -> Pixels:
    return [[round(float(u), 1), round(float(v), 1)] if np.isfinite((u, v)).all() else None for u, v in points]


def _horizon(solved: SolvedFile, camera: Camera, width: float) -> Pixels:
    right, _, ahead = level_axes(solved.ground)
    if solved.ground is None:
        return []
    aside = 0.5 * width / float(camera.matrix[0, 0])
    return _pixels(image_points(camera, np.eye(4), _FAR * np.stack([ahead - aside * right, ahead + aside * right])))


def _car(number: int, outcome: Outcome) -> ShownCar:
    result, camera = outcome.result, outcome.task.camera
    red, green, blue = style.categorical(number)
    *cells, _ = cells_of(outcome)
    car: dict[str, Any] = {
        "name": outcome.name,
        "cells": [*cells, message_of(outcome)],
        "colour": f"rgb({red},{green},{blue})",
        "instance": instance_of(outcome.task.instance),
    }
    if result is None:
        return ShownCar(**car, keypoints=[], edges=[], steps=[])
    names = list(result.shape.keypoint_names)
    titled = [(f"{one.stage}, update {one.irls}, step {one.step}", one) for one in result.diagnostics.history]
    steps = [
        ShownStep(title, _pixels(one.projections), _numbers(one.weights), dict(one.energies))
        for title, one in [*titled, ("result", result_step(result))]
    ]
    corners = image_points(camera, result.camera_T_object, outline_corners(result.box_size))
    others = [
        [f"{one.probability:.2f}", f"{one.excess:.1f}", *_place(one.camera_T_object)]
        for one in result.uncertainty.alternatives
    ]
    return ShownCar(
        **car,
        keypoints=names,
        edges=result.shape.edges.tolist(),
        steps=steps,
        frame=[_pixels(corners[edge]) for edge in BOX_EDGES],
        others=[[f"{result.uncertainty.pose_probability:.2f}", "0.0", *_place(result.camera_T_object)], *others],
        factors=dict(Counter(factor.term for factor in result.diagnostics.graph)),
    )


def _place(camera_T_object: Array) -> list[str]:
    yaw = float(np.degrees(rotation_y(camera_T_object)))
    return [f"{yaw:.0f}", ", ".join(f"{number:.2f}" for number in camera_T_object[:3, 3])]


def _numbers(values: Array) -> list[float]:
    return [round(float(value), 3) for value in np.nan_to_num(values)]


def instance_of(given: Instance) -> dict[str, Any]:
    """A vehicle as a keypoint file has it."""
    arrays = {name: getattr(given, name) for name in ("confidence", "covariance", "box", "azimuth")}
    plain = {name: np.asarray(value).tolist() for name, value in arrays.items() if value is not None}
    keypoints = [None if point is None else point for point in _pixels(given.keypoints)]
    return {
        "id": given.name,
        "keypoints": keypoints,
        "confidence_midpoint": given.confidence_midpoint,
        **plain,
    }
