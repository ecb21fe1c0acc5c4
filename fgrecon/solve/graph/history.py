"""The steps of an optimisation as records of each observation and of the whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgrecon.core.reconstruction import Iteration
from fgrecon.core.track_reconstruction import JointStep
from fgrecon.solve.graph.graph import Graph
from fgrecon.solve.graph.multi_start import SolvedStage
from fgrecon.solve.graph.optimise import Step

__all__ = ["iterations", "joint_steps"]


def iterations(stages: Sequence[SolvedStage], index: int, *, alone: bool) -> tuple[Iteration, ...]:
    """Every step, as the observation at an index saw it.

    Args:
        stages: The stages.
        index: Which observation.
        alone: Whether it is the only one, and its energies hold the terms of the whole.
    """
    return tuple(
        _iteration(stage.name, stage.graph, step, index, alone=alone) for stage in stages for step in stage.steps
    )


def _iteration(name: str, graph: Graph, step: Step, index: int, *, alone: bool) -> Iteration:
    part, weights, values = graph.observations[index], step.weights[index], step.values
    energies = part.energies(values, weights)
    return Iteration(
        stage=name,
        irls=step.update,
        step=step.step,
        camera_T_object=part.pose(values).matrix(),
        coefficients=part.vehicle.read(values)[0],
        keypoints=part.vehicle.shape.points(values),
        projections=part.projections(values),
        weights=weights.keypoints,
        energies=energies | graph.own_energies(values) if alone else energies,
    )


def joint_steps(stages: Sequence[SolvedStage]) -> tuple[JointStep, ...]:
    """Every step of the whole, for one vehicle in several images."""
    return tuple(_joint_step(stage.graph, step) for stage in stages for step in stage.steps)


def _joint_step(graph: Graph, step: Step) -> JointStep:
    state = graph.read(step.values, step.weights)
    ((coefficients, _),) = state.shapes.values()
    poses = np.array([pose.matrix() for pose in state.poses])
    return JointStep(step.update, step.step, poses, coefficients, graph.energies(step.values, step.weights))
