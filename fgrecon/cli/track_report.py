"""The work of `fgrecon track`: reading, solving, table, JSON, sheet, recording. Imported when it runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from fgrecon.batch.file_service import SCHEMA_VERSION, entry_of
from fgrecon.batch.solve_tasks import Outcome, fit_warnings, solve_task
from fgrecon.batch.vehicle_tasks import VehicleTask, input_warnings, read_tasks
from fgrecon.cli.reconstruct_report import details as result_details
from fgrecon.cli.terminal import compact_table
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.serialise import plain, rounded
from fgrecon.core.text import distinct, whole_text
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.images import read_image
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance
from fgrecon.io.keypoints import NOT_JSON
from fgrecon.io.run_settings import RunSettings, settings_to_dict
from fgrecon.io.track_file import Track, parse_track
from fgrecon.perception.sensor_source import IMAGES
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.solve.track import reconstruct_track
from fgrecon.viz import Recording, SolvedVehicle, TrackInputs, Truth, contact_sheet, save_picture

FORMAT = f"fgrecon.track/{SCHEMA_VERSION}"

_SEVERAL = "Give one vehicle a file; `fgrecon reconstruct` takes several vehicles of one image."


@dataclass(frozen=True)
class Solved:
    """A track, its result, and where labels are known the results of its images one by one."""

    name: str  # name of the track
    file: Path  # where it is from
    tasks: tuple[VehicleTask, ...]  # its images
    sight: TrackInputs  # what it was solved from
    result: TrackReconstruction
    # results of the images one by one, aligned with those of the track; empty without labels
    alone: tuple[Reconstruction | None, ...]
    left_out: tuple[str, ...] = ()  # what was left out of the file, a line each

    @property
    def recording(self) -> Recording:
        """Its recording."""
        from fgrecon.viz.track_recording import track_recording_of  # on use: it imports rerun

        return track_recording_of(self.result, self.sight)

    @property
    def contradictions(self) -> list[str]:
        """What must be wrong with the keypoints or the camera."""
        tasks = [self.tasks[index] for index in self.result.numbers]
        solved = [Outcome(task, frame, None) for task, frame in zip(tasks, self.result.frames, strict=True)]
        return input_warnings(self.tasks) or fit_warnings(solved)

    @property
    def truths(self) -> list[Truth | None]:
        """What is known to be true about each image that was solved."""
        truths = self.sight.truths
        return [None if truths is None else truths[index] for index in self.result.numbers]


def solve(
    file: Path, source: CameraSource, settings: RunSettings, images: Path | None, names: str | None = None
) -> Solved:
    """Read a track and solve it.

    Args:
        file: Track, or keypoint file whose instances are the images of one vehicle.
        settings: What holds for all images.
        images: Folder with photographs, or None.
        names: What is known of the keypoints' names, or None.
    """
    read = read_tasks(file, settings.prior.category, source, names)
    tasks = read.tasks
    unplaced = _check_of_one_vehicle(file, [task.instance for task in tasks])
    labelled = _labels(file, settings)
    frames = [(task.instance.name, task.instance.frame) for task in tasks]
    labels = [name if frame is None else str(frame) for name, frame in frames]
    truths = None if labelled is None else [truth_of(labelled, index) for index in range(len(tasks))]
    measured = [task.observation.measured.any() for task in tasks]
    sight = TrackInputs(
        observations=[task.observation if usable else None for task, usable in zip(tasks, measured, strict=True)],
        cameras=[task.camera for task in tasks],
        numbers=image_numbers(labels),
        images=None if images is None else [_image(images, number) for number in _numbers_of(labels)],
        truths=truths,
        ground=settings.ground,
    )
    with summed_up():
        result = reconstruct_track(sight.observations, sight.cameras, **settings.arguments())
    quiet = replace(settings, options=replace(settings.options, keep_history=False))
    solved = [tasks[index] for index in result.numbers] if truths is not None else []
    alone = tuple(solve_task(task, quiet).result for task in solved)
    return Solved(whole_text(file.stem), file, tuple(tasks), sight, result, alone, (*read.warnings, *unplaced))


def _check_of_one_vehicle(file: Path, instances: Sequence[Instance]) -> list[str]:
    """Refuse a file whose instances cannot be one vehicle: two are in one image, or they have several ids.

    Returns:
        A warning where nothing says that they are in several images, not even their names (`car:17`).
    """
    ids = {one.track: one.name for one in instances if one.track is not None}
    if len(ids) > 1:
        (first, a), (second, b), *_ = ids.items()
        raise InvalidInputError("track", f"{file}: {a} has id {first}, {b} has {second}", _SEVERAL)
    seen: dict[tuple[str | None, int | None], str] = {}
    for one in instances:
        where = one.image, one.frame
        if any(place is not None for place in where) and seen.setdefault(where, one.name) != one.name:
            place = one.image or f"frame {one.frame}"
            raise InvalidInputError("image", f"{file}: {seen[where]} and {one.name} are both in {place}", _SEVERAL)
    unplaced = [one.name for one in instances if one.image is None and one.frame is None]
    if len(unplaced) < 2 or all(name.rpartition(":")[2].isdecimal() for name in unplaced):
        return []
    names = " and ".join(unplaced[:2])
    return [f"{names} have neither `image` nor `frame`: taken as images of one vehicle. {_SEVERAL}"]


def distinguished(tracks: Sequence[Solved]) -> list[Solved]:
    """The tracks with distinct names, and so their images, where these have the ids of another track's."""
    names, ids = set[str](), set[str]()
    apart = []
    for track in tracks:
        name = distinct(track.name, names)
        images = [task.instance.name for task in track.tasks]
        if not ids.isdisjoint(images):
            images = [f"{name}:{image.rpartition(':')[2]}" for image in images]
        named = zip(track.tasks, [distinct(image, ids) for image in images], strict=True)
        tasks = tuple(replace(task, instance=replace(task.instance, name=image)) for task, image in named)
        apart.append(replace(track, name=name, tasks=tasks))
    return apart


def _labels(file: Path, settings: RunSettings) -> Track | None:
    """The track with its labels; None where the file is a keypoint file."""
    data = None if file.suffix.lower() in NOT_JSON else read_json(file)
    if not isinstance(data, dict) or "frames" not in data:
        return None
    return parse_track(data, file.stem, settings.prior.category, where=f"{file}: ")


def truth_of(track: Track, index: int) -> Truth:
    """The labelled pose and box in the camera's frame."""
    truth = track.frames[index].truth
    return Truth(yaw_pose(truth.rotation_y, truth.location + track.label_offset), truth.box_size)


def image_numbers(names: Sequence[str]) -> list[int]:
    """Numbers of images in a recording, from their names where these end in increasing numbers, else from 0."""
    numbers = _numbers_of(names)
    return numbers if all(a < b for a, b in pairwise(numbers)) else list(range(len(names)))


def _numbers_of(names: Sequence[str]) -> list[int]:
    """Numbers of images from their names, in whatever order, where all end in numbers; else from 0."""
    ends = [name.rpartition(":")[2] for name in names]
    return [int(end) for end in ends] if all(end.isdecimal() for end in ends) else list(range(len(names)))


def _image(folder: Path, number: int) -> NDArray[np.uint8]:
    for ending in IMAGES:
        path = folder / f"{number:06d}{ending}"
        if path.is_file():
            return read_image(path)
    raise InvalidInputError("images", str(folder / f"{number:06d}.png"), "Give a folder that has every image.")


def table(tracks: Sequence[Solved]) -> Table:
    """One row per track; errors are mean yaw and median position, with a row below of the images one by one."""
    labelled = any(track.sight.truths is not None for track in tracks)
    headings = ["track", "images", "status", "l, w, h m", "ms"]
    headings += ["Δ yaw °", "Δ pos m", "Δ size m"] if labelled else []
    result = compact_table(*headings, text=("track", "status"), overflow="fold")
    for track in tracks:
        solved = track.result
        cells = [
            track.name,
            f"{len(solved.frames)} of {len(solved.frames) + len(solved.refused)}"
            if solved.refused
            else str(len(solved.frames)),
            solved.status.value,
            ", ".join(f"{number:.2f}" for number in solved.box_size),
            f"{sum(solved.milliseconds.values()) / len(solved.frames):.1f}",
        ]
        result.add_row(*cells, *(_error_cells(track.result.frames, track) if labelled else []))
        if track.sight.truths is not None:
            result.add_row("  alone", "", "", "", "", *_error_cells(track.alone, track))
    return result


def _error_cells(results: Sequence[Reconstruction | None], track: Solved) -> list[str]:
    if track.sight.truths is None:
        return ["", "", ""]
    return [f"{error:.2f}" if np.isfinite(error) else "" for error in _errors(results, track.truths)]


def _errors(results: Sequence[Reconstruction | None], truths: Sequence[Truth | None]) -> tuple[float, float, float]:
    """Mean of yaw in degrees, median of position and mean of size in metres; NaN where not known."""
    pairs = [(r, t) for r, t in zip(results, truths, strict=True) if r is not None and t is not None]
    if not pairs:
        return (float("nan"),) * 3
    yaws = [t.errors(r.camera_T_object, r.wireframe) for r, t in pairs]
    sizes = [np.abs(r.box_size - t.box_size).mean() for r, t in pairs if t.box_size is not None]
    return (
        float(np.mean([error["orientation_deg"] for error in yaws])),
        float(np.median([error["translation_m"] for error in yaws])),
        float(np.mean(sizes)) if sizes else float("nan"),
    )


def details(track: Solved) -> list[str]:
    """Lines about refused images, energies and times."""
    refused = [f"  {track.tasks[index].instance.name} refused: {why}" for index, why in track.result.refused.items()]
    return refused + result_details(track.result)


def document(tracks: Sequence[Solved], settings: RunSettings, *, history: bool = False) -> str:
    """The JSON text of a run; its instances are the images of all tracks, as `fgrecon export` reads them.

    Args:
        settings: What held for all.
        history: Whether results keep their history.
    """
    content = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "fgrecon": metadata.version("fgrecon"),
        "settings": settings_to_dict(settings),
        "tracks": [_entry(track) for track in tracks],
        "instances": [entry for track in tracks for entry in _instances(track, history=history)],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def _entry(track: Solved) -> dict[str, Any]:
    result = track.result
    return {
        "track": track.name,
        "file": str(track.file),
        "status": result.status.value,
        "message": result.message,
        "coefficients": rounded("coefficients", result.coefficients.tolist()),
        "box_size": rounded("box_size", result.box_size.tolist()),
        "energies": rounded("energies", plain(result.energies)),
        "milliseconds": rounded("milliseconds", plain(result.milliseconds)),
        "refused": {track.tasks[index].instance.name: reason for index, reason in result.refused.items()},
    }


def _instances(track: Solved, *, history: bool) -> list[dict[str, Any]]:
    """One entry per image that was solved."""
    solved = zip(track.result.numbers, track.result.frames, strict=True)
    named = {"track": track.name}
    return [entry_of(track.tasks[index], frame, None, history=history) | named for index, frame in solved]


def draw(path: Path, tracks: Sequence[Solved]) -> None:
    """A sheet of all images."""
    sights = []
    for track in tracks:
        for index, frame, truth in zip(track.result.numbers, track.result.frames, track.truths, strict=True):
            image = None if track.sight.images is None else track.sight.images[index]
            task = track.tasks[index]
            sights.append(SolvedVehicle(frame, task.observation, task.camera, image, truth, task.instance.name))
    save_picture(path, contact_sheet(sights))
