"""Output of `fgrecon refine` beside the boxes: table and JSON. Imported when it runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata

import numpy as np
from rich.markup import escape

from fgrecon.cli.terminal import Screen, compact_table
from fgrecon.core.input_warnings import InputWarnings, camera_warning_of
from fgrecon.core.refined_box import RefinedBox
from fgrecon.core.text import counted, printable
from fgrecon.io.run_settings import camera_to_dict, settings_to_dict
from fgrecon.perception.refine_files import RefinedImage, RefineRequest
from fgrecon.solve.box_origin import BOTTOMS, CENTRES

FORMAT = "fgrecon.refined-boxes/1"

_SHOWN = 40  # boxes in the table of several images, without --verbose
_HEADINGS = "box", "at m", "moved m", "turned °", "l, w, h cm", "facing %", "status"


def show(screen: Screen, done: Sequence[RefinedImage]) -> None:
    """A row for each box, the first ones of several images; what could not be used; and how many were refined."""
    rows = [(one, line, box) for one in done for line, box in one.boxes]
    shown = rows if screen.verbose or len(done) == 1 else rows[:_SHOWN]
    table = compact_table(*_HEADINGS, text=("box", "status"), no_wrap=True)
    several = len(done) > 1
    kept: dict[str, list[str]] = {}
    for one, line, box in shown:
        name = f"{one.image.name}:{line.number}" if several else str(line.number)
        table.add_row(*(escape(printable(cell)) for cell in (name, *_cells(box))))
        if not box.changed and not box.message.endswith((CENTRES, BOTTOMS)):  # which are warned of
            kept.setdefault(box.message, []).append(name)
    if shown:
        screen.print(table)
    for message, names in kept.items():
        screen.print(escape(printable(f"{', '.join(names)}: {message}")))
    if len(shown) < len(rows):
        screen.print(f"{len(rows) - len(shown)} more: --verbose lists them, --json writes them.")
    for one in done:
        if one.error is not None:
            screen.warn(f"{one.image.name}: the boxes stay as they are: {one.error}")
    for contradiction in (CENTRES, BOTTOMS):
        if rows and all(box.message.endswith(contradiction) for _, _, box in rows):
            screen.warn(contradiction)
    cameras = {one.image.name: camera_warning_of(one.camera) for one in done if one.camera is not None}
    warnings = InputWarnings.of(cameras)
    for one, line, box in rows:
        if box.result is not None:
            warnings.add_scanned(f"{one.image.name}:{line.number}", box.result.diagnostics.own_shares)
    for warning in warnings.lines():
        screen.warn(warning)
    changed = [box for _, _, box in rows if box.changed]
    flipped = sum(box.flipped for box in changed)
    screen.print(
        f"{len(changed)} of {counted(len(rows), 'box', 'boxes')} in {counted(len(done), 'image')} were refined, "
        f"{flipped} of them with a heading flip; {len(rows) - len(changed)} stay as they are."
    )


def _cells(box: RefinedBox) -> tuple[str, ...]:
    at = f"{np.linalg.norm(box.given.location):.1f}"
    covariance, yaw = box.location_covariance, box.yaw_sigma
    if not box.changed or covariance is None or yaw is None:
        return at, "", "", "", "", "unchanged"
    size = ""
    if box.box.size is not None and box.given.size is not None:
        size = ", ".join(f"{100.0 * change:+.0f}" for change in box.box.size - box.given.size)
    return (
        at,
        f"{np.linalg.norm(box.moved):.2f} ± {np.sqrt(np.linalg.eigvalsh(covariance)[-1]):.2f}",
        f"{np.degrees(box.turn):.1f} ± {np.degrees(yaw):.1f}",
        size,
        "" if np.isnan(box.facing_probability) else f"{100.0 * box.facing_probability:.0f}",
        "" if box.result is None else box.result.status.value,
    )


def document(request: RefineRequest, done: Sequence[RefinedImage]) -> str:
    """The JSON text: settings, and every box before and after. Locations are in the camera's frame."""
    content = {
        "format": FORMAT,
        "fgrecon": metadata.version("fgrecon"),
        "settings": settings_to_dict(request.settings)
        | {"box_errors": asdict(request.errors), "min_score": request.min_score},
        "images": [
            {
                "image": one.image.name,
                "file": None if one.image.image is None else str(one.image.image),
                "boxes_file": str(one.image.source),
                "camera": None if one.camera is None else camera_to_dict(one.camera),
                "label_offset": one.offset.tolist(),
                "error": None if one.error is None else str(one.error),
                "boxes": [{**line.place, "type": line.kind, **box.to_dict()} for line, box in one.boxes],
            }
            for one in done
        ],
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
