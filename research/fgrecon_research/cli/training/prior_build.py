"""`fgrecon prior build` and `sizes`: the shipped shape priors and sizes of classes, made again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from fgrecon.cli.options import PRIORS, DrivesArgument, JsonOption, PriorArgument
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Quiet, Terminal, headed_table
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_category, load_prior, save_prior
from fgrecon.io.files import check_output, write_text
from fgrecon_research.annotation.class_sizes import class_file
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption
from fgrecon_research.paper.apollocar3d import read_apollocar3d
from fgrecon_research.training.priors import apollo79
from fgrecon_research.training.priors.apollo79 import Apollo79, LeaveOneOut
from fgrecon_research.training.priors.compare import PriorComparison, compare_priors
from fgrecon_research.training.priors.marked_points import SCHEME, PosedMarks, located_points, marked_prior


def sizes_command(
    drives: DrivesArgument,
    terminal: Terminal,
    labels: Annotated[Path, typer.Option(metavar="FOLDER", help="Label files of KITTI's object set (label_2).")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The JSON file to write.")] = Path("kitti.json"),
) -> None:
    """Measure sizes of cars, vans, lorries and trams by KITTI's labels, and count what the vehicle detector calls them.

    The drives are those with labels in which each vehicle is counted once. --verbose shows how often each
    class is among all labels.
    """
    screen = terminal.screen()
    check_output(out)
    content = class_file(labels, drives)
    for name, one in content["classes"].items():
        length, width, height = one["mean"]
        screen.print(f"{name}: {one['count']} labels, {length:.2f} x {width:.2f} x {height:.2f} m")
        screen.detail(f"{name}: {100.0 * one['share']:.1f} % of all")
    screen.wrote(write_text(out, json.dumps(content, indent=1) + "\n"))


_LOCATED = "car14"
_COUNTS = (0, 1, 2, 3, 5, 8, 10)


def build_command(
    terminal: Terminal,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The npz file to write.", show_default="CATEGORY.npz")
    ] = None,
    category: Annotated[
        str, typer.Option(help="Keypoints: car14, located on every model; apollo66, apollo24, pascal12: by marks.")
    ] = "car14",
    data: DataOption = DATA,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Hold out each model in turn and print how well it is expressed.")
    ] = False,
) -> None:
    """Make a shipped prior of keypoints and a surface from the 79 car models of ApolloCar3D.

    It makes the shipped file again, bit for bit. --verbose shows all that is known about it.
    """
    screen = terminal.screen()
    out = Path(f"{category}.npz") if out is None else out
    check_output(out)
    if leave_one_out and category != _LOCATED:
        raise InvalidInputError("leave-one-out", category, f"It is measured for {_LOCATED} alone; leave it out.")
    models = apollo79.load_apollo79(data)
    exact = apollo79.apollo79_prior(models) if category == _LOCATED else _of_marks(data, models, category)
    prior = apollo79.rounded(exact)
    screen.print(f"{prior.name}: {prior.provenance['source']}")
    screen.detail(*(f"{field}: {value}" for field, value in prior.provenance.items() if field != "source"))
    share = ", ".join(f"{100 * part:.1f}" for part in prior.explained)
    screen.print(f"variance explained: {share} %, together {100 * prior.explained.sum():.1f} %")
    if leave_one_out:
        with screen.bar() as advance:
            rows = apollo79.leave_one_out(models, _COUNTS, lambda done, total: advance("Models held out", done, total))
        screen.print(_leave_one_out_table(rows))
    screen.wrote(save_prior(prior, out))


def _of_marks(data: Path, models: Apollo79, category: str) -> ShapePrior:
    """The prior of keypoints that people marked in the images of ApolloCar3D."""
    kind = load_category(category)
    found = read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)
    cars = [PosedMarks(models.names.index(car.model), car.all_marks, car.camera_T_object) for car in found.cars]
    located = located_points(cars, found.camera, models, load_category(SCHEME))
    return marked_prior(located, models, kind)


def _leave_one_out_table(results: list[LeaveOneOut]) -> Table:
    headings = "vectors", "variance %", "keypoint RMS cm", "keypoint median cm", "vertex RMS cm"
    table = headed_table(*headings, left=0, title="Cars held out one by one, expressed by the others' first vectors")
    for row in results:
        lengths = (row.keypoint_rms, row.keypoint_median, row.vertex_rms)
        table.add_row(str(row.basis), f"{100 * row.explained:.1f}", *(f"{100 * length:.1f}" for length in lengths))
    return table


# `fgrecon prior compare`.


def compare_command(
    first: PriorArgument,
    second: Annotated[
        str, typer.Argument(metavar="NAME|FILE", help="The one to compare it with.", autocompletion=PRIORS)
    ],
    terminal: Quiet,
    json_out: JsonOption = None,
) -> None:
    """Compare two priors over the keypoints that both name, after the best similarity between their means."""
    check_outputs(json_out)
    a, b = load_prior(first), load_prior(second)
    result = compare_priors(a, b)
    screen = terminal.screen(json_out)
    title = f"Mean of {a.name}, scaled by {result.scale:.3f}, less mean of {b.name} (cm)"
    table = headed_table("keypoint", "forward", "down", "left", "distance", title=title)
    for name, difference, distance in zip(result.keypoints, result.differences, result.distances, strict=True):
        table.add_row(name, *(f"{100 * x:+.1f}" for x in difference), f"{100 * distance:.1f}")
    screen.print(table)
    screen.print(
        f"RMS over {len(result.keypoints)} keypoints: {100 * result.rms:.1f} cm, {result.percent:.2f} % of the length"
    )
    if len(result.angles):
        angles = ", ".join(f"{angle:.0f}" for angle in result.angles)
        shared = " and ".join(f"{100 * part:.0f} %" for part in result.shared_variance)
        screen.print(
            f"angles between the subspaces: {angles} degrees; variance that each shares with the other: {shared}"
        )
    screen.write_json(_document(a.name, b.name, result))


def _document(first: str, second: str, result: PriorComparison) -> str:
    """The comparison as JSON text; lengths in metres, angles in degrees."""
    content = {
        "format": "fgrecon.prior_comparison/1",
        "first": first,
        "second": second,
        "scale": result.scale,
        "rms": result.rms,
        "percent_of_length": result.percent,
        "keypoints": {
            name: {"difference": difference.tolist(), "distance": float(distance)}
            for name, difference, distance in zip(result.keypoints, result.differences, result.distances, strict=True)
        },
        "angles": [float(angle) for angle in result.angles],
        "shared_variance": [float(share) for share in result.shared_variance],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
