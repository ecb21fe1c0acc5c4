"""`fgrecon evaluate shape`: what the shape stage, each energy term and each robust strategy are worth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
import typer

from fgrecon.cli.options import KITTI_CAMERA_HEIGHT, JsonOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Screen, Terminal, counting
from fgrecon.core.camera import Ground
from fgrecon.core.options import Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption, MarkdownOption
from fgrecon_research.evaluation.bootstrap import mean_interval
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.paper import shape
from fgrecon_research.paper.shape import DEFAULT, SimulatedView, StageScore, StrategyScore
from fgrecon_research.simulation import HARD
from fgrecon_research.training.priors.apollo79 import Apollo79, apollo79_prior, load_apollo79

FORMAT = "fgrecon_research.evaluation.shape/1"
_UNITS = {
    "keypoint": "metres, median distance of a 3D keypoint in the object frame",
    "centred": "metres, the same about the centroids",
    "keypoint_rms": "metres, root mean square",
    "reprojection": "pixels, median over visible keypoints measured in the right place",
    "orientation": "degrees, median",
}
_FIXED, _JOINT = ("mean, true pose", "shape, true pose"), ("mean, estimated pose", "joint")


def shape_command(
    terminal: Terminal,
    data: DataOption = DATA,
    cars: Annotated[int, typer.Option(min=1, help="Number of models to hold out.")] = 20,
    views: Annotated[int, typer.Option(min=1, help="Views of each car.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Of the cars held out, the poses and the noise.")] = 0,
    ablation: Annotated[
        bool, typer.Option("--ablation/--no-ablation", help="Also switch off each energy term; compare strategies.")
    ] = True,
    json_out: JsonOption = None,
    markdown: MarkdownOption = None,
) -> None:
    """Score 3D keypoints before and after the shape stage on simulated views of cars held out from the prior.

    Real car models, poses like KITTI's, and the mistakes of a real keypoint network. The level camera's height is known
    and the prior's own sizes are used, except that the ablation adds the fleet's as well. --verbose names the cars.
    """
    check_outputs(json_out, markdown)
    screen = terminal.screen(json_out)
    ground = Ground.level(KITTI_CAMERA_HEIGHT)
    models = load_apollo79(data)
    names = shape.held_out(models, cars, seed)
    prior = apollo79_prior(models, exclude=names)
    simulated = shape.simulate_views(models, names, views, seed)
    screen.detail(f"held out: {', '.join(names)}")
    with screen.bar() as advance:
        tell = counting(advance, "Views", len(simulated))
        stages = shape.score_shape(simulated, prior, ground=ground, advance=lambda: tell(""))
    document: dict[str, Any] = {
        "format": FORMAT,
        "units": _UNITS,
        "settings": {"held_out": list(names), "views_per_car": views, "views": len(simulated), "seed": seed},
        "stages": _plain(stages),
    }
    tables = [_stage_table(f"{len(simulated)} views of cars held out", stages)]
    if ablation:
        harder = shape.simulate_views(models, names, views, seed, HARD)
        numbers, more = _ablated(models, names, prior, simulated, harder, seed, ground, screen)
        document |= numbers
        tables += more
    screen.print(*(table.shown() for table in tables))
    screen.write_json(json.dumps(document, indent=2, allow_nan=False) + "\n")
    screen.write_text(markdown, "\n".join(table.markdown() for table in tables))


def _ablated(
    models: Apollo79,
    names: Sequence[str],
    prior: ShapePrior,
    views: Sequence[SimulatedView],
    harder: Sequence[SimulatedView],
    seed: int,
    ground: Ground,
    screen: Screen,
) -> tuple[dict[str, Any], list[TextTable]]:
    """Numbers and tables of energies without each term, with two priors, and of robust strategies."""
    size, options = SIZE_PRIORS["apollo79"], Options()
    total = 2 * len(shape.variants(options)) + len(shape.STRATEGIES)
    with screen.bar(per_minute=True) as advance:
        tell = counting(advance, "Energies and strategies", total)
        symmetric = shape.ablate(views, prior, options, ground=ground, size=size, advance=tell)
        loose_prior = shape.unsymmetrised_prior(models, names, seed=seed)
        loose = shape.ablate(views, loose_prior, options, ground=ground, size=size, advance=tell)
        strategies = shape.score_strategies(harder, prior, options, ground=ground, size=size, advance=tell)
    numbers = {
        "ablation": {name: _plain(row) for name, row in symmetric.items()},
        "ablation_unsymmetrised": {name: _plain(row) for name, row in loose.items()},
        "strategies": _plain(strategies),
    }
    return numbers, [
        _ablation_table("Energy terms, symmetric prior", symmetric),
        _ablation_table("Energy terms, unsymmetrised prior", loose),
        _strategy_table("Robust strategies on harder keypoints", strategies),
    ]


def _plain(rows: Mapping[str, Any]) -> dict[str, Any]:
    return {name: asdict(row) for name, row in rows.items()}


def _stage_table(title: str, stages: Mapping[str, StageScore]) -> TextTable:
    heads = ["state", "median cm", "centred cm", "RMS cm", "inliers px", "orientation °", "change of median %"]
    rows = []
    for name, score in stages.items():
        before = stages[_FIXED[0] if name.endswith("true pose") else _JOINT[0]]
        rows.append([name, *_numbers(score), f"{100 * (score.keypoint / before.keypoint - 1):+.1f}"])
    return TextTable(heads, rows, title=title)


def _numbers(score: StageScore) -> list[str]:
    lengths = (score.keypoint, score.centred, score.keypoint_rms)
    return [*(f"{100 * length:.2f}" for length in lengths), f"{score.reprojection:.2f}", f"{score.orientation:.2f}"]


def _ablation_table(title: str, variants: Mapping[str, Mapping[str, StageScore]]) -> TextTable:
    """Errors with every variant, and what it costs in mean square against the default, with the 95 % interval."""
    costs = "cost cm² (95 %)"
    heads = ["energy", "true pose cm", "RMS cm", costs, "joint cm", "RMS cm", costs, "joint inliers px"]
    rows, whole = [], variants[DEFAULT]
    for name, stages in variants.items():
        cells = [name]
        for stage in (_FIXED[1], _JOINT[1]):
            score = stages[stage]
            cost = mean_interval(1e4 * np.subtract(score.squares, whole[stage].squares))
            cells += [f"{100 * score.keypoint:.2f}", f"{100 * score.keypoint_rms:.2f}"]
            cells.append("-" if name == DEFAULT else f"{cost.value:+.1f} ({cost.low:+.1f}, {cost.high:+.1f})")
        rows.append([*cells, f"{stages[_JOINT[1]].reprojection:.2f}"])
    return TextTable(heads, rows, title=title)


def _strategy_table(title: str, scores: Mapping[str, StrategyScore]) -> TextTable:
    heads = ["strategy", "mean °", "median °", "AOP 5° %", "AOP 15° %", "AOP 30° %", "keypoints cm", "origin m"]
    rows = []
    for name, score in scores.items():
        errors = [f"{score.mean:.2f}", f"{score.median:.2f}", *(f"{share:.1f}" for share in score.aop)]
        rows.append([name, *errors, f"{100 * score.keypoint:.2f}", f"{score.translation:.2f}"])
    return TextTable(heads, rows, title=title)
