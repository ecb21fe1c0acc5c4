"""Gain of the shape stage in 3D keypoints: simulated views of real car models held out from the prior.

Twenty car models are held out, the prior is learnt again from the others, and each car is seen from poses like KITTI's
with the mistakes of a real keypoint network (`fgrecon.simulation.keypoint_noise`). Errors are distances in the object
frame, where the pose plays no part; reprojection errors count keypoints that are visible and measured in the right
place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.metrics import FAILURE_DEGREES, orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.robust import StrategyName
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
from fgrecon.simulation.vehicles import KITTI_CAMERA, SimulatedTruth, Vehicle
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import VehicleModel, prepare
from fgrecon_research.evaluation.measures import THRESHOLDS, orientation_precision
from fgrecon_research.evaluation.methods import NO_UPDATES, named_strategy
from fgrecon_research.simulation import simulate_many
from fgrecon_research.training.priors.apollo79 import DUPLICATE, Apollo79
from fgrecon_research.training.priors.pca import SurfaceSamples, pca_prior

STAGES = ("mean, true pose", "shape, true pose", "mean, estimated pose", "pose stage", "shape, pose fixed", "joint")
"""States that are scored.

The mean shape is the state before either variant: at the true pose, and at the pose stage's. The pose stage has
coefficients of its own, from which the shape stage starts when the pose is estimated.
"""

SimulatedView = tuple[Observation, SimulatedTruth]
"""What is observed, and the truth behind it."""


@dataclass(frozen=True)
class StageScore:
    """Errors of one state over all views."""

    keypoint: float  # median distance of a 3D keypoint from the truth in the object frame, metres
    centred: float  # the same after moving both centroids together, so that shape alone counts, metres
    keypoint_rms: float  # root mean square of the distances, metres
    reprojection: float  # median reprojection error of the inliers, pixels
    orientation: float  # median orientation error, degrees
    squares: tuple[float, ...]  # mean squared distance of the 3D keypoints of each view, square metres


def held_out(models: Apollo79, count: int = 20, seed: int = 0) -> tuple[str, ...]:
    """Names of models to hold out: the car that has two names goes out with both or with neither.

    Raises:
        InvalidInputError: There are not so many models.
    """
    if not 1 <= count < len(models.names):
        raise InvalidInputError("count", count, f"Give a number from 1 to {len(models.names) - 1}.")
    chosen: list[str] = []
    for name in np.random.default_rng(seed).permutation(np.array(models.names)).tolist():
        twins = [name] if name not in DUPLICATE else [other for other in DUPLICATE if other in models.names]
        if name not in chosen and len(chosen) + len(twins) <= count:
            chosen.extend(twins)
    return tuple(sorted(chosen))


def simulate_views(
    models: Apollo79, names: Sequence[str], per_car: int, seed: int = 0, noise: NoiseModel = HOURGLASS
) -> list[SimulatedView]:
    """Views of car models by KITTI's camera, each car equally often; a car with two names counts once.

    Raises:
        InvalidInputError: A name is unknown, or no view of a car lies within the image.
    """
    category = load_category("car14")
    rng = np.random.default_rng(seed)
    views: list[SimulatedView] = []
    for i in models.index([name for name in names if name != DUPLICATE[1] or DUPLICATE[0] not in names]):
        vehicle = Vehicle(category, models.keypoints[i], models.vertices[i], models.faces)
        views += simulate_many([vehicle], per_car, rng, noise)
    return views


def score_shape(
    views: Iterable[SimulatedView],
    prior: ShapePrior,
    options: Options | None = None,
    *,
    ground: Ground | None = None,
    size: SizePrior | None = None,
) -> dict[str, StageScore]:
    """Errors before and after the shape stage, with the pose fixed at the truth, fixed at its estimate, and free.

    Returns:
        A score for each of `STAGES`. A view whose pose or shape stage fails counts with its state before.
    """
    options = options or Options()
    options = replace(options, keep_history=False, shape=replace(options.shape, joint=False))
    model = prepare(prior, size, options.shape.basis_vectors)
    parts: dict[str, list[tuple[Array, Array, Array, float]]] = {stage: [] for stage in STAGES}
    for view in views:
        for stage, (pose, keypoints) in _states(view, model, ground, options).items():
            parts[stage].append(_errors(view, pose, keypoints))
    return {stage: _summary(errors) for stage, errors in parts.items()}


def _states(
    view: SimulatedView, model: VehicleModel, ground: Ground | None, options: Options
) -> dict[str, tuple[Array, Array]]:
    """Pose (4, 4) and keypoints (K, 3) of every stage."""
    prior, (observation, truth) = model.prior, view
    mean, true_pose = prior.mean, truth.camera_T_object
    problem = Problem.of(observation, KITTI_CAMERA, model, ground, options)

    def solved(setting: Problem, start: PoseEstimate) -> tuple[Array, Array]:
        state = minimise_from_proposals([GraphObservation(setting)], [start]).optimum.state
        return state.poses[0].matrix(), prior.keypoints(*state.shapes[0])

    try:
        start = search_pose(problem)
    except FgreconError:
        start = _known_pose(problem, np.eye(4))
    moving = replace(problem, options=replace(options, shape=replace(options.shape, joint=True)))
    return {
        "mean, true pose": (true_pose, mean),
        "shape, true pose": solved(problem, _known_pose(problem, true_pose)),
        "mean, estimated pose": (start.camera_T_object, mean),
        "pose stage": (start.camera_T_object, prior.keypoints(start.coefficients)),
        "shape, pose fixed": solved(problem, start),
        "joint": solved(moving, start),
    }


def _known_pose(problem: Problem, camera_T_object: Array) -> PoseEstimate:
    """The mean shape at a pose, as if the pose stage had found it."""
    keypoints = problem.energy.keypoints
    visibility = problem.energy.visibility(camera_T_object[None])[0]
    weights = keypoints.strategy.initial_weights(keypoints.evidence, visibility)
    zero = np.zeros(len(keypoints.basis))
    return PoseEstimate(camera_T_object, zero, weights, visibility, 0.0, (), ())


def _errors(view: SimulatedView, camera_T_object: Array, keypoints: Array) -> tuple[Array, Array, Array, float]:
    """Distances (K,), centred distances (K,), reprojection errors of the inliers, orientation error in degrees."""
    observation, truth = view
    difference = keypoints - truth.vehicle.keypoints
    inlier = truth.visible & ~truth.outlier & observation.measured
    points = transform(camera_T_object, keypoints)
    with np.errstate(divide="ignore", invalid="ignore"):  # a failed pose is at the camera
        pixels = KITTI_CAMERA.project(points)[inlier]
    reprojection = np.linalg.norm(pixels - observation.keypoints[inlier], axis=1)
    cosine = float(camera_T_object[:3, 0] @ truth.camera_T_object[:3, 0])
    return (
        np.linalg.norm(difference, axis=1),
        np.linalg.norm(difference - difference.mean(axis=0), axis=1),
        np.nan_to_num(reprojection, nan=np.inf),
        float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))),
    )


def _summary(parts: Sequence[tuple[Array, Array, Array, float]]) -> StageScore:
    distance, centred, reprojection = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return StageScore(
        keypoint=float(np.median(distance)),
        centred=float(np.median(centred)),
        keypoint_rms=float(np.sqrt(np.square(distance).mean())),
        reprojection=float(np.median(reprojection)),
        orientation=float(np.median([part[3] for part in parts])),
        squares=tuple(float(np.square(part[0]).mean()) for part in parts),
    )


# What each energy term and each robust strategy contributes, on simulated views of held-out cars.
#
# Two priors are compared. The symmetric one makes symmetry, and the planarity of quads made of two mirrored pairs, hold
# for every lambda: those terms vanish. The other stands for a prior learnt from few 2D annotations: nothing about it is
# symmetric, its mean is biased, and free offsets let the wireframe leave it.

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


def unsymmetrised_prior(models: Apollo79, exclude: Sequence[str], seed: int = 0) -> ShapePrior:
    """A prior as one learnt from 2D annotations may be: biased, noisy and not symmetric (`BIAS`).

    Learnt from the keypoints as fixed points of the meshes, which are not symmetric. The spread of its free offsets
    covers the bias.

    Args:
        exclude: Names of models not to learn from.
    """
    keep = [i for i, name in enumerate(models.names) if name not in exclude and name != DUPLICATE[1]]
    rng = np.random.default_rng(seed)
    shapes = models.keypoints_mesh[keep]
    shapes = shapes + BIAS * rng.standard_normal(shapes.shape) + BIAS * rng.standard_normal(shapes.shape[1:])
    surface = SurfaceSamples(models.vertices[keep], models.faces)
    prior = pca_prior(load_category("car14"), shapes, basis=5, symmetric=False, surface=surface, name="unsymmetrised")
    return replace(prior, offset_sigma=np.hypot(prior.offset_sigma, BIAS))


ABSENT = frozenset({"direction", "points", "depth", "range", "mask"})
"""Terms of a detector's directions and of other sensors, which simulated views do not have."""


def variants(options: Options) -> dict[str, Options]:
    """Settings by name: as they are, each term switched the other way, no free offsets, the Laplacian as printed."""
    disabled = options.disabled_terms
    switched = {
        f"with {term}" if term in disabled else f"without {term}": replace(options, disabled_terms=disabled ^ {term})
        for term in Options.TERMS
        if term not in ABSENT
    }
    literal = replace(options, shape=replace(options.shape, literal_laplacian=True))
    return {
        DEFAULT: options,
        **switched,
        "without free offsets": replace(options, shape=replace(options.shape, free_offsets=False)),
        "with the Laplacian as printed": replace(literal, disabled_terms=disabled - {"laplacian"}),
    }


def strategies(options: Options) -> dict[str, Options]:
    """Settings by the robust strategies' names."""
    return {name: replace(options, strategy=named_strategy(name), keep_history=False) for name in STRATEGIES}


@summed_up()
def score_strategy(
    views: Sequence[SimulatedView],
    prior: ShapePrior,
    options: Options,
    *,
    ground: Ground | None = None,
    size: SizePrior | None = None,
) -> StrategyScore:
    """Pose and shape with one robust strategy."""
    turns, keypoints, translations = [], [], []
    for observation, truth in views:
        try:
            result = reconstruct(
                observation, KITTI_CAMERA, prior=prior, ground=ground, size_prior=size, options=options
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
