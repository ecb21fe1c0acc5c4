"""Pictures, animations and recordings of solved tasks, for commands and the page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.batch.solve_tasks import Outcome
from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around
from fgrecon.core.reconstruction import Status
from fgrecon.core.text import printable
from fgrecon.viz.picture import contact_sheet, picture, save_picture
from fgrecon.viz.scene_picture import scene_picture
from fgrecon.viz.sinks import Recording
from fgrecon.viz.subjects import DrawnVehicle, SolvedVehicle, detection_words

HEADINGS = ("id", "status", "yaw °", "x, y, z m", "l, w, h m", "trusted")
"""Of the columns that `cells_of` gives, without the message."""

_TRUSTED = 0.5  # weight from which a keypoint counts as trusted
_CLAUSE = 200  # characters of a message in a table, which wraps it
_PLATE, _WORDS = 6, 24  # characters of a vehicle's name on its plate in a picture, and beside its numbers
_TOGETHER = 40  # vehicles of an image that one recording has at most


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
    sights = sights_of(outcomes, image)
    if not sights:
        return []
    if not sheet and len(_by_image(outcomes)) == 1:
        task = outcomes[0].task
        figure = scene_picture(image, drawn_of(outcomes), task.camera, ground=grounds.get(task.instance.image))
        return [save_picture(path, figure)]
    if len(sights) == 1:
        return [save_picture(path, picture(sights[0]))]
    return [save_picture(path, contact_sheet(sights))]


def drawn_of(outcomes: Sequence[Outcome]) -> list[DrawnVehicle]:
    """The vehicles as a scene shows them; with long names they are numbered."""
    names = [printable(outcome.name, 80) for outcome in outcomes]
    short = max(map(len, names)) <= _PLATE
    shown = []
    for number, (name, outcome) in enumerate(zip(names, outcomes, strict=True)):
        observation = outcome.task.observation
        box = observation.box
        if box is None:
            measured = observation.keypoints[observation.measured]
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


def recordings(
    outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None, grounds: Mapping[str | None, Ground | None]
) -> list[tuple[str, Recording]]:
    """Name and recording of every image with its vehicles; of very many vehicles in one, of each.

    Args:
        outcomes: One per vehicle.
        image: (H, W, 3) photograph.
        grounds: The ground of each image, by its name.
    """
    from fgrecon.viz.recording import recordings_of  # on use: it imports rerun
    from fgrecon.viz.scene_recording import scene_recording_of

    made: list[tuple[str, Recording]] = []
    for (name, _), members in _by_image(outcomes).items():
        sights = sights_of(members, image)
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


def sights_of(outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> list[SolvedVehicle]:
    """The vehicles with a result as what pictures and recordings are made of, on their photograph (H, W, 3)."""
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


def cells_of(outcome: Outcome) -> tuple[str, ...]:
    """What a table has of it, under `HEADINGS`, and its message in a few words."""
    result = outcome.result
    if result is None:
        return (outcome.name, "refused", "", "", "", "", clause_of(outcome))
    measured = np.isfinite(outcome.task.instance.keypoints[:, 0])
    return (
        outcome.name,
        result.status.value,
        f"{np.degrees(result.rotation_y):.1f}",
        ", ".join(f"{number:.2f}" for number in result.location),
        ", ".join(f"{number:.2f}" for number in result.box_size),
        f"{np.count_nonzero(result.diagnostics.weights >= _TRUSTED)} of {np.count_nonzero(measured)}",
        clause_of(outcome),
    )


def message_of(outcome: Outcome) -> str:
    """The whole message, or why the vehicle was refused."""
    return str(outcome.error) if outcome.result is None else outcome.result.message


def clause_of(outcome: Outcome) -> str:
    """The message in a few words; nothing where it converged."""
    if outcome.result is not None and outcome.result.status is Status.CONVERGED:
        return ""
    error = outcome.error
    if isinstance(error, InvalidInputError):
        text = f"{error.field}: {error.value}"
    else:
        text = re.split(r" \(|[;:] |\.$|\. ", message_of(outcome), maxsplit=1)[0]
    return text if len(text) <= _CLAUSE else f"{text[: _CLAUSE - 1]}…"
