"""Vehicles of one file: read a photograph or keypoints, solve, collect warnings, and write the results file.

Commands, the service and the page are made of it:

    file ---- read_file ---- tasks, one for each vehicle ---- solve_file ---- outcomes, warnings, results file

The results file has settings, and result or error of each vehicle (`docs/schemas/results.schema.json`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.batch.solve_tasks import (
    Outcome,
    SolvedImage,
    fit_warnings,
    solve_tasks,
    with_closest,
)
from fgrecon.batch.vehicle_tasks import (
    KeypointRequest,
    VehicleTask,
    Watch,
    image_tasks,
    input_warnings,
    read_tasks,
    unwatched,
    with_classes,
)
from fgrecon.core.camera import Ground
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.serialise import rounded
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.io.cameras.camera_source import CameraSource, assumed_focal_length
from fgrecon.io.images import IMAGES, read_photograph
from fgrecon.io.run_settings import RunSettings, camera_to_dict, settings_to_dict
from fgrecon.perception.boxes import GivenBoxes
from fgrecon.perception.sensor_source import SensorSource

SCHEMA_VERSION = 2
"""Of the results files, those of tracks included."""

FORMAT = f"fgrecon.reconstructions/{SCHEMA_VERSION}"


@cache
def installed_version() -> str:
    """The version that results files state."""
    return metadata.version("fgrecon")


def entry_of(
    task: VehicleTask, result: Reconstruction | None, error: FgreconError | None, *, history: bool
) -> dict[str, Any]:
    """A vehicle for JSON: id, camera, box, and pose and result, or the error with which it was refused."""
    offset, box = task.label_offset, task.instance.box
    entry: dict[str, Any] = {
        "id": task.instance.name,
        "camera": camera_to_dict(task.camera),
        "box": None if box is None else np.asarray(box, dtype=np.float64).tolist(),
        **({} if task.box_model is None else {"box_model": task.box_model.value}),
        **{name: value for name in ("kind", "score", "track") if (value := getattr(task.instance, name)) is not None},
    }
    if result is not None:
        small = result.to_dict(compact=True, history=history)
        location = [row[3] for row in small["camera_T_object"][:3]]
        entry |= {"rotation_y": rounded("coefficients", result.rotation_y), "location": location}
        if offset is not None:
            entry["location_in_label_frame"] = rounded("camera_T_object", (result.location - offset).tolist())
        return entry | {"error": None, "result": small}
    refusal = {"type": type(error).__name__, "message": str(error)}
    if isinstance(error, InvalidInputError):
        refusal |= {"field": error.field, "fix": error.fix}
    return entry | {"error": refusal, "result": None}


def _entry(outcome: Outcome, photograph: Path | None, *, history: bool) -> dict[str, Any]:
    """A vehicle for JSON, with the name of its image as far as that is known."""
    entry = entry_of(outcome.task, outcome.result, outcome.error, history=history)
    image = outcome.task.instance.image or (None if photograph is None else photograph.name)
    entry |= {} if image is None else {"image": image}
    return entry if outcome.closest is None else entry | {"closest_model": outcome.closest.to_dict()}


@dataclass(frozen=True)
class FileRequest:
    """What is requested of a file."""

    settings: RunSettings  # what holds for every vehicle
    source: CameraSource = field(default_factory=CameraSource)  # what is given of the camera
    boxes: GivenBoxes = field(default_factory=GivenBoxes)  # of a photograph, where the boxes are from
    weights: Path | None = None  # of a photograph, the keypoint network; None for the shipped one
    box_model: BoxModel | None = None  # what 2D boxes of a photograph enclose; None for what their source says
    # of keypoints, what they are called, as `fgrecon.keypoints_from` takes it; None where they say it
    names: str | None = None
    sensors: SensorSource | None = None  # other sensors' files, or None
    # whether the vehicles of an image share its ground; None for those of photographs, where pose and shape move
    # together
    together: bool | None = None
    jobs: int = 1  # processes
    models: Sequence[VehicleMesh] = ()  # car models that vehicles are compared with
    watch: Watch = unwatched  # shows progress

    def shares_ground(self, file: Path) -> bool:
        """Whether the vehicles of a file's images are solved together."""
        return is_image(file) and self.settings.options.shape.joint if self.together is None else self.together


@dataclass(frozen=True)
class ReadFile:
    """The vehicles of a file, not solved yet."""

    path: Path  # the file
    photograph: Path | None  # the image that it is or belongs to, or None
    tasks: list[VehicleTask]
    source: CameraSource  # what is given of its camera, with the photograph's pixels and EXIF data
    left_out: dict[str, int] = field(default_factory=dict)  # what was left out: a count for each reason
    notes: tuple[str, ...] = ()  # lines that say of vehicles of a photograph what was left out
    warnings: tuple[str, ...] = ()  # lines that say so of a keypoint file
    ignored: tuple[str, ...] = ()  # names of fields of the file that mean nothing to fgrecon


def is_image(path: Path) -> bool:
    """Whether a file is an image, by its ending."""
    return path.suffix.lower() in IMAGES


def read_file(path: Path, request: FileRequest, photograph: Path | None = None) -> ReadFile:
    """The vehicles of a photograph, with the keypoints that the networks detect; or of a file of keypoints or a track.

    Raises:
        InvalidInputError: A file cannot be used, there is no car in the photograph, or a vehicle has no camera.
    """
    source, image = request.source, path if is_image(path) else photograph
    if image is not None:
        pixels, exif = read_photograph(image, source.whole)
        source = replace(source, image=pixels, exif=exif)
    return _photograph(path, source, request) if is_image(path) else _keypoints(path, source, request, photograph)


def _photograph(path: Path, source: CameraSource, request: FileRequest) -> ReadFile:
    category, classes = request.settings.prior.category, request.settings.classes
    assert source.image is not None
    found = request.boxes.of_image(path, source.image, scale_to_image=source.scale_to_image, classes=classes)
    how = KeypointRequest(category, request.weights, request.box_model, classes=classes)
    tasks = image_tasks(path, source, found.cars, how, request.watch, request.sensors)
    notes = tuple(f"{path.name}: {line}" for line in found.notes(category.name))
    return ReadFile(path, path, tasks, source, found.reasons, notes)


def _keypoints(path: Path, source: CameraSource, request: FileRequest, photograph: Path | None) -> ReadFile:
    image = None if photograph is None else photograph.name
    read = read_tasks(path, request.settings.prior.category, source, request.names, image)
    tasks = with_classes(read.tasks, request.settings.classes)
    tasks = _with_evidence(tasks, request.sensors, photograph or path)
    left_out = {str(error): 1 for error in read.left_out}
    return ReadFile(path, photograph, tasks, source, left_out, (), tuple(read.warnings), read.ignored)


def _with_evidence(tasks: list[VehicleTask], sensors: SensorSource | None, file: Path) -> list[VehicleTask]:
    """The vehicles of a keypoint file with what other sensors say of their images.

    Args:
        file: The photograph, else the keypoint file, whose name the sensors' files have where vehicles name no image.
    """
    if sensors is None:
        return tasks
    paths = [file if one.instance.image in (None, file.name) else Path(str(one.instance.image)) for one in tasks]
    sensors.check(path.name for path in paths)
    known = {path: sensors.evidence(path) for path in paths}
    return [replace(one, evidence=known[path]) for path, one in zip(paths, tasks, strict=True)]


@dataclass(frozen=True)
class SolvedFile:
    """What became of the vehicles of a file."""

    read: ReadFile
    settings: RunSettings  # what held for all
    outcomes: list[Outcome]  # one per vehicle
    images: list[SolvedImage]  # what was solved together

    @property
    def grounds(self) -> dict[str | None, Ground | None]:
        """The ground of each image, by its name: the one estimated from its vehicles, or the given one."""
        given = {task.instance.image: self.settings.ground for task in self.read.tasks}
        return given | {one.image: one.result.ground for one in self.images}

    @property
    def ground(self) -> Ground | None:
        """The ground of the first vehicle's image."""
        return next(iter(self.grounds.values()), self.settings.ground)

    @property
    def contradictions(self) -> list[str]:
        """What must be wrong with the keypoints or the camera."""
        return input_warnings(self.read.tasks, detected=is_image(self.read.path)) or fit_warnings(self.outcomes)

    @property
    def focal_lengths(self) -> list[str]:
        """Of each image whose camera was not known how its focal length was estimated."""
        cameras = [image.result.camera for image in self.images if image.result.camera.focal_sigma]
        return [assumed_focal_length(camera, self.read.source.exif) for camera in cameras]

    @property
    def parts_left_out(self) -> list[str]:
        """What was left out of the vehicles' observations, and why."""
        solved = ((one.name, one.result) for one in self.outcomes if one.result is not None)
        return [f"{name}: {line}" for name, result in solved for line in result.diagnostics.left_out]

    @property
    def warnings(self) -> list[str]:
        """All that there is to warn of, for who sees nothing else."""
        lines = (*self.read.warnings, *self.read.notes)
        return [*lines, *self.contradictions, *self.focal_lengths[:1], *self.parts_left_out]

    def document(self, *, history: bool = False, warnings: Sequence[str] = (), path: Path | None = None) -> str:
        """The JSON text of the results file: settings, and result or error of every vehicle.

        Args:
            path: What the file is called there; None for what it is.
        """
        read, settings = self.read, self.settings
        shape = settings.options.shape
        content = {
            "format": FORMAT,
            "schema_version": SCHEMA_VERSION,
            "fgrecon": installed_version(),
            "file": str(path or read.path),
            "settings": settings_to_dict(settings) | {"joint": shape.joint, "free_offsets": shape.free_offsets},
            **({"warnings": list(warnings)} if warnings else {}),
            **({"left_out": [{"reason": r, "count": n} for r, n in read.left_out.items()]} if read.left_out else {}),
            **({"scenes": [image.to_dict() for image in self.images]} if self.images else {}),
            "instances": [_entry(outcome, read.photograph, history=history) for outcome in self.outcomes],
        }
        return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def solve_file(read: ReadFile, request: FileRequest) -> SolvedFile:
    """Solve the vehicles of a file.

    Raises:
        InvalidInputError: Vehicles cannot be solved together, or compared with the models.
    """
    settings, together = request.settings, request.shares_ground(read.path)
    outcomes, images = solve_tasks(read.tasks, settings, together=together, jobs=request.jobs, watch=request.watch)
    return SolvedFile(read, settings, with_closest(outcomes, request.models), images)
