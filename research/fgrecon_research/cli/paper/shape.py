"""`fgrecon evaluate shape`: what the shape stage, each energy term and each robust strategy are worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
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
from fgrecon_research.evaluation.measures import THRESHOLDS
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.paper import shape
from fgrecon_research.paper.shape import DEFAULT, SimulatedView, StageScore, StrategyScore
from fgrecon_research.simulation import HARD
from fgrecon_research.training.priors.apollo79 import apollo79_prior, load_apollo79

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
    stages = shape.score_shape(screen.watch(simulated, "Views"), prior, ground=ground)
    document: dict[str, Any] = {
        "format": FORMAT,
        "units": _UNITS,
        "settings": {"held_out": list(names), "views_per_car": views, "views": len(simulated), "seed": seed},
        "stages": _plain(stages),
    }
    tables = [_stage_table(f"{len(simulated)} views of cars held out", stages)]
    if ablation:
        harder = shape.simulate_views(models, names, views, seed, HARD)
        loose = shape.unsymmetrised_prior(models, names, seed=seed)
        numbers, more = _ablated(simulated, harder, prior, loose, ground, screen)
        document |= numbers
        tables += more
    screen.print(*(table.shown() for table in tables))
    screen.write_document(document)
    screen.write_text(markdown, "\n".join(table.markdown() for table in tables))


def _ablated(
    views: Sequence[SimulatedView],
    harder: Sequence[SimulatedView],
    prior: ShapePrior,
    loose: ShapePrior,
    ground: Ground,
    screen: Screen,
) -> tuple[dict[str, Any], list[TextTable]]:
    """Numbers and tables of energies without each term, with two priors, and of robust strategies."""
    options = Options()
    known: dict[str, Any] = {"ground": ground, "size": SIZE_PRIORS["apollo79"]}
    energies, strategies = shape.variants(options), shape.strategies(options)
    with screen.bar(per_minute=True) as advance:
        tell = counting(advance, "Energies and strategies", 2 * len(energies) + len(strategies))

        def scored(settings: Mapping[str, Options], score: Callable[[Options], Any]) -> dict[str, Any]:
            found = {}
            for name, setting in settings.items():
                found[name] = score(setting)
                tell(name)
            return found

        symmetric = scored(energies, partial(shape.score_shape, views, prior, **known))
        unsymmetric = scored(energies, partial(shape.score_shape, views, loose, **known))
        robust = scored(strategies, partial(shape.score_strategy, harder, prior, **known))
    numbers = {
        "ablation": {name: _plain(row) for name, row in symmetric.items()},
        "ablation_unsymmetrised": {name: _plain(row) for name, row in unsymmetric.items()},
        "strategies": _plain(robust),
    }
    return numbers, [
        _ablation_table("Energy terms, symmetric prior", symmetric),
        _ablation_table("Energy terms, unsymmetrised prior", unsymmetric),
        _strategy_table("Robust strategies on harder keypoints", robust),
    ]


def _plain(rows: Mapping[str, Any]) -> dict[str, Any]:
    return {name: asdict(row) for name, row in rows.items()}


def _stage_table(title: str, stages: Mapping[str, StageScore]) -> TextTable:
    rows = []
    for name, score in stages.items():
        before = stages[_FIXED[0] if name.endswith("true pose") else _JOINT[0]]
        lengths = {"median": score.keypoint, "centred": score.centred, "RMS": score.keypoint_rms}
        rows.append(
            {"state": name}
            | {f"{what} cm": f"{100 * length:.2f}" for what, length in lengths.items()}
            | {"inliers px": f"{score.reprojection:.2f}", "orientation °": f"{score.orientation:.2f}"}
            | {"change of median %": f"{100 * (score.keypoint / before.keypoint - 1):+.1f}"}
        )
    return TextTable.of(rows, title=title)


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
    rows = [
        {"strategy": name, "mean °": f"{score.mean:.2f}", "median °": f"{score.median:.2f}"}
        | {f"AOP {most}° %": f"{share:.1f}" for most, share in zip(THRESHOLDS, score.aop, strict=True)}
        | {"keypoints cm": f"{100 * score.keypoint:.2f}", "origin m": f"{score.translation:.2f}"}
        for name, score in scores.items()
    ]
    return TextTable.of(rows, title=title)
