"""A shape prior from 2D annotations: NRSfM, then metres, ground and origin (Section III-A of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
from fgrecon_research.io.annotations.annotations import Annotations
from fgrecon_research.training.priors.canonical_frame import at_ground_level, levelled, metric_scale, metric_stretch
from fgrecon_research.training.priors.nrsfm import NrsfmOptions, NrsfmResult, ProgressCallback, fit_nrsfm

PROPORTIONS = 0.75
"""Share of the fleet's proportions in those of a learnt mean."""


@dataclass(frozen=True)
class LearntPrior:
    """A prior and how it was learnt."""

    prior: ShapePrior  # The prior, metric, in the object frame
    nrsfm: NrsfmResult  # The result of NRSfM that it was made from
    # (3,) length, width and height of the mean shape's box before the one common scale was chosen, each divided by the
    # fleet's: how well the learnt proportions agree with the size prior
    box: Array


def default_size(category: Category) -> SizePrior:
    """The size prior where none is given: that of the 79 car models for categories of cars.

    Raises:
        InvalidInputError: The category is not one of cars; 2D annotations cannot tell its size.
    """
    if category.name.startswith("car"):
        return SIZE_PRIORS["apollo79"]
    fix = f"Give the mean length,width,height of a {category.name} in metres: images alone do not tell its size."
    raise InvalidInputError("size_prior", "nothing", fix)


def learn_prior(
    annotations: Annotations,
    *,
    size: SizePrior | None = None,
    options: NrsfmOptions | None = None,
    proportions: float = PROPORTIONS,
    name: str = "nrsfm",
    progress: ProgressCallback | None = None,
) -> LearntPrior:
    """Learn a shape prior from annotated images, one instance each.

    Args:
        annotations: The keypoints. Where `views` are known, their classes count alike; where `vehicles` are,
            `mean_sigma` goes by vehicles.
        size: Mean size of the fleet, which sets the scale in metres; for cars that of the 79 car models by default.
        options: How to learn.
        proportions: Share of the way from the proportions that the images tell to those of the fleet, from 0 to 1.
        name: Name of the prior.
        progress: Called with the progress; it may raise to stop.

    Returns:
        The prior, and how it came about.

    Raises:
        InvalidInputError: Wrong shapes or values, or no size is known.
        DegenerateProblemError: The annotations do not determine a shape.
    """
    if not 0.0 <= proportions <= 1.0:
        raise InvalidInputError("proportions", proportions, "Give a share from 0 to 1.")
    options, category = options or NrsfmOptions(), annotations.category
    size = size or default_size(category)
    result = fit_nrsfm(
        *(category, annotations.keypoints, options),
        views=annotations.views,
        vehicles=annotations.vehicles,
        progress=progress,
    )
    noise = "Gaussian" if options.dof is None else f"Student's t with {options.dof:g} degrees of freedom"
    model = "perspective to first order" if options.perspective else "scaled orthography"
    symmetry = "symmetric" if options.symmetric and category.symmetric_pairs else "as they are"
    likelihood = "restricted" if options.restricted else "plain"
    how = {
        **({"source": annotations.source} if annotations.source else {}),
        "method": (
            f"NRSfM (EM-PPCA, {model}) of {int(result.used.sum())} images, {symmetry}, "
            f"noise {noise}, {likelihood} likelihood, seed {options.seed}"
        ),
        "scale": f"box of {size.name}: {', '.join(f'{x:g}' for x in size.mean)} m; its proportions to {proportions:g}",
    }
    return to_prior(category, result, size, proportions=proportions, name=name, provenance=how)


def to_prior(
    category: Category,
    result: NrsfmResult,
    size: SizePrior,
    *,
    proportions: float = PROPORTIONS,
    name: str = "nrsfm",
    provenance: Mapping[str, str] | None = None,
) -> LearntPrior:
    """The metric prior of an NRSfM result, its origin at ground level below the box's centre.

    `explained` is each vector's share of all variance in the data after the best camera of each image: that of the
    vectors and that of the residuals, which hold errors of annotation and projection beside those of shape.
    `offset_sigma` is each keypoint's residual in metres, mirrored keypoints alike.

    Args:
        size: Mean size of the fleet; how much each dimension counts for the common scale follows from its spread.
        proportions: Share of the way to the fleet's own proportions (`metric_stretch`).
        provenance: Plain strings about where it came from.

    Raises:
        DegenerateProblemError: A dimension of the learnt shape is not positive.
    """
    scale = metric_scale(category, result.mean, size)
    stretch = metric_stretch(category, result.mean, size, proportions)
    mean = at_ground_level(category, stretch * result.mean)
    basis = at_ground_level(category, levelled(category, mean, stretch * result.basis))
    others = [
        at_ground_level(category, metric_stretch(category, drawn, size, proportions) * drawn) for drawn in result.drawn
    ]
    strength = np.square(result.basis).sum(axis=(1, 2))
    explained = strength / (strength.sum() + 3.0 * np.square(result.residual_sigma).sum())
    variance = np.square(scale * result.residual_sigma)
    prior = ShapePrior(
        category=category,
        mean=mean,
        basis=basis,
        offset_sigma=np.sqrt(0.5 * (variance + variance[category.mirror])),
        explained=explained,
        name=name,
        provenance=dict(provenance or {}),
        mean_sigma=np.std(others, axis=0, ddof=1) if others else None,
    )
    box = np.tensordot(category.dimension_operator, result.mean, axes=2)
    return LearntPrior(prior, result, scale * box / size.mean)
