"""`fgrecon prior learn`: a shape prior from 2D annotations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import check_output

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from rich.console import Console

    from fgrecon.training.priors.learn import LearntPrior
    from fgrecon.training.priors.nrsfm import ProgressCallback

__all__ = ["learn_command"]


def learn_command(
    annotations: Annotated[
        list[Path],
        typer.Argument(
            help="Annotation files or folders: COCO .json, PASCAL3D+ .mat, .npz, or .csv (VeRi, 36 points)."
        ),
    ],
    category: Annotated[str, typer.Option(help="Category: a shipped name or a JSON file.")] = "car14",
    out: Annotated[Path, typer.Option(help="The npz file to write.")] = Path("prior.npz"),
    basis: Annotated[int, typer.Option(min=0, help="Number of basis vectors.")] = 5,
    images: Annotated[
        int | None, typer.Option(min=1, help="Learn from so many images, spread over vehicles and views.")
    ] = None,
    min_visible: Annotated[int, typer.Option(min=4, help="Fewest annotated keypoints of an image that is used.")] = 8,
    size_prior: Annotated[
        str | None,
        typer.Option(
            help="Mean size: a fleet's name or length,width,height in metres.", show_default="apollo79 for cars"
        ),
    ] = None,
    rename: Annotated[
        list[str] | None,
        typer.Option(
            metavar="THEIRS=OURS", help="A keypoint's name in the files and in the category; repeat for more."
        ),
    ] = None,
    symmetric: Annotated[bool, typer.Option(help="Impose left-right symmetry.")] = True,
    perspective: Annotated[
        bool, typer.Option("--perspective", help="Take perspective out of the annotations to first order.")
    ] = False,
    dof: Annotated[
        float, typer.Option(min=0.0, help="Degrees of freedom of Student's t noise; 0 means Gaussian noise.")
    ] = 2.0,
    plain: Annotated[
        bool, typer.Option("--plain", help="Maximise the plain likelihood instead of the restricted one.")
    ] = False,
    even_views: Annotated[
        bool, typer.Option(help="Let each view class count alike, where the files tell the views.")
    ] = True,
    restarts: Annotated[int, typer.Option(min=1, help="Random starts; the best likelihood is kept.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    name: Annotated[str | None, typer.Option(help="Name of the prior.", show_default="the file's")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress display.")] = False,
) -> None:
    """Learn a shape prior from images with annotated keypoints, each of another instance (NRSfM, Section III-A)."""
    import numpy as np

    from fgrecon.cli.common import console
    from fgrecon.core.errors import InvalidInputError
    from fgrecon.core.size_prior import size_prior as parse_size
    from fgrecon.io.annotations import load_annotations, spread
    from fgrecon.io.catalogue import load_category, save_prior
    from fgrecon.training.priors.learn import default_size, learn_prior
    from fgrecon.training.priors.nrsfm import NrsfmOptions

    check_output(out)
    if out.suffix != ".npz":  # refused now rather than after minutes of learning
        raise InvalidInputError("out", str(out), "Give a file name that ends in .npz.")
    kind = load_category(category)
    size = default_size(kind) if size_prior is None else parse_size(size_prior)
    data = load_annotations(annotations, kind, _renames(rename or []))
    if images is not None:
        data = data.select(spread(data, images, np.random.default_rng(seed), min_visible=min_visible))
    options = NrsfmOptions(
        basis=basis,
        symmetric=symmetric,
        perspective=perspective,
        dof=dof or None,
        restricted=not plain,
        min_visible=min_visible,
        restarts=restarts,
        seed=seed,
    )
    with _progress(show=not quiet) as progress:
        learnt = learn_prior(
            kind,
            data.keypoints,
            size=size,
            options=options,
            views=data.views if even_views else None,
            name=name or out.stem,
            provenance={"source": data.source},
            progress=progress,
        )
    save_prior(learnt.prior, out)
    _print_summary(console(error=False), out, learnt, len(data))


def _renames(values: list[str]) -> dict[str, str]:
    from fgrecon.core.errors import InvalidInputError

    renames = {}
    for value in values:
        theirs, separator, ours = value.partition("=")
        if not (separator and theirs and ours):
            raise InvalidInputError("rename", value, "Give THEIRS=OURS, such as upper_left_windshield=left_front_roof.")
        renames[theirs] = ours
    return renames


@contextmanager
def _progress(show: bool) -> Iterator[ProgressCallback | None]:
    """A bar with stage, likelihood, iteration and time left on the standard error stream, where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    terminal = Console(stderr=True)
    if not (show and terminal.is_terminal):
        yield None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("log likelihood {task.fields[bound]:+.4f} per keypoint, iteration {task.fields[iteration]}"),
        TimeRemainingColumn(),
    )
    from fgrecon.training.priors.nrsfm import NrsfmProgress

    with Progress(*columns, console=terminal, transient=True) as bar:
        task = bar.add_task("start", total=1.0, bound=float("nan"), iteration=0)

        def update(step: NrsfmProgress) -> None:
            bar.update(
                task, description=step.stage, completed=step.fraction, bound=step.bound, iteration=step.iteration
            )

        yield update


def _print_summary(console: Console, out: Path, learnt: LearntPrior, given: int) -> None:
    prior, nrsfm = learnt.prior, learnt.nrsfm
    box = ", ".join(f"{x:.2f}" for x in prior.box_size([0.0] * prior.dimension))
    ratio = ", ".join(f"{100 * (x - 1):+.1f}" for x in learnt.box)
    share = ", ".join(f"{100 * part:.1f}" for part in prior.explained)
    state = "converged" if nrsfm.converged else "stopped at the limit of iterations"
    console.print(f"{out}: {prior.category.name}, {int(nrsfm.used.sum())} of {given} images, {state}")
    console.print(f"box of the mean: {box} m; length, width, height against the size prior: {ratio} %")
    console.print(f"variance explained: {share} %, together {100 * prior.explained.sum():.1f} %")
    residual = 100 * prior.offset_sigma
    console.print(f"left unexplained: {residual.min():.1f} to {residual.max():.1f} cm per keypoint and axis")
