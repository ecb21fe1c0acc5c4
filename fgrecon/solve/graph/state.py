"""Where the optimisation of one vehicle in one image is: weights, energies and record of every step."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.reconstruction import Iteration
from fgrecon.solve.graph.graph import Terms, VehicleGraph, energies
from fgrecon.solve.proposals.search import PoseEnergy
from fgrecon.solve.proposals.terms import Hypotheses

__all__ = ["State", "graph_weights", "iteration", "reweigh", "robust_energies"]

Array = NDArray[np.float64]


@dataclass
class State:
    """Where the optimisation is."""

    pose: gtsam.Pose3
    coefficients: Array
    offsets: Array
    weights: Array
    visibility: Array
    box_weights: Array


def reweigh(state: State, energy: PoseEnergy, graph: VehicleGraph, values: gtsam.Values, progress: float) -> None:
    """Update visibility and weights at the current state."""
    strategy, evidence = energy.keypoints.strategy, energy.keypoints.evidence
    squared = _squared_distances(graph, values, energy)
    state.visibility = energy.visibility(state.pose.matrix()[None])[0]
    state.weights = strategy.weights(squared, evidence, state.visibility, previous=state.weights, progress=progress)
    if energy.box is not None:
        state.box_weights = energy.box.weights(energy.box.residuals(_hypothesis(graph, values)))[0]


def _squared_distances(graph: VehicleGraph, values: gtsam.Values, energy: PoseEnergy) -> Array:
    """(K,) squared Mahalanobis distances of the keypoints' residuals."""
    residual = graph.kernel.evaluate(values).pixels - energy.keypoints.pixels
    squared: Array = np.square(energy.keypoints.whitener @ residual[..., None]).sum(axis=(1, 2))
    return squared


def _hypothesis(graph: VehicleGraph, values: gtsam.Values) -> Hypotheses:
    pose, coefficients, _ = graph.read(values)
    matrix = pose.matrix()
    return Hypotheses(matrix[None, :3, :3], matrix[None, :3, 3], coefficients[None])


def robust_energies(graph: VehicleGraph, values: gtsam.Values, terms: Terms, energy: PoseEnergy) -> dict[str, float]:
    """Energy of each term; of keypoints and box the robust one, whose weights the graph holds, as in the pose stage."""
    here = _hypothesis(graph, values)
    visibility = energy.visibility(here.matrices())[0]
    squared = _squared_distances(graph, values, energy)
    robust = energy.keypoints.strategy.evaluate(squared, energy.keypoints.evidence, visibility)[1]
    told = {"reprojection": float(robust)}
    if energy.box is not None:
        told["box"] = float(energy.box.energy(energy.box.residuals(here))[0])
    # The factors of these two are not asked: there are many, and their energies are not the ones that are told.
    others = energies({name: term for name, term in terms.items() if name not in told}, values)
    return {**told, **others}


def graph_weights(energy: PoseEnergy, weights: Array, visibility: Array) -> Array:
    """(K,) weights of the noise models: without the m-estimator's share where the graph has the m-estimator itself.

    Args:
        energy: Has strategy and evidence.
        weights: (K,) weights of the keypoints.
        visibility: (K,) visibility that they were computed with.
    """
    term = energy.keypoints
    return weights if term.strategy.loss is None else term.strategy.initial_weights(term.evidence, visibility)


def iteration(
    stage: str,
    update: int,
    step: int,
    graph: VehicleGraph,
    values: gtsam.Values,
    weights: Array,
    terms: Terms,
    energy: PoseEnergy,
) -> Iteration:
    """The record of one step of a solve.

    Args:
        stage: Name of the stage.
        update: Index of the weight update within the stage.
        step: Index of the step within the update.
        graph: Builder of the graph.
        values: Where the step ended.
        weights: (K,) weights of the keypoints.
        terms: The factors that were solved.
        energy: Has the robust energies.
    """
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
        energies=robust_energies(graph, values, terms, energy),
    )
