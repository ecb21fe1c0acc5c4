"""`fgrecon prior compare`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.options import PRIORS, JsonOption, PriorArgument
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Quiet

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon_research.training.priors.compare import PriorComparison


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
    from fgrecon_research.training.priors.compare import compare_priors

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
