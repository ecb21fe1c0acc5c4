"""The results file of vehicles: settings, and result or error of each (`docs/schemas/results.schema.json`)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.batch.solve_tasks import Outcome, SolvedImage
from fgrecon.batch.vehicle_tasks import VehicleTask
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.rounding import rounded
from fgrecon.io.run_settings import RunSettings, camera_to_dict, settings_to_dict

SCHEMA_VERSION = 2
"""Of the results files, those of tracks included."""

FORMAT = f"fgrecon.reconstructions/{SCHEMA_VERSION}"


@cache
def installed_version() -> str:
    """The version that results files state."""
    return metadata.version("fgrecon")


def document(
    path: Path,
    outcomes: Sequence[Outcome],
    settings: RunSettings,
    images: Sequence[SolvedImage] = (),
    photograph: Path | None = None,
    *,
    history: bool = False,
    warnings: Sequence[str] = (),
    left_out: Mapping[str, int] | None = None,
) -> str:
    """The JSON text of a run: settings, and result or error of every vehicle.

    Args:
        path: The input.
        outcomes: One per vehicle.
        settings: What held for all.
        images: Images whose vehicles were solved together.
        photograph: The image of vehicles of which the input does not say it, or None.
        history: Whether results keep their history and graph.
        warnings: What there is to warn of, for who sees nothing but the file.
        left_out: How many vehicles of the input, or boxes, were left out, by reason.
    """
    content = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "fgrecon": installed_version(),
        "file": str(path),
        "settings": settings_to_dict(settings)
        | {"joint": settings.options.shape.joint, "free_offsets": settings.options.shape.free_offsets},
        **({"warnings": list(warnings)} if warnings else {}),
        **({"left_out": [{"reason": r, "count": n} for r, n in left_out.items()]} if left_out else {}),
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
