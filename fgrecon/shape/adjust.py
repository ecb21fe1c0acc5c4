"""Shape-aware adjustment: lambda and planes with the pose fixed, then pose and shape together (section III-C)."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors import check_in_front
from fgrecon.errors import DegenerateProblemError
from fgrecon.pose.adjust import PoseEstimate
from fgrecon.pose.search import PoseProblem
from fgrecon.pose.terms import Hypotheses
from fgrecon.reconstruction import Iteration
from fgrecon.shape.graph import Scene, Terms, VehicleGraph, build, energies
from fgrecon.shape.solver import minimise

__all__ = ["ShapeEstimate", "adjust_shape", "graph_weights"]

Array = NDArray[np.float64]

_SETTLED = 1e-3  # weights that change by less have converged
_EARLY_TOLERANCE = 1e-5  # relative decrease at which a solve ends whose weights are about to change
_FINAL_TOLERANCE = 1e-10


@dataclass(frozen=True)
class ShapeEstimate:
    """Result of the shape stage.

    Attributes:
        pose: camera_T_object.
        coefficients: (N,) lambda.
        offsets: (K, 3) free offsets, zero where they are not variables.
        weights: (K,) final weights of the keypoints.
        visibility: (K,) visibility that they were computed with.
        box_weights: (4,) final weights of the box edges.
        energies: Energy by term, nats.
        history: Every iteration.
        failure: Why the stage gave up, or None; the rest is then the state before.
    """

    pose: gtsam.Pose3
    coefficients: Array
    offsets: Array
    weights: Array
    visibility: Array
    box_weights: Array
    energies: dict[str, float]
    history: tuple[Iteration, ...]
    failure: str | None = None


@dataclass
class _State:
    """Where the optimisation is."""

    pose: gtsam.Pose3
    coefficients: Array
    offsets: Array
    weights: Array
    visibility: Array
    box_weights: Array


def adjust_shape(scene: Scene, problem: PoseProblem, start: PoseEstimate) -> ShapeEstimate:
    """Minimise the full energy from the pose stage's result.

    Args:
        scene: What is given.
        problem: The pose stage's problem, for weights and visibility.
        start: Result of the pose stage.

    Returns:
        The result. Where the start is behind the camera or a system is singular, the state so far and why.
    """
    state = _State(
        gtsam.Pose3(start.camera_T_object),
        start.coefficients,
        np.zeros((len(start.weights), 3)),
        start.weights,
        start.visibility,
        np.ones(4),
    )
    history: list[Iteration] = []
    at_end: dict[str, float] = {}
    failure = None
    try:
        for stage in ("shape", "joint") if scene.options.joint else ("shape",):
            at_end = _run_stage(stage, scene, problem, state, history)
    except DegenerateProblemError as error:
        failure = str(error)
    return ShapeEstimate(
        state.pose,
        state.coefficients,
        state.offsets,
        state.weights,
        state.visibility,
        state.box_weights,
        at_end,
        tuple(history),
        failure,
    )


def _run_stage(
    stage: str, scene: Scene, problem: PoseProblem, state: _State, history: list[Iteration]
) -> dict[str, float]:
    """IRLS updates of one stage, in place; the energies at its end."""
    graph = VehicleGraph(scene, state.pose, pose_free=stage == "joint")
    values = graph.values(state.pose, state.coefficients, state.offsets)
    check_in_front(graph.kernel, values)
    updates = max(scene.options.strategy.updates, 1)
    terms: Terms = {}
    for update in range(updates):
        before = state.weights
        _reweigh(state, problem, graph, values, update / max(updates - 1, 1))
        terms = graph.terms(graph_weights(problem, state.weights, state.visibility), state.box_weights)
        last = update == updates - 1 or (update > 0 and float(np.abs(state.weights - before).max()) < _SETTLED)
        solution = minimise(
            build(terms),
            values,
            relative_tolerance=_FINAL_TOLERANCE if last else _EARLY_TOLERANCE,
            record=scene.options.keep_history,
        )
        values = solution.values
        history.extend(
            _iteration(stage, update, step, graph, iterate, state.weights, terms, problem)
            for step, iterate in enumerate(solution.path)
        )
        state.pose, state.coefficients, state.offsets = graph.read(values)
        if last:
            break
    return _energies(graph, values, terms, problem)


def _reweigh(state: _State, problem: PoseProblem, graph: VehicleGraph, values: gtsam.Values, progress: float) -> None:
    """Update visibility and weights at the current state."""
    strategy, evidence = problem.keypoints.strategy, problem.keypoints.evidence
    squared = _squared_distances(graph, values, problem)
    state.visibility = problem.visibility(state.pose.matrix()[None])[0]
    state.weights = strategy.weights(squared, evidence, state.visibility, previous=state.weights, progress=progress)
    if problem.box is not None:
        state.box_weights = problem.box.weights(problem.box.residuals(_hypothesis(graph, values)))[0]


def _squared_distances(graph: VehicleGraph, values: gtsam.Values, problem: PoseProblem) -> Array:
    """(K,) squared Mahalanobis distances of the keypoints' residuals."""
    residual = graph.kernel.evaluate(values).pixels - problem.keypoints.pixels
    squared: Array = np.square(problem.keypoints.whitener @ residual[..., None]).sum(axis=(1, 2))
    return squared


def _hypothesis(graph: VehicleGraph, values: gtsam.Values) -> Hypotheses:
    pose, coefficients, _ = graph.read(values)
    matrix = pose.matrix()
    return Hypotheses(matrix[None, :3, :3], matrix[None, :3, 3], coefficients[None])


def _energies(graph: VehicleGraph, values: gtsam.Values, terms: Terms, problem: PoseProblem) -> dict[str, float]:
    """Energy of each term; of keypoints and box the robust one, whose weights the graph holds, as in the pose stage."""
    result = energies(terms, values)
    here = _hypothesis(graph, values)
    visibility = problem.visibility(here.matrices())[0]
    squared = _squared_distances(graph, values, problem)
    robust = problem.keypoints.strategy.evaluate(squared, problem.keypoints.evidence, visibility)[1]
    result["reprojection"] = float(robust)
    if problem.box is not None:
        result["box"] = float(problem.box.energy(problem.box.residuals(here))[0])
    return result


def graph_weights(problem: PoseProblem, weights: Array, visibility: Array) -> Array:
    """(K,) weights of the noise models: without the m-estimator's share where the graph has the m-estimator itself.

    Args:
        problem: Has strategy and evidence.
        weights: (K,) weights of the keypoints.
        visibility: (K,) visibility that they were computed with.
    """
    term = problem.keypoints
    return weights if term.strategy.loss is None else term.strategy.initial_weights(term.evidence, visibility)


def _iteration(
    stage: str,
    update: int,
    step: int,
    graph: VehicleGraph,
    values: gtsam.Values,
    weights: Array,
    terms: Terms,
    problem: PoseProblem,
) -> Iteration:
    pose, coefficients, _ = graph.read(values)
    return Iteration(
        stage=stage,
        irls=update,
        step=step,
        camera_T_object=pose.matrix(),
        coefficients=coefficients,
        keypoints=graph.shape.points(values),
        projections=graph.kernel.evaluate(values).pixels,
        weights=weights,
        energies=_energies(graph, values, terms, problem),
    )
