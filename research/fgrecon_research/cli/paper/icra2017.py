"""`fgrecon evaluate icra2017`: the two worked images of the paper's authors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from fgrecon.cli.options import Delivery, JsonOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.reconstruct_report import details
from fgrecon.cli.terminal import Terminal
from fgrecon.io.images import read_image
from fgrecon.viz import SolvedVehicle, contact_sheet, picture, save_picture
from fgrecon.viz.recording import recordings_of
from fgrecon.viz.subjects import Truth
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption
from fgrecon_research.paper.icra2017 import EXAMPLES, GROUND, Icra2017Result, evaluate_icra2017, true_pose

FORMAT = "fgrecon_research.evaluation.icra2017/1"
_RELEASE = {"01": (2.2, 0.96), "02": (7.0, 0.44)}
"""Errors of the authors' C++ release, degrees and metres."""
_RELEASE_MS = {"pose": 0.33, "shape": 11.7}


def icra2017_command(
    delivery: Delivery,
    terminal: Terminal,
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="FOLDER",
            help="Folder of the release: meanShape.txt, basisVectors.txt, examples/.",
            show_default="DATA/icra2017",
        ),
    ] = None,
    data: DataOption = DATA,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="For pictures, made where it does not exist: over the photographs and without them.",
        ),
    ] = None,
    json_out: JsonOption = None,
    runs: Annotated[int, typer.Option(min=1, help="How often to time each image.")] = 5,
) -> None:
    """Reconstruct both cars with the release's 36-point prior and compare with KITTI's labels.

    --verbose shows energies and times.
    """
    check_outputs(json_out)
    delivery.check()
    screen = terminal.screen(json_out)
    release = folder or data / "icra2017"
    results = [
        result
        for name in screen.watch(EXAMPLES, "Images")
        for result in evaluate_icra2017(release, runs=runs, names=[name])
    ]
    screen.print(_table(results))
    for result in results:
        screen.detail(f"{result.name}: {result.reconstruction.message}", *details(result.reconstruction))
    screen.write_document(_document(results))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        screen.wrote(*_draw(results, out))
    if delivery.requested:
        sights = [_sight(result, result.name, photograph=True) for result in results]
        delivery.deliver(recordings_of(sights, GROUND), screen, several=True)


def _document(results: list[Icra2017Result]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "units": {
            "orientation_deg": "degrees",
            "centre_m": "metres between the centres of the boxes",
            "ms": "best run",
        },
        "release": {name: {"orientation_deg": turn, "centre_m": shift} for name, (turn, shift) in _RELEASE.items()},
        "release_ms": _RELEASE_MS,
        "images": {
            result.name: {
                "orientation_deg": result.orientation_error,
                "centre_m": result.centre_error,
                "rotation_y": result.reconstruction.rotation_y,
                "location": result.reconstruction.location.tolist(),
                "box_size": result.reconstruction.box_size.tolist(),
                "status": result.reconstruction.status.value,
                "ms": result.milliseconds,
            }
            for result in results
        },
    }


def _table(results: list[Icra2017Result]) -> Table:
    table = Table(title="The authors' two images (36 points, 42 basis vectors)")
    for heading in ("image", "error °", "centre m", "release: °", "m", "ms pose", "ms shape", "status"):
        table.add_column(heading, justify="right" if heading not in ("image", "status") else "left")
    for result in results:
        turn, shift = _RELEASE[result.name]
        errors = (result.orientation_error, result.centre_error, turn, shift)
        times = (f"{result.milliseconds[stage]:.1f}" for stage in ("pose", "shape"))
        status = result.reconstruction.status.value
        table.add_row(result.name, *(f"{number:.2f}" for number in errors), *times, status)
    return table


def _sight(result: Icra2017Result, title: str, *, photograph: bool) -> SolvedVehicle:
    """The car with the labelled box, over its photograph or without."""
    example = result.example
    image = read_image(example.image) if photograph else None
    truth = Truth(true_pose(example), box_size=example.size)
    return SolvedVehicle(result.reconstruction, example.observation, example.camera, image, truth, title)


def _draw(results: list[Icra2017Result], out: Path) -> list[Path]:
    """Each image's picture over its photograph, and one of both without, which shows nothing of third parties."""
    paths = []
    for result in results:
        sight = _sight(result, result.name, photograph=True)
        drawn = picture(sight)
        paths.append(save_picture(out / f"{result.name}.png", drawn))
    bare = [_sight(result, result.name, photograph=False) for result in results]
    paths.append(save_picture(out / "without_photographs.svg", contact_sheet(bare, columns=2)))
    paths.append(save_picture(out / "without_photographs.png", contact_sheet(bare, columns=2)))
    return paths
