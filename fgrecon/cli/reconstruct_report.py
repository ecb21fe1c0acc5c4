"""What `fgrecon reconstruct` shows and writes: table, JSON, pictures, recordings. Imported when it runs."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape

from fgrecon.batch.solve_tasks import Outcome, SolvedImage
from fgrecon.batch.vehicle_tasks import VehicleTask
from fgrecon.cli.terminal import Screen, compact_table
from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.geometry import box_around
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.rounding import rounded
from fgrecon.core.text import printable
from fgrecon.io.run_settings import RunSettings, camera_to_dict, settings_to_dict
from fgrecon.solve.track import TrackReconstruction
from fgrecon.viz import (
    DrawnVehicle,
    Recording,
    SolvedVehicle,
    animate,
    contact_sheet,
    picture,
    save_picture,
    scene_picture,
    scene_recording_of,
)
from fgrecon.viz.delivery import recordings_of
from fgrecon.viz.subjects import detection_words

SCHEMA_VERSION = 2
"""Of the results files, those of tracks included."""

FORMAT = f"fgrecon.reconstructions/{SCHEMA_VERSION}"

_TRUSTED = 0.5  # weight from which a keypoint counts as trusted
_HEADINGS = ("id", "status", "yaw °", "x, y, z m", "l, w, h m", "trusted")
_CLAUSE = 200  # characters of a message in the table, which wraps it
_ROWS = 300  # vehicles that the table has at most: it is for eyes, and slow to lay out
_WIDE = 130  # columns of the terminal that leave it that room
_PLATE, _WORDS = 6, 24  # characters of a vehicle's name on its plate in a picture, and beside its numbers
_TOGETHER = 40  # vehicles of an image that one recording has at most


def print_table(screen: Screen, outcomes: Sequence[Outcome]) -> None:
    """One row per vehicle, refused ones included; messages in the last column, or below where there is no room.

    A verbose screen has whole messages below, with energies and times. Of very many vehicles the first are shown.
    """
    if screen.quiet:
        return
    outcomes, others = outcomes[:_ROWS], outcomes[_ROWS:]
    wide = screen.console.width >= _WIDE and any(map(_clause, outcomes))
    table = compact_table(*_HEADINGS, text=("id", "status"), no_wrap=True, overflow="fold")
    if wide:
        table.add_column("message", overflow="fold")
    for outcome in outcomes:
        cells = _cells(outcome)
        table.add_row(*(escape(printable(cell)) for cell in (cells if wide else cells[:-1])))
    screen.print(table)
    for outcome in outcomes:
        if screen.verbose:
            screen.print(f"{outcome.name}: {_message(outcome)}", *details(outcome.result))
        elif not wide and (clause := _clause(outcome)):
            screen.print(f"{outcome.name}: {clause}")
    for outcome in outcomes:
        if outcome.closest is not None:
            screen.print(f"{outcome.name}: closest model {printable(str(outcome.closest))}.")
    if others:
        counts = Counter("refused" if other.result is None else other.result.status.value for other in others)
        listed = ", ".join(f"{count} {status}" for status, count in counts.most_common())
        screen.print(f"... and {len(others)} more ({listed}). The results file of --json or --out has all of them.")


def image_lines(image: SolvedImage) -> list[str]:
    """What was estimated of an image beside its vehicles."""
    lines = [] if image.image is None else [f"{image.image}:"]
    return lines + repr(image.result).splitlines()[: -len(image.result.vehicles) or None]


def details(result: Reconstruction | TrackReconstruction | None) -> list[str]:
    """Lines about energies and times of a result."""
    if result is None:
        return []
    of = result.diagnostics if isinstance(result, Reconstruction) else result
    energies = ", ".join(f"{term} {energy:.2f}" for term, energy in of.energies.items())
    times = ", ".join(f"{stage} {ms:.1f}" for stage, ms in of.milliseconds.items())
    regions = f"  regions: {result.uncertainty.regions.value}" if isinstance(result, Reconstruction) else ""
    return [line for line in (f"  energies (nats): {energies}", f"  times (ms): {times}", regions) if line]


def _message(outcome: Outcome) -> str:
    """The whole message, or why the vehicle was refused."""
    return str(outcome.error) if outcome.result is None else outcome.result.message


def _clause(outcome: Outcome) -> str:
    """The message in a few words; nothing where it converged."""
    if outcome.result is not None and outcome.result.status is Status.CONVERGED:
        return ""
    error = outcome.error
    if isinstance(error, InvalidInputError):
        text = f"{error.field}: {error.value}"
    else:
        text = re.split(r" \(|[;:] |\.$|\. ", _message(outcome), maxsplit=1)[0]
    return text if len(text) <= _CLAUSE else f"{text[: _CLAUSE - 1]}…"


def _cells(outcome: Outcome) -> tuple[str, ...]:
    result = outcome.result
    if result is None:
        return (outcome.name, "refused", "", "", "", "", _clause(outcome))
    measured = np.isfinite(outcome.task.instance.keypoints[:, 0])
    return (
        outcome.name,
        result.status.value,
        f"{np.degrees(result.rotation_y):.1f}",
        ", ".join(f"{number:.2f}" for number in result.location),
        ", ".join(f"{number:.2f}" for number in result.box_size),
        f"{np.count_nonzero(result.diagnostics.weights >= _TRUSTED)} of {np.count_nonzero(measured)}",
        _clause(outcome),
    )


def document(
    path: Path,
    outcomes: Sequence[Outcome],
    settings: RunSettings,
    images: Sequence[SolvedImage] = (),
    photograph: Path | None = None,
    *,
    history: bool = False,
) -> str:
    """The JSON text of a run: settings, and result or error of every vehicle.

    Args:
        path: The input.
        outcomes: One per vehicle.
        settings: What held for all.
        images: Images whose vehicles were solved together.
        photograph: The image of vehicles of which the input does not say it, or None.
        history: Whether results keep their history and graph.
    """
    content = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "fgrecon": metadata.version("fgrecon"),
        "file": str(path),
        "settings": settings_to_dict(settings)
        | {"joint": settings.options.shape.joint, "free_offsets": settings.options.shape.free_offsets},
        **({"scenes": [image.to_dict() for image in images]} if images else {}),
        "instances": [_entry(outcome, photograph, history=history) for outcome in outcomes],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


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
        **{name: value for name in ("kind", "score") if (value := getattr(task.instance, name)) is not None},
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


def draw(
    path: Path,
    outcomes: Sequence[Outcome],
    image: NDArray[np.uint8] | None,
    grounds: Mapping[str | None, Ground | None],
    *,
    sheet: bool,
) -> list[Path]:
    """Draw the results: the scene of an image; nothing where there is no result.

    Args:
        path: File to write.
        outcomes: One per vehicle.
        image: (H, W, 3) photograph.
        grounds: The ground of each image, by its name.
        sheet: Draw the part of the image around each instead, and of a single vehicle the stages. So are vehicles of
            several images drawn in any case.

    Returns:
        The files written.
    """
    sights = _sights(outcomes, image)
    if not sights:
        return []
    if not sheet and len(_by_image(outcomes)) == 1:
        task = outcomes[0].task
        figure = scene_picture(image, _shown(outcomes), task.camera, ground=grounds.get(task.instance.image))
        return [save_picture(path, figure)]
    if len(sights) == 1:
        return [save_picture(path, picture(sights[0]))]
    return [save_picture(path, contact_sheet(sights))]


def _shown(outcomes: Sequence[Outcome]) -> list[DrawnVehicle]:
    """The vehicles as a scene shows them; with long names they are numbered."""
    names = [printable(outcome.name, 80) for outcome in outcomes]
    short = max(map(len, names)) <= _PLATE
    shown = []
    for number, (name, outcome) in enumerate(zip(names, outcomes, strict=True)):
        seen = outcome.task.observation
        box = seen.box
        if box is None:
            measured = seen.keypoints[seen.measured]
            if not len(measured):
                continue
            box = box_around(measured)
        words = "" if short else name if len(name) <= _WORDS else f"{name[: _WORDS - 1]}…"
        model = None if outcome.closest is None else outcome.closest.model
        shown.append(
            DrawnVehicle(
                number,
                box,
                outcome.result,
                words,
                name=name if short else str(number + 1),
                model=model,
                detection=_detection(outcome),
            )
        )
    return shown


def _detection(outcome: Outcome) -> str:
    return detection_words(outcome.task.instance.kind, outcome.task.instance.score)


def draw_moving(path: Path, outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> list[Path]:
    """Animate the optimisation of the only vehicle; nothing where it has no result.

    Returns:
        The files written.
    """
    sights = _sights(outcomes, image)
    for sight in sights:
        animate(path, sight)
    return [path] * len(sights)


def recordings(
    outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None, grounds: Mapping[str | None, Ground | None]
) -> list[tuple[str, Recording]]:
    """Name and recording of every image with its vehicles; of very many vehicles in one, of each.

    Args:
        outcomes: One per vehicle.
        image: (H, W, 3) photograph.
        grounds: The ground of each image, by its name.
    """
    made: list[tuple[str, Recording]] = []
    for (name, _), members in _by_image(outcomes).items():
        sights = _sights(members, image)
        if 1 < len(sights) <= _TOGETHER:
            made.append((Path(name or "scene").stem, scene_recording_of(sights, ground=grounds.get(name))))
        else:
            made += recordings_of(sights, grounds.get(name))
    return made


def _by_image(outcomes: Sequence[Outcome]) -> dict[tuple[str | None, bytes], list[Outcome]]:
    """The vehicles by name and camera of their image."""
    images: dict[tuple[str | None, bytes], list[Outcome]] = {}
    for outcome in outcomes:
        task = outcome.task
        images.setdefault((task.instance.image, task.camera.matrix.tobytes()), []).append(outcome)
    return images


def _sights(outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> list[SolvedVehicle]:
    return [
        SolvedVehicle(
            outcome.result,
            outcome.task.observation,
            outcome.task.camera,
            image,
            title=printable(outcome.name, 80),
            model=None if outcome.closest is None else outcome.closest.model,
            detection=_detection(outcome),
        )
        for outcome in outcomes
        if outcome.result is not None
    ]
