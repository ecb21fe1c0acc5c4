"""`fgrecon prior`: inspect shape priors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.commands import add_command, new_group
from fgrecon.cli.options import PriorArgument
from fgrecon.cli.terminal import Quiet, headed_table

app = new_group("prior", "Look at shape priors; make and compare them.", ("build", "compare", "learn"))


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

    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.files import check_output

    check_output(picture)
    check_output(save)
    loaded = load_prior(prior)
    screen = terminal.screen()
    for field, value in loaded.describe().items():
        screen.print(f"{field.replace('_', ' ')}: {value}")
    box = ", ".join(f"{x:.2f}" for x in loaded.box_size(np.zeros(loaded.dimension)))
    screen.print(f"length, width, height of the mean: {box} m")
    title = "Mean keypoints (m: forward, down, left), what the basis leaves unexplained, and the modes"
    sure = () if loaded.mean_sigma is None else ("mean ± cm (x, y, z)",)
    headings = ("keypoint", "x", "y", "z", *sure, "offset cm", *(f"mode {j + 1} cm" for j in range(loaded.dimension)))
    table = headed_table(*headings, title=title)
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


add_command(app, "show", show_command)
