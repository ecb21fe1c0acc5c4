"""What `fgrecon reconstruct` shows and writes: table, JSON, pictures, recordings. Imported when it runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fgrecon.cli.batch import Outcome, Settings
from fgrecon.cli.deliver import recordings_of
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import SizePrior
from fgrecon.viz import Recording, Sight, animate, contact_sheet, picture, save_picture

__all__ = [
    "FORMAT",
    "document",
    "draw",
    "draw_moving",
    "plain_camera",
    "plain_ground",
    "plain_size",
    "print_table",
    "recordings",
]

FORMAT = "fgrecon.reconstructions/1"

_TRUSTED = 0.5  # weight from which a keypoint counts as trusted
_HEADINGS = ("id", "status", "yaw °", "x, y, z m", "l, w, h m", "trusted", "message")
_WIDE = 130  # columns of the terminal that leave the message some room


def print_table(console: Console, outcomes: Sequence[Outcome]) -> None:
    """One row per vehicle, refused ones included; messages in the last column, or below where there is no room."""
    wide = console.width >= _WIDE
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for heading in _HEADINGS if wide else _HEADINGS[:-1]:
        text = heading in ("id", "status", "message")
        table.add_column(heading, justify="left" if text else "right", no_wrap=heading != "message", overflow="fold")
    for outcome in outcomes:
        cells = _cells(outcome)
        table.add_row(*map(escape, cells if wide else cells[:-1]))
    console.print(table)
    if not wide:
        for outcome in outcomes:
            console.print(f"{outcome.name}: {_cells(outcome)[-1]}", markup=False)


def _cells(outcome: Outcome) -> tuple[str, ...]:
    result = outcome.result
    if result is None:
        return (outcome.name, "refused", "", "", "", "", str(outcome.error))
    measured = np.isfinite(outcome.task.instance.keypoints[:, 0])
    return (
        outcome.name,
        result.status.value,
        f"{np.degrees(result.rotation_y):.1f}",
        ", ".join(f"{number:.2f}" for number in result.location),
        ", ".join(f"{number:.2f}" for number in result.box_size),
        f"{np.count_nonzero(result.weights >= _TRUSTED)} of {np.count_nonzero(measured)}",
        result.message,
    )


def document(path: Path, outcomes: Sequence[Outcome], settings: Settings) -> str:
    """The JSON text of a run: settings, and result or error of every vehicle."""
    options = settings.options
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "file": str(path),
        "settings": {
            "prior": settings.prior.name,
            "ground": plain_ground(settings.ground),
            "size_prior": plain_size(settings.size_prior),
            "strategy": options.strategy.name.value,
            "box_model": options.box.model.value,
            "joint": options.shape.joint,
            "free_offsets": options.shape.free_offsets,
        },
        "instances": [_entry(outcome) for outcome in outcomes],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def plain_ground(ground: Ground | None) -> dict[str, Any] | None:
    """A ground plane for JSON."""
    return None if ground is None else {"normal": ground.normal.tolist(), "distance": ground.distance}


def plain_size(size: SizePrior | None) -> dict[str, Any] | None:
    """A size prior for JSON."""
    return None if size is None else {"name": size.name, "mean": size.mean.tolist(), "sigma": size.sigma.tolist()}


def plain_camera(camera: Camera) -> dict[str, Any]:
    """A camera for JSON."""
    return {
        "matrix": camera.matrix.tolist(),
        "distortion": None if camera.distortion is None else camera.distortion.tolist(),
        "image_size": camera.image_size,
    }


def _entry(outcome: Outcome) -> dict[str, Any]:
    result, error, offset = outcome.result, outcome.error, outcome.task.label_offset
    box = outcome.task.instance.box
    entry: dict[str, Any] = {
        "id": outcome.name,
        "camera": plain_camera(outcome.task.camera),
        "box": None if box is None else np.asarray(box, dtype=np.float64).tolist(),
    }
    if result is not None:
        entry |= {"rotation_y": result.rotation_y, "location": result.location.tolist()}
        if offset is not None:
            entry["location_in_label_frame"] = (result.location - offset).tolist()
        return entry | {"error": None, "result": result.to_dict()}
    told = {"type": type(error).__name__, "message": str(error)}
    if isinstance(error, InvalidInputError):
        told |= {"field": error.field, "fix": error.fix}
    return entry | {"error": told, "result": None}


def draw(path: Path, outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> None:
    """Draw the results: one with its stages, several as a sheet; nothing where there is none."""
    sights = _sights(outcomes, image)
    if len(sights) == 1:
        only = sights[0]
        save_picture(path, picture(only.reconstruction, only.observation, only.camera, image=image))
    elif sights:
        save_picture(path, contact_sheet(sights))


def draw_moving(path: Path, outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> None:
    """Animate the optimisation of the only result; nothing where there is none.

    Raises:
        InvalidInputError: There are several.
    """
    found = [outcome for outcome in outcomes if outcome.result is not None]
    if len(found) > 1:
        raise InvalidInputError("animation", f"{len(found)} vehicles", "Reconstruct one vehicle to animate it.")
    for outcome in found:
        assert outcome.result is not None
        animate(path, outcome.result, outcome.task.observation, outcome.task.camera, image=image)


def recordings(
    outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None, ground: Ground | None
) -> list[tuple[str, Recording]]:
    """Id and recording of every result."""
    return recordings_of(_sights(outcomes, image), ground)


def _sights(outcomes: Sequence[Outcome], image: NDArray[np.uint8] | None) -> list[Sight]:
    return [
        Sight(outcome.result, outcome.task.observation, outcome.task.camera, image, title=outcome.name)
        for outcome in outcomes
        if outcome.result is not None
    ]
