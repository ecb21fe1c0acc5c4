"""`fgrecon prior`: look at shape priors and compare them. Those that make them are in `fgrecon.cli.training`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output

__all__ = ["app"]

app = typer.Typer(help="Make shape priors, look at them and compare them.", no_args_is_help=True)


@app.command("show")
def show_command(
    prior: Annotated[str, typer.Argument(help="Shape prior: a shipped name or an npz file.")],
    out: Annotated[Path | None, typer.Option(help="Picture to write: .png, .jpg, .svg or .pdf.")] = None,
    rrd: Annotated[Path | None, typer.Option(help="Recording for rerun in which each mode moves.")] = None,
    modes: Annotated[
        int | None, typer.Option(min=0, help="How many modes to draw.", show_default="all of them")
    ] = None,
) -> None:
    """Print what a prior holds; draw its mean and each mode at -2 and +2 sigma from three views."""
    import numpy as np
    from rich.table import Table

    from fgrecon.cli.common import console
    from fgrecon.io.catalogue import load_prior

    for path in (out, rrd):
        if path is not None:
            check_output(path)
    loaded = load_prior(prior)
    screen = console(error=False)
    for field, value in loaded.describe().items():
        screen.print(f"{field}: {value}", markup=False)
    box = ", ".join(f"{x:.2f}" for x in loaded.box_size(np.zeros(loaded.dimension)))
    screen.print(f"length, width, height of the mean: {box} m")
    table = Table(title="Mean keypoints (m: forward, down, left), what the basis leaves unexplained, and the modes")
    headings = ("keypoint", "x", "y", "z", "offset cm", *(f"mode {j + 1} cm" for j in range(loaded.dimension)))
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "keypoint" else "right")
    moves = 100 * np.linalg.norm(loaded.basis, axis=2)
    for k, keypoint in enumerate(loaded.category.keypoints):
        numbers = (f"{x:.3f}" for x in loaded.mean[k])
        table.add_row(keypoint, *numbers, f"{100 * loaded.offset_sigma[k]:.1f}", *(f"{x:.1f}" for x in moves[:, k]))
    table.add_row("variance", "", "", "", "", *(f"{100 * x:.1f} %" for x in loaded.explained))
    screen.print(table)
    if out is not None:
        from fgrecon.viz import save_picture
        from fgrecon.viz.prior_picture import prior_picture

        save_picture(out, prior_picture(loaded, modes))
        screen.print(f"picture: {out}")
    if rrd is not None:
        from fgrecon.viz.prior_recording import record_prior

        record_prior(rrd, loaded)
        screen.print(f"recording: {rrd}")


@app.command("compare")
def compare_command(
    first: Annotated[str, typer.Argument(help="Shape prior: a shipped name or an npz file.")],
    second: Annotated[str, typer.Argument(help="The one to compare it with.")],
) -> None:
    """Compare two priors over the keypoints that both name, after the best similarity between their means."""
    from rich.table import Table

    from fgrecon.cli.common import console
    from fgrecon.io.catalogue import load_prior
    from fgrecon.training.priors.compare import compare_priors

    a, b = load_prior(first), load_prior(second)
    result = compare_priors(a, b)
    screen = console(error=False)
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
