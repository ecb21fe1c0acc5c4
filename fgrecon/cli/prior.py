"""`fgrecon prior`: look at shape priors and compare them. Those that make them are in `fgrecon.cli.training`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.commands import add_command
from fgrecon.cli.common import check_output, check_outputs
from fgrecon.cli.options import PRIORS, JsonOption, PriorArgument
from fgrecon.cli.terminal import Quiet

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.training.priors.compare import PriorComparison

__all__ = ["app"]

app = typer.Typer(help="Make shape priors, look at them and compare them.", no_args_is_help=True)


def show_command(
    prior: PriorArgument,
    terminal: Quiet,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw mean and modes: .png, .jpg, .svg or .pdf.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Record for the rerun viewer how each mode moves.")
    ] = None,
    modes: Annotated[
        int | None, typer.Option(min=0, help="How many modes to draw.", show_default="all of them")
    ] = None,
) -> None:
    """Print what a prior holds; draw its mean and each mode at -2 and +2 sigma from three views."""
    import numpy as np
    from rich.table import Table

    from fgrecon.io.catalogue import load_prior

    check_output(picture)
    check_output(save)
    loaded = load_prior(prior)
    screen = terminal.screen()
    for field, value in loaded.describe().items():
        screen.print(f"{field.replace('_', ' ')}: {value}")
    box = ", ".join(f"{x:.2f}" for x in loaded.box_size(np.zeros(loaded.dimension)))
    screen.print(f"length, width, height of the mean: {box} m")
    table = Table(title="Mean keypoints (m: forward, down, left), what the basis leaves unexplained, and the modes")
    sure = () if loaded.mean_sigma is None else ("mean ± cm (x, y, z)",)
    headings = ("keypoint", "x", "y", "z", *sure, "offset cm", *(f"mode {j + 1} cm" for j in range(loaded.dimension)))
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "keypoint" else "right")
    moves = 100 * np.linalg.norm(loaded.basis, axis=2)
    for k, keypoint in enumerate(loaded.category.keypoints):
        numbers = [f"{x:.3f}" for x in loaded.mean[k]]
        if loaded.mean_sigma is not None:
            numbers.append(", ".join(f"{100 * x:.1f}" for x in loaded.mean_sigma[k]))
        table.add_row(keypoint, *numbers, f"{100 * loaded.offset_sigma[k]:.1f}", *(f"{x:.1f}" for x in moves[:, k]))
    table.add_row("variance", "", "", "", *("" for _ in sure), "", *(f"{100 * x:.1f} %" for x in loaded.explained))
    screen.print(table)
    if picture is not None:
        from fgrecon.viz import save_picture
        from fgrecon.viz.prior_picture import prior_picture

        screen.wrote(save_picture(picture, prior_picture(loaded, modes)))
    if save is not None:
        from fgrecon.viz.prior_recording import record_prior

        record_prior(save, loaded)
        screen.wrote(save)


def compare_command(
    first: PriorArgument,
    second: Annotated[
        str, typer.Argument(metavar="NAME|FILE", help="The one to compare it with.", autocompletion=PRIORS)
    ],
    terminal: Quiet,
    json_out: JsonOption = None,
) -> None:
    """Compare two priors over the keypoints that both name, after the best similarity between their means."""
    from rich.table import Table

    from fgrecon.io.catalogue import load_prior
    from fgrecon.training.priors.compare import compare_priors

    check_outputs(json_out)
    a, b = load_prior(first), load_prior(second)
    result = compare_priors(a, b)
    screen = terminal.screen(json_out)
    table = Table(title=f"Mean of {a.name}, scaled by {result.scale:.3f}, less mean of {b.name} (cm)")
    for heading in ("keypoint", "forward", "down", "left", "distance"):
        table.add_column(heading, justify="left" if heading == "keypoint" else "right")
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


add_command(app, "show", show_command, renamed={"--out": "--picture", "--rrd": "--save"})
add_command(app, "compare", compare_command)
