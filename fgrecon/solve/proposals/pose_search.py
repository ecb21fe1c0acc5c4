"""Pose search: the pose, and a first guess of the shape, from the keypoints of one image.

Two ways lead there. The strategies `paper` and `paper_literal` run the paper's Algorithm 1
(`fgrecon.solve.proposals.irls`). With the others the vehicle is placed in the 2D box at azimuths all around, and at
every minimum that ASPnP finds; all starts are refined at once over pose and coefficients under the robust energy, and
the energy decides; poses that come close to the best are kept as alternatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.history import Deferred
from fgrecon.core.reconstruction import Alternative, Iteration
from fgrecon.solve.proposals.irls import algorithm1
from fgrecon.solve.proposals.point_search import rests_on_few, search_with_mask, search_with_points
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import PoseEnergy, search
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.starts import all_starts
from fgrecon.solve.proposals.terms import Hypotheses


@dataclass(frozen=True)
class PoseEstimate:
    """Result of the pose stage."""

    camera_T_object: Array  # (4, 4) pose
    coefficients: Array  # (N,) coefficients that go with it (zero for the paper's algorithm, which has the mean shape)
    weights: Array  # (K,) final weights
    visibility: Array  # (K,) visibility at the pose
    energy: float  # energy in nats
    alternatives: tuple[Alternative, ...]  # distinct other poses, best first
    history: Sequence[Iteration]
    everywhere: bool = False  # whether it was searched all round, and may be again


def search_pose(problem: Problem, initial: Box3D | float | Array | None = None) -> PoseEstimate:
    """Estimate the pose.

    Args:
        problem: What is to be solved.
        initial: A 3D box to start from as well; or a guess of rotation_y in radians to trust within 45 degrees; or the
            pose (4, 4) where the vehicle should be by what went before, which takes the place of ASPnP's.

    Raises:
        DegenerateProblemError: No start ends in front of the camera, or the weights leave the pose undetermined.
    """
    if problem.options.strategy.is_paper:
        return _by_algorithm1(problem)
    dimension = problem.model.prior.dimension
    moved = min(problem.options.search.basis_vectors, dimension)
    starts = all_starts(problem, initial).of_dimension(moved)
    energy = problem.energy.truncated(moved)
    result = search(energy, starts, SETTINGS.iterations, dict(SETTINGS.kept_hypotheses))
    if not np.isfinite(result.energy[0]):
        raise DegenerateProblemError("keypoints", "no pose in front of the camera", "Check intrinsics, box and points.")
    found, energies, weights = result.hypotheses.of_dimension(dimension), result.energy, result.weights
    carrying, beside = float(weights.sum(axis=1).max()), None
    if problem.energy.points:
        beside = search_with_points(problem, found, carrying)
    elif problem.energy.masks and rests_on_few(problem, carrying):
        beside = search_with_mask(problem, found)
    if beside is not None:
        found, energies, weights = beside.hypotheses, beside.energy, beside.weights
    best, coefficients = found.matrices(), found.coefficients
    visibility = energy.visible_from(best[0])
    return PoseEstimate(
        camera_T_object=best[0],
        coefficients=coefficients[0],
        weights=weights[0],
        visibility=visibility,
        energy=float(energies[0]),
        alternatives=tuple(
            Alternative(best[i], coefficients[i], float(energies[i] - energies[0])) for i in distinct(best)[1:]
        ),
        history=_history(problem, energy, result.path, result.path_weights),
        everywhere=not isinstance(initial, int | float),
    )


def _by_algorithm1(problem: Problem) -> PoseEstimate:
    try:
        result = algorithm1(problem)
    except DegenerateProblemError as error:  # in the words of this function's caller
        raise DegenerateProblemError("keypoints", error.value, error.fix) from error
    energy = problem.energy.truncated(0)
    path = Hypotheses.at_poses(result.poses, 0)
    visibility = problem.energy.visibility(result.poses[-1:])
    last = path.take(np.array([len(path) - 1]))
    total, _ = energy.evaluate(last)
    mean = np.zeros(problem.model.prior.dimension)
    return PoseEstimate(
        camera_T_object=result.poses[-1],
        coefficients=mean,
        weights=result.weights[-1],
        visibility=visibility[0],
        energy=float(total.energy[0]),
        alternatives=tuple(Alternative(pose, mean, float("nan")) for pose in result.others),
        history=_history(problem, energy, path, result.weights),
    )


def distinct(poses: Sequence[Array] | Array) -> list[int]:
    """Indices of poses (4, 4) that are not within `SETTINGS.distinct_turn_radians` of an earlier one."""
    flat = np.asarray(poses)[:, :3, :3].reshape(-1, 9)
    alike = ((flat @ flat.T - 1.0) / 2.0 >= np.cos(SETTINGS.distinct_turn_radians)).tolist()
    kept: list[int] = []
    for i, row in enumerate(alike):
        if not any(row[j] for j in kept):
            kept.append(i)
    return kept


def _history(problem: Problem, energy: PoseEnergy, path: Hypotheses, weights: Array) -> Sequence[Iteration]:
    """The steps of the search, made when they are looked at; none where they are not wanted."""
    dimension = problem.model.prior.dimension
    return Deferred(lambda: _steps(energy, path, weights, dimension)) if problem.options.keep_history else ()


def _steps(energy: PoseEnergy, path: Hypotheses, weights: Array, dimension: int) -> tuple[Iteration, ...]:
    energies, keypoints = energy.energies(path), energy.keypoints
    points = keypoints.mean + np.tensordot(path.coefficients, keypoints.basis, axes=1)
    camera = points @ path.rotation.transpose(0, 2, 1) + path.translation[:, None]
    homogeneous = camera @ keypoints.matrix.T
    pixels = homogeneous[..., :2] / homogeneous[..., 2:]
    coefficients = path.of_dimension(dimension).coefficients
    return tuple(
        Iteration(
            stage="pose" if i else "initialisation",
            irls=max(i - 1, 0),
            step=0,
            camera_T_object=pose,
            coefficients=coefficients[i],
            keypoints=points[i],
            projections=pixels[i],
            weights=weights[i],
            energies={name: float(values[i]) for name, values in energies.items()},
        )
        for i, pose in enumerate(path.matrices())
    )
