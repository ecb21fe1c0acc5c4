"""`fgrecon prior build`: the default shape prior, made again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # the command line must start fast: what a command needs is imported when it runs
    from rich.console import Console

    from fgrecon.training.priors.apollo79 import LeaveOneOut

__all__ = ["build_command"]

_COUNTS = (0, 1, 2, 3, 5, 8, 10)


def build_command(
    out: Annotated[Path, typer.Argument(help="The npz file to write.")] = Path("car14.npz"),
    data: Annotated[
        Path,
        typer.Option(envvar="FGRECON_DATA", help="Folder with apollo79/apollo79_car14.npz, or that file."),
    ] = Path("../shared/data"),
    basis: Annotated[int, typer.Option(min=1, help="Number of basis vectors.")] = 5,
    exclude: Annotated[
        list[str] | None, typer.Option(help="Name of a model to leave out; give it again for more.")
    ] = None,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Hold out each model in turn and print how well it is expressed.")
    ] = False,
) -> None:
    """Make the default prior of 14 keypoints and a surface from the 79 car models of ApolloCar3D.

    Without options it makes the shipped file again, bit for bit.
    """
    from rich.console import Console

    from fgrecon.io.catalogue import save_prior
    from fgrecon.training.priors import apollo79

    models = apollo79.load_apollo79(data)
    prior = apollo79.rounded(apollo79.apollo79_prior(models, basis, exclude or ()))
    save_prior(prior, out)
    console = Console(highlight=False, soft_wrap=True)
    share = ", ".join(f"{100 * part:.1f}" for part in prior.explained)
    console.print(f"{out}: {prior.provenance['source']}")
    console.print(f"variance explained: {share} %, together {100 * prior.explained.sum():.1f} %")
    if leave_one_out:
        _print_leave_one_out(console, apollo79.leave_one_out(models, _COUNTS))


def _print_leave_one_out(console: Console, results: list[LeaveOneOut]) -> None:
    from rich.table import Table

    table = Table(title="Cars held out one by one, expressed by the others' first vectors")
    for heading in ("vectors", "variance %", "keypoint RMS cm", "keypoint median cm", "vertex RMS cm"):
        table.add_column(heading, justify="right")
    for row in results:
        lengths = (row.keypoint_rms, row.keypoint_median, row.vertex_rms)
        table.add_row(str(row.basis), f"{100 * row.explained:.1f}", *(f"{100 * length:.1f}" for length in lengths))
    console.print(table)
