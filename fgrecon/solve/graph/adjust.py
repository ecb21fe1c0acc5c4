"""Shape-aware adjustment: lambda and planes with the pose fixed, then pose and shape together (section III-C)."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors import check_in_front
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.reconstruction import Iteration
from fgrecon.solve.graph.graph import Terms, VehicleGraph, build
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.graph.state import State, graph_weights, iteration, reweigh, robust_energies
from fgrecon.solve.proposals.adjust import PoseEstimate
from fgrecon.solve.proposals.problem import Problem

__all__ = ["EARLY_TOLERANCE", "FINAL_TOLERANCE", "SETTLED", "ShapeEstimate", "adjust_shape"]

Array = NDArray[np.float64]

SETTLED = 1e-3
"""Weights that change by less have converged."""
EARLY_TOLERANCE = 1e-4
"""Relative decrease at which a solve ends whose weights are about to change."""
FINAL_TOLERANCE = 1e-10
"""The same for the last solve."""


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
        unfinished: Where the last solve was stopped short of its minimum, or None; the rest is where it stopped.
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
    unfinished: str | None = None


def adjust_shape(problem: Problem, start: PoseEstimate) -> ShapeEstimate:
    """Minimise the full energy from the pose stage's result.

    Args:
        problem: What is to be solved.
        start: Result of the pose stage.

    Returns:
        The result. Where the start is behind the camera or a system is singular, the state so far and why.
    """
    state = State(
        gtsam.Pose3(start.camera_T_object),
        start.coefficients,
        np.zeros((len(start.weights), 3)),
        start.weights,
        start.visibility,
        np.ones(4),
    )
    history: list[Iteration] = []
    at_end: dict[str, float] = {}
    failure = unfinished = None
    try:
        for stage in ("shape", "joint") if problem.options.shape.joint else ("shape",):
            at_end, unfinished = _run_stage(stage, problem, state, history)
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
        unfinished,
    )


def _run_stage(
    stage: str, problem: Problem, state: State, history: list[Iteration]
) -> tuple[dict[str, float], str | None]:
    """IRLS updates of one stage, in place; the energies at its end, and where the last solve was stopped early."""
    graph = VehicleGraph(problem, state.pose, pose_free=stage == "joint")
    values = graph.values(state.pose, state.coefficients, state.offsets)
    check_in_front(graph.kernel, values)
    updates = max(problem.options.strategy.updates, 1)
    terms: Terms = {}
    unfinished = None
    for update in range(updates):
        before = state.weights
        reweigh(state, problem.energy, graph, values, update / max(updates - 1, 1))
        terms = graph.terms(graph_weights(problem.energy, state.weights, state.visibility), state.box_weights)
        settled = update > 0 and float(np.abs(state.weights - before).max()) < SETTLED
        last = update == updates - 1 or (settled and not problem.options.strategy.anneals)
        solution = minimise(
            build(terms),
            values,
            relative_tolerance=FINAL_TOLERANCE if last else EARLY_TOLERANCE,
            record=problem.options.keep_history,
        )
        values = solution.values
        history.extend(
            iteration(stage, update, step, graph, iterate, state.weights, terms, problem.energy)
            for step, iterate in enumerate(solution.path)
        )
        state.pose, state.coefficients, state.offsets = graph.read(values)
        if last:
            if not solution.converged:
                unfinished = f"after {solution.iterations} iterations, on nearly level ground"
            break
    return robust_energies(graph, values, terms, problem.energy), unfinished
