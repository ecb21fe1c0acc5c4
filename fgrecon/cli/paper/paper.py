"""`fgrecon evaluate paper`: every table of the paper by one command."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import PriorOption, console

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from collections.abc import Callable, Iterator

__all__ = ["paper_command"]

_KITTI_CAMERA_HEIGHT = 1.65


def paper_command(
    out: Annotated[Path, typer.Option(help="Folder for tables, page, result files and stored parts.")] = Path(
        "evaluation"
    ),
    data: Annotated[Path, typer.Option(envvar="FGRECON_DATA", help="Folder of the data.")] = Path("../shared/data"),
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; results do not depend on it.", show_default="one a core")
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, help="Work on every so many-th part of the simulated set, for a first look.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    prior: PriorOption = "car14",
    size_prior: Annotated[
        str, typer.Option(help="Size of the fleet: kitti, apollo79 or length,width,height in m.")
    ] = "kitti",
    camera_height: Annotated[
        float, typer.Option(help="Height of a level camera above the ground, m (for the rows that are told it).")
    ] = _KITTI_CAMERA_HEIGHT,
    fresh: Annotated[bool, typer.Option("--fresh", help="Work on everything again; keep no stored part.")] = False,
    progress: Annotated[
        bool | None, typer.Option("--progress/--no-progress", help="Progress bar.", show_default="on a terminal")
    ] = None,
) -> None:
    """Make every table of the paper: real tracks, real images, simulated validation set, cars of known shape.

    Writes evaluation.md, evaluation.json, evaluation.html and KITTI result files. A run that was interrupted goes on
    where it stopped. Stored parts know the data and settings that they were made from, but not unreleased changes of
    the code: use --fresh after those. Nothing is recorded for the viewer, these are thousands of cars: see
    `fgrecon evaluate tracks --save`.
    """
    import shutil

    from fgrecon.core.camera import Ground
    from fgrecon.core.size_prior import size_prior as parse_size
    from fgrecon.evaluation import report
    from fgrecon.evaluation.methods import SceneKnowledge
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.files import write_text
    from fgrecon.paper import page as paper_page
    from fgrecon.paper.run import EvaluationSettings, evaluate_paper

    scene = SceneKnowledge(load_prior(prior), Ground.level(camera_height), parse_size(size_prior))
    out.mkdir(parents=True, exist_ok=True)
    if fresh:
        shutil.rmtree(out / "parts", ignore_errors=True)
    settings = EvaluationSettings(data, out, scene, workers or os.cpu_count() or 1, every, seed)
    with _bar(shown=sys.stderr.isatty() if progress is None else progress) as advance:
        page = evaluate_paper(settings, advance)
    told = {**report.settings(scene, {}), "data": str(data), "workers": settings.workers, "every": every, "seed": seed}
    files = {
        "evaluation.md": paper_page.markdown(page),
        "evaluation.json": report.to_json(paper_page.document(page, told)),
        "evaluation.html": paper_page.html(page),
    }
    for name, text in files.items():
        write_text(out / name, text)
    screen = console(error=False)
    for claim in page.claims:
        screen.print(claim, markup=False)
    screen.print(f"{', '.join(str(out / name) for name in files)}", markup=False)


@contextlib.contextmanager
def _bar(*, shown: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar a step on the error stream, or nothing."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=Console(stderr=True), disable=not shown) as progress:

        def advance(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = progress.add_task(step, total=total)
            progress.update(tasks[step], completed=done)

        yield advance
