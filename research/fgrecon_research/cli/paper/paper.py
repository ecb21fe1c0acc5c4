"""`fgrecon evaluate paper`: every table of the paper by one command."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.options import LabelledScene
from fgrecon.cli.terminal import Terminal
from fgrecon.viz import SolvedVehicle, Truth, contact_sheet
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption
from fgrecon_research.evaluation import report
from fgrecon_research.paper import page as paper_page
from fgrecon_research.paper.known_shape import ExampleCar
from fgrecon_research.paper.plots import svg_text
from fgrecon_research.paper.run import evaluate_paper
from fgrecon_research.paper.simulated_run import PaperSettings


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

    Writes evaluation.md, evaluation.json, evaluation.html and KITTI result files. A run that was interrupted goes on
    where it stopped. Stored parts know the data and settings that they were made from, but not unreleased changes of
    the code: use --fresh after those. Nothing is recorded for the viewer, these are thousands of cars: see
    `fgrecon evaluate tracks --save`. --verbose names every defect of the files and every failure.
    """
    screen = terminal.screen()
    scene = labelled.scene()
    settings = PaperSettings(data, out, scene, workers or os.cpu_count() or 1, every, seed, fresh)
    with screen.bar() as advance:
        page = evaluate_paper(settings, advance)
    pictures = _pictures(page.cars)
    parameters = report.settings(scene, {})
    parameters |= {"data": str(data), "workers": settings.workers, "every": every, "seed": seed}
    screen.print(*map(str, page.claims))
    screen.detail(*page.defects, *page.failures)
    screen.write_text(out / "evaluation.md", paper_page.markdown(page))
    screen.write_text(out / "evaluation.json", report.to_json(paper_page.document(page, parameters)))
    screen.write_text(out / "evaluation.html", paper_page.html(page, pictures))
    screen.wrote(out / "kitti_results")


def _pictures(cars: Sequence[ExampleCar]) -> dict[str, str]:
    """The cars as SVG elements by caption; no photograph is there to be drawn on."""
    if not cars:
        return {}
    sights = []
    for one in cars:
        car = one.car
        truth = Truth(car.camera_T_object, car.size, car.shape)
        sights.append(SolvedVehicle(one.result, car.observation, one.camera, None, truth, f"{one.place}: {car.name}"))
    caption = (
        f"{len(cars)} of the cars of known shape, in the order of the error of their keypoints. Dots: people's marks, "
        "with a line to the estimate. Blue and vermilion: the estimated car's left and right. Green: the true box."
    )
    return {caption: svg_text(contact_sheet(sights, columns=3))}
