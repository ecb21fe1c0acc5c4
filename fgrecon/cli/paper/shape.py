"""`fgrecon evaluate shape`: what the shape stage, each energy term and each robust strategy are worth."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.common import JsonOption, check_outputs, console, write_json

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.paper.ablation import StrategyScore
    from fgrecon.paper.shape import StageScore

__all__ = ["shape_command"]

FORMAT = "fgrecon.evaluation.shape/1"
_UNITS = {
    "keypoint": "metres, median distance of a 3D keypoint in the object frame",
    "centred": "metres, the same about the centroids",
    "keypoint_rms": "metres, root mean square",
    "reprojection": "pixels, median over visible keypoints measured in the right place",
    "orientation": "degrees, median",
}
_FIXED, _JOINT = ("mean, true pose", "shape, true pose"), ("mean, estimated pose", "joint")
_CAMERA_HEIGHT = 1.65  # of the simulated views

Table = list[list[str]]


def shape_command(
    data: Annotated[
        Path, typer.Option(envvar="FGRECON_DATA", help="Folder with apollo79/apollo79_car14.npz, or that file.")
    ] = Path("../shared/data"),
    cars: Annotated[int, typer.Option(min=1, help="Number of models to hold out.")] = 20,
    views: Annotated[int, typer.Option(min=1, help="Views of each car.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Of the cars held out, the poses and the noise.")] = 0,
    tables: Annotated[
        bool, typer.Option("--ablation/--no-ablation", help="Also switch off each energy term; compare strategies.")
    ] = True,
    json_out: JsonOption = None,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Write the tables as Markdown.")] = None,
) -> None:
    """Score 3D keypoints before and after the shape stage on simulated views of cars held out from the prior.

    Real car models, poses like KITTI's, and the mistakes of a real keypoint network. The level camera's height is known
    and the prior's own sizes are used, except that the ablation adds the fleet's as well.
    """
    import json

    from fgrecon.core.options import Options, ShapeOptions
    from fgrecon.core.size_prior import SIZE_PRIORS
    from fgrecon.io.files import write_text
    from fgrecon.paper import ablation, shape
    from fgrecon.simulation.keypoint_noise import HARD
    from fgrecon.training.priors.apollo79 import apollo79_prior, load_apollo79

    check_outputs(json_out, markdown_out)
    from fgrecon.core.camera import Ground

    ground = Ground.level(_CAMERA_HEIGHT)
    models = load_apollo79(data)
    names = shape.held_out(models, cars, seed)
    prior = apollo79_prior(models, exclude=names)
    seen = shape.simulate_views(models, names, views, seed)
    stages = shape.score_shape(seen, prior, ground=ground)
    document: dict[str, Any] = {
        "format": FORMAT,
        "units": _UNITS,
        "settings": {"held_out": list(names), "views_per_car": views, "views": len(seen), "seed": seed},
        "stages": _plain(stages),
    }
    parts: list[tuple[str, Table]] = [(f"{len(seen)} views of cars held out", _stage_table(stages))]
    if tables:
        tell = _progress()
        size = SIZE_PRIORS["apollo79"]
        symmetric = ablation.ablate(seen, prior, Options(), ground=ground, size=size, advance=tell)
        loose_prior = ablation.unsymmetrised_prior(models, names, seed=seed)
        free = Options(shape=ShapeOptions(free_offsets=True))
        loose = ablation.ablate(seen, loose_prior, free, ground=ground, size=size, advance=tell)
        hard = shape.simulate_views(models, names, views, seed, HARD)
        strategies = ablation.score_strategies(hard, prior, Options(), ground=ground, size=size, advance=tell)
        document |= {
            "ablation": {name: _plain(row) for name, row in symmetric.items()},
            "ablation_unsymmetrised": {name: _plain(row) for name, row in loose.items()},
            "strategies": _plain(strategies),
        }
        parts += [
            ("Energy terms, symmetric prior", _ablation_table(symmetric)),
            ("Energy terms, unsymmetrised prior with free offsets", _ablation_table(loose)),
            ("Robust strategies on harder keypoints", _strategy_table(strategies)),
        ]
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    _print(parts, error=json_out == "-")
    write_json(json_out, text)
    if markdown_out is not None:
        write_text(markdown_out, "\n".join(_markdown(title, rows) for title, rows in parts))


def _progress() -> Callable[[str], None]:
    if not sys.stderr.isatty():
        return lambda _: None
    return lambda name: typer.echo(f"  {name}", err=True)


def _plain(rows: Mapping[str, Any]) -> dict[str, Any]:
    return {name: asdict(row) for name, row in rows.items()}


def _stage_table(stages: Mapping[str, StageScore]) -> Table:
    rows = [["state", "median cm", "centred cm", "RMS cm", "inliers px", "orientation °", "change of median %"]]
    for name, score in stages.items():
        before = stages[_FIXED[0] if name.endswith("true pose") else _JOINT[0]]
        rows.append([name, *_numbers(score), f"{100 * (score.keypoint / before.keypoint - 1):+.1f}"])
    return rows


def _numbers(score: StageScore) -> list[str]:
    lengths = (score.keypoint, score.centred, score.keypoint_rms)
    return [*(f"{100 * length:.2f}" for length in lengths), f"{score.reprojection:.2f}", f"{score.orientation:.2f}"]


def _ablation_table(rows: Mapping[str, Mapping[str, StageScore]]) -> Table:
    """Errors with every variant, and what it costs against all terms."""
    table = [["energy", "true pose cm", "%", "RMS cm", "joint cm", "%", "RMS cm", "joint inliers px"]]
    whole = rows["all terms"]
    for name, stages in rows.items():
        cells = [name]
        for stage in (_FIXED[1], _JOINT[1]):
            score = stages[stage]
            cells += [f"{100 * score.keypoint:.2f}", f"{100 * (score.keypoint / whole[stage].keypoint - 1):+.1f}"]
            cells.append(f"{100 * score.keypoint_rms:.2f}")
        table.append([*cells, f"{stages[_JOINT[1]].reprojection:.2f}"])
    return table


def _strategy_table(rows: Mapping[str, StrategyScore]) -> Table:
    table = [["strategy", "mean °", "median °", "AOP 5° %", "AOP 15° %", "AOP 30° %", "keypoints cm", "origin m"]]
    for name, score in rows.items():
        errors = [f"{score.mean:.2f}", f"{score.median:.2f}", *(f"{share:.1f}" for share in score.aop)]
        table.append([name, *errors, f"{100 * score.keypoint:.2f}", f"{score.translation:.2f}"])
    return table


def _print(parts: Sequence[tuple[str, Table]], *, error: bool) -> None:
    from rich.table import Table as RichTable

    shown = console(error=error)
    for title, rows in parts:
        table = RichTable(title=title)
        for i, heading in enumerate(rows[0]):
            table.add_column(heading, justify="right" if i else "left", no_wrap=True)
        for row in rows[1:]:
            table.add_row(*row)
        shown.print(table)


def _markdown(title: str, rows: Table) -> str:
    lines = [f"**{title}**", "", f"| {' | '.join(rows[0])} |", f"|---{'|---:' * (len(rows[0]) - 1)}|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows[1:])]) + "\n"
