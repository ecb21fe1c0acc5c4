"""A graph's structure, and the steps of its optimisation, as plain records for drawing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import gtsam
import numpy as np

from factors import decode_key, key_name
from factors.keypoint_rows import SMALLEST_WEIGHT
from fgrecon.core.reconstruction import GraphFactor, Iteration
from fgrecon.core.track_reconstruction import JointStep
from fgrecon.solve.graph.graph import EXTRA, Graph
from fgrecon.solve.graph.multi_start import SolvedStage
from fgrecon.solve.graph.newton import Step
from fgrecon.solve.graph.observation_part import ObservationPart, Weights

_BY_LETTERS = {"V": "velocity", "VV": "velocity change", "XVX": "motion", "XG": "contact"}
"""What extra factors on these variables are about."""


def factors_of(graph: Graph, index: int, weights: Sequence[Weights]) -> tuple[GraphFactor, ...]:
    """The factors about the only observation of a vehicle, keypoint by keypoint; see `graph_factors`."""
    part = graph.observations[index]
    own = {key_name(key) for key in (part.pose_key, *part.vehicle.keys) if key is not None}
    others = [one for one in graph_factors(graph, weights) if one.term != "reprojection"]
    keypoints = _keypoints(part, weights[index], each=True)
    return (*keypoints, *(one for one in others if not own.isdisjoint(one.variables)))


def graph_factors(graph: Graph, weights: Sequence[Weights]) -> tuple[GraphFactor, ...]:
    """Every factor of a graph with the variables that it ties together.

    The keypoints of an observation, one stacked factor, are shown keypoint by keypoint; those of several observations,
    which would fill the picture, observation by observation.

    Args:
        weights: Weights of each observation.
    """
    records: list[GraphFactor] = []
    for part, weight in zip(graph.observations, weights, strict=True):
        records += _keypoints(part, weight, each=len(graph.observations) == 1)
    faces = graph.observations[0].problem.model.prior.category.faces
    names = tuple(face.name for face in faces)
    for term, members in graph.terms(weights):
        records += [_record(term, factor, names) for factor in members if term != "reprojection"]
    return tuple(records)


def _keypoints(part: ObservationPart, weights: Weights, *, each: bool) -> Iterator[GraphFactor]:
    names = part.problem.model.prior.category.keypoints
    variables = tuple(key_name(key) for key in part.keys)
    used = part.problem.observation.measured & (part.graph_weights(weights) >= SMALLEST_WEIGHT)
    if not variables or not used.any():
        return
    if each:
        for i in np.flatnonzero(used):
            yield GraphFactor("reprojection", names[i], variables)
    else:
        yield GraphFactor("reprojection", f"{np.count_nonzero(used)} keypoints", variables)


def _record(term: str, factor: gtsam.NonlinearFactor, faces: tuple[str, ...]) -> GraphFactor:
    keys = list(factor.keys())
    decoded = [decode_key(key) for key in keys]
    planes = [key.low for key in decoded if key.letter == "P"]
    label = faces[planes[0]] + (" level" if len(keys) == 1 else "") if planes else ""
    if term == EXTRA:
        label = _BY_LETTERS.get("".join(key.letter for key in decoded), "")
    return GraphFactor(term, label, tuple(key_name(key) for key in keys))


def iterations(stages: Sequence[SolvedStage], index: int, *, alone: bool) -> tuple[Iteration, ...]:
    """Every step, as the observation at an index saw it.

    Args:
        index: Which observation.
        alone: Whether it is the only one, and its energies hold the terms of the whole.
    """
    return tuple(
        _iteration(stage.name, stage.graph, step, index, alone=alone) for stage in stages for step in stage.steps
    )


def _iteration(name: str, graph: Graph, step: Step, index: int, *, alone: bool) -> Iteration:
    part, weights, values = graph.observations[index], step.weights[index], step.values
    energies = part.energies(values, weights) | graph.own_energies(values) if alone else None
    return Iteration(
        stage=name,
        irls=step.update,
        step=step.step,
        camera_T_object=part.pose(values).matrix(),
        coefficients=part.vehicle.read(values)[0],
        keypoints=part.vehicle.shape.points(values),
        projections=part.projections(values),
        weights=weights.keypoints,
        energies=graph.energies_of(index, values, weights) if energies is None else energies,
    )


def joint_steps(stages: Sequence[SolvedStage]) -> tuple[JointStep, ...]:
    """Every step of the whole, for one vehicle in several images."""
    return tuple(_joint_step(stage.graph, step) for stage in stages for step in stage.steps)


def _joint_step(graph: Graph, step: Step) -> JointStep:
    state = graph.read(step.values, step.weights)
    ((coefficients, _),) = state.shapes.values()
    poses = np.array([pose.matrix() for pose in state.poses])
    return JointStep(step.update, step.step, poses, coefficients, graph.energies(step.values, step.weights))
