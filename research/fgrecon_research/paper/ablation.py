"""What each energy term and each robust strategy contributes, on simulated views of held-out cars.

Two priors are compared. The symmetric one makes symmetry, and the planarity of quads made of two mirrored pairs, hold
for every lambda: those terms vanish. The other stands for a prior learnt from few 2D annotations: nothing about it is
symmetric, its mean is biased, and free offsets let the wireframe leave it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.metrics import FAILURE_DEGREES, THRESHOLDS, orientation_error, orientation_precision
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.robust import StrategyName
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category
from fgrecon.simulation.vehicles import KITTI_CAMERA
from fgrecon.solve.pipeline import reconstruct
from fgrecon_research.evaluation.methods import NO_UPDATES, named_strategy
from fgrecon_research.paper.shape import SimulatedView, StageScore, score_shape
from fgrecon_research.training.priors.apollo79 import DUPLICATE, Apollo79
from fgrecon_research.training.priors.pca import SurfaceSamples, pca_prior

DEFAULT = "default"
"""Name of the settings that the others are compared with."""

BIAS = 0.08
"""Standard deviation in metres per axis of what the unsymmetrised prior gets wrong: every training shape, and all of
them alike."""

STRATEGIES = (*(name.value for name in StrategyName), NO_UPDATES)
"""The robust strategies by name."""


@dataclass(frozen=True)
class StrategyScore:
    """One robust strategy over all views."""

    mean: float  # mean orientation error, degrees; a failure counts as 180
    median: float  # median orientation error, degrees
    aop: tuple[float, ...]  # percent of the views within 5, 15 and 30 degrees
    keypoint: float  # median distance of a 3D keypoint in the object frame, metres
    translation: float  # median distance of the origin, metres


def unsymmetrised_prior(models: Apollo79, exclude: Sequence[str], basis: int = 5, seed: int = 0) -> ShapePrior:
    """A prior as one learnt from 2D annotations may be: biased, noisy and not symmetric (`BIAS`).

    Learnt from the keypoints as fixed points of the meshes, which are not symmetric. The spread of its free offsets
    covers the bias.

    Args:
        models: The models.
        exclude: Names of models not to learn from.
        basis: Number of basis vectors.
        seed: Of the bias.
    """
    keep = [i for i, name in enumerate(models.names) if name not in exclude and name != DUPLICATE[1]]
    rng = np.random.default_rng(seed)
    shapes = models.keypoints_mesh[keep]
    shapes = shapes + BIAS * rng.standard_normal(shapes.shape) + BIAS * rng.standard_normal(shapes.shape[1:])
    surface = SurfaceSamples(models.vertices[keep], models.faces)
    prior = pca_prior(
        load_category("car14"), shapes, basis=basis, symmetric=False, surface=surface, name="unsymmetrised"
    )
    return replace(prior, offset_sigma=np.hypot(prior.offset_sigma, BIAS))


def variants(options: Options) -> dict[str, Options]:
    """Settings by name: as they are, each term switched the other way, no free offsets, the Laplacian as printed."""
    disabled = options.disabled_terms
    switched = {
        f"with {term}" if term in disabled else f"without {term}": replace(options, disabled_terms=disabled ^ {term})
        for term in Options.TERMS
    }
    literal = replace(options, shape=replace(options.shape, literal_laplacian=True))
    return {
        DEFAULT: options,
        **switched,
        "without free offsets": replace(options, shape=replace(options.shape, free_offsets=False)),
        "with the Laplacian as printed": replace(literal, disabled_terms=disabled - {"laplacian"}),
    }


def ablate(
    views: Sequence[SimulatedView],
    prior: ShapePrior,
    options: Options,
    *,
    ground: Ground | None = None,
    size: SizePrior | None = None,
    advance: Callable[[str], None] = lambda _: None,
) -> dict[str, dict[str, StageScore]]:
    """Score every variant of the energy; see `fgrecon_research.paper.shape.score_shape`."""
    table = {}
    for name, setting in variants(options).items():
        table[name] = score_shape(views, prior, setting, ground=ground, size=size)
        advance(name)
    return table


def score_strategies(
    views: Sequence[SimulatedView],
    prior: ShapePrior,
    options: Options,
    *,
    ground: Ground | None = None,
    size: SizePrior | None = None,
    advance: Callable[[str], None] = lambda _: None,
) -> dict[str, StrategyScore]:
    """Pose and shape with each robust strategy."""
    scores = {}
    for name in STRATEGIES:
        setting = replace(options, strategy=named_strategy(name), keep_history=False)
        scores[name] = _score_strategy(views, prior, setting, ground, size)
        advance(name)
    return scores


def _score_strategy(
    views: Sequence[SimulatedView], prior: ShapePrior, options: Options, ground: Ground | None, size: SizePrior | None
) -> StrategyScore:
    turns, keypoints, translations = [], [], []
    for view in views:
        seen, truth = view.observation, view.truth
        try:
            result = reconstruct(
                seen.keypoints,
                KITTI_CAMERA,
                confidence=seen.confidence,
                box=seen.box,
                prior=prior,
                ground=ground,
                size_prior=size,
                options=options,
            )
        except FgreconError:
            turns.append(FAILURE_DEGREES)
            translations.append(np.inf)
            continue
        turns.append(float(orientation_error([result.rotation_y], [rotation_y(truth.camera_T_object)])[0]))
        keypoints.append(np.linalg.norm(result.wireframe - truth.vehicle.keypoints, axis=1))
        translations.append(float(np.linalg.norm(result.location - truth.camera_T_object[:3, 3])))
    errors = np.array(turns)
    return StrategyScore(
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        aop=tuple(100.0 * orientation_precision(errors, threshold) for threshold in THRESHOLDS),
        keypoint=float(np.median(np.concatenate(keypoints))),
        translation=float(np.median(translations)),
    )
