"""`fgrecon evaluate paper`: every table of the paper by one command."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.options import LabelledScene
from fgrecon.cli.terminal import Terminal
from fgrecon.viz import save_picture
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption
from fgrecon_research.evaluation import report
from fgrecon_research.paper.documents import document, markdown
from fgrecon_research.paper.run import evaluate_paper
from fgrecon_research.paper.simulated_run import PaperSettings
from fgrecon_research.viz.paper_picture import paper_picture


def paper_command(
    labelled: LabelledScene,
    terminal: Terminal,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for tables, page, result files and stored parts.")
    ] = Path("evaluation"),
    data: DataOption = DATA,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; results do not depend on it.", show_default="one a core")
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, help="Work on every so many-th part of the simulated set, for a first look.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Work on everything again, whatever parts are stored.")
    ] = False,
) -> None:
    """Make every table of the paper: real tracks, real images, simulated validation set, cars of known shape.

    Writes evaluation.md, evaluation.json, plots.svg and KITTI result files. A run that was interrupted goes
    on where it stopped. Stored parts know the data and settings that they were made from, but not unreleased changes
    of the code: use --fresh after those. Nothing is recorded for the viewer, these are thousands of cars: see
    `fgrecon evaluate tracks --save`. --verbose names every defect of the files and every failure.
    """
    screen = terminal.screen()
    scene = labelled.scene()
    settings = PaperSettings(data, out, scene, workers or os.cpu_count() or 1, every, seed, fresh)
    with screen.bar() as advance:
        found = evaluate_paper(settings, advance)
    parameters = report.settings(scene, {})
    parameters |= {"data": str(data), "workers": settings.workers, "every": every, "seed": seed}
    screen.print(*map(str, found.claims))
    screen.detail(*found.defects, *found.failures)
    screen.write_text(out / "evaluation.md", markdown(found))
    screen.write_text(out / "evaluation.json", report.to_json(document(found, parameters)))
    screen.wrote(save_picture(out / "plots.svg", paper_picture(found.tables)))
    screen.wrote(out / "kitti_results")
