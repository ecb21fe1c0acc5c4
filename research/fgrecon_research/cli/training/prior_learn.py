"""`fgrecon prior learn`: a shape prior from 2D annotations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from fgrecon.cli.commands import option
from fgrecon.cli.options import FLEETS
from fgrecon.cli.terminal import Advance, Screen, Terminal
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import size_prior as parse_size
from fgrecon.io.catalogue import load_category, save_prior
from fgrecon.io.files import check_output
from fgrecon_research.io.annotations import load_annotations, spread
from fgrecon_research.training.priors.learn import LearntPrior, default_size, learn_prior
from fgrecon_research.training.priors.nrsfm import NrsfmOptions, NrsfmProgress, ProgressCallback


@dataclass(frozen=True)
class AnnotationOptions:
    """Which annotated images are learnt from."""

    images: int | None = option("Learn from so many images, spread over vehicles and views.", min=1)
    min_visible: int = option("Fewest annotated keypoints of an image that is used.", default=8, min=4)
    rename: list[str] | None = option(
        "A keypoint's name in the files and in the category; repeat for more.", metavar="THEIRS=OURS"
    )


@dataclass(frozen=True)
class Learning:
    """How the prior is learnt."""

    basis: int = option("Number of basis vectors.", default=5, min=0)
    perspective: bool = option(
        "Take perspective out of the annotations to first order.", "--perspective", default=False
    )
    restarts: int = option("Random starts; the best likelihood is kept.", default=3, min=1)
    seed: int = option("Seed of everything random.", default=0, min=0)
    proportions: float = option(
        "How far length, width and height of the mean go to those of the fleet.", default=0.75, min=0.0, max=1.0
    )
    bootstrap: int = option("Draws of the vehicles that tell how sure the mean is; 0 for none.", default=12, min=0)


def learn_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="Annotation files or folders: COCO .json, PASCAL3D+ .mat, .npz, or .csv (VeRi, 36 points).",
        ),
    ],
    annotations: AnnotationOptions,
    learning: Learning,
    terminal: Terminal,
    category: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Category: a shipped name or a JSON file.")
    ] = "car14",
    size_prior: Annotated[
        str | None,
        typer.Option(
            metavar="FLEET",
            help="Mean size: a fleet's name or length,width,height in metres.",
            show_default="apollo79 for cars",
            autocompletion=FLEETS,
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the prior.", show_default="the file's")] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The npz file to write.")] = Path("prior.npz"),
) -> None:
    """Learn a shape prior from images with annotated keypoints, each of another instance (NRSfM, Section III-A).

    --verbose shows the likelihood of each start, and what is left unexplained of each keypoint.
    """
    check_output(out)
    if out.suffix != ".npz":  # refused now rather than after minutes of learning
        raise InvalidInputError("out", str(out), "Give a file name that ends in .npz.")
    kind = load_category(category)
    size = default_size(kind) if size_prior is None else parse_size(size_prior)
    data = load_annotations(files, kind, _renames(annotations.rename or []))
    least = annotations.min_visible
    if annotations.images is not None:
        rng = np.random.default_rng(learning.seed)
        data = data.select(spread(data, annotations.images, rng, min_visible=least))
    how = {name: value for name, value in vars(learning).items() if name != "proportions"}
    screen, options = terminal.screen(), NrsfmOptions(min_visible=least, **how)
    with screen.bar() as advance:
        learnt = learn_prior(
            data,
            size=size,
            options=options,
            proportions=learning.proportions,
            name=name or out.stem,
            progress=_progress_callback(advance) if screen.bars else None,
        )
    save_prior(learnt.prior, out)
    _print_summary(screen, learnt, len(data))
    screen.wrote(out)


def _renames(values: list[str]) -> dict[str, str]:
    renames = {}
    for value in values:
        theirs, separator, ours = value.partition("=")
        if not (separator and theirs and ours):
            raise InvalidInputError("rename", value, "Give THEIRS=OURS, such as upper_left_windshield=left_front_roof.")
        renames[theirs] = ours
    return renames


def _progress_callback(advance: Advance) -> ProgressCallback:
    """Shows stage, likelihood and iteration, and how much of all the work is done in percent."""

    def update(step: NrsfmProgress) -> None:
        note = f"{step.stage}, iteration {step.iteration}: log likelihood {step.bound:+.4f} per keypoint"
        advance("Learning, percent", round(100 * step.fraction), 100, note)

    return update


def _print_summary(screen: Screen, learnt: LearntPrior, given: int) -> None:
    prior, nrsfm = learnt.prior, learnt.nrsfm
    box = ", ".join(f"{x:.2f}" for x in prior.box_size([0.0] * prior.dimension))
    ratio = ", ".join(f"{100 * (x - 1):+.1f}" for x in learnt.box)
    share = ", ".join(f"{100 * part:.1f}" for part in prior.explained)
    state = "converged" if nrsfm.converged else "stopped at the limit of iterations"
    residual = 100 * prior.offset_sigma
    bounds = ", ".join(f"{bound:+.4f}" for bound in nrsfm.restart_bounds)
    screen.print(
        f"{prior.name}: {prior.category.name}, {int(nrsfm.used.sum())} of {given} images, {state}",
        f"box of the mean: {box} m; length, width, height against the size prior: {ratio} %",
        f"variance explained: {share} %, together {100 * prior.explained.sum():.1f} %",
        f"left unexplained: {residual.min():.1f} to {residual.max():.1f} cm per keypoint and axis",
    )
    if prior.mean_sigma is not None:
        sure = 100 * prior.mean_sigma
        screen.print(f"the mean by other vehicles: {sure.min():.1f} to {sure.max():.1f} cm per keypoint and axis")
    screen.detail(f"log likelihood per keypoint at the end of each start: {bounds}")
    for keypoint, left in zip(prior.category.keypoints, residual, strict=True):
        screen.detail(f"left unexplained of {keypoint}: {left:.1f} cm")
