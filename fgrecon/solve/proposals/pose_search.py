"""Pose adjustment: the pose, and a first guess of the shape, from the keypoints of one image.

Two ways lead there. The strategies `paper` and `paper_literal` run the paper's Algorithm 1
(`fgrecon.solve.proposals.irls`). With the others the vehicle is placed in the 2D box at azimuths all around, and at
every minimum that ASPnP finds; all starts are refined at once over pose and coefficients under the robust energy, and
the energy decides; poses that come close to the best are kept as alternatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import Box3D
from fgrecon.core.deferred import Deferred
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.reconstruction import Alternative, Iteration
from fgrecon.solve.proposals.aspnp import aspnp
from fgrecon.solve.proposals.irls import algorithm1
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import search
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.starts import at_azimuths, from_box3d, from_pose, view_box
from fgrecon.solve.proposals.terms import Hypotheses

__all__ = ["PoseEstimate", "distinct", "search_pose"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseEstimate:
    """Result of the pose stage.

    Attributes:
        camera_T_object: (4, 4) pose.
        coefficients: (N,) coefficients that go with it (zero for the paper's algorithm, which has the mean shape).
        weights: (K,) final weights.
        visibility: (K,) visibility at the pose.
        energy: Energy in nats.
        alternatives: Distinct other poses, best first.
        history: Every iteration.
        everywhere: Whether it was searched all round, and may be again.
    """

    camera_T_object: Array
    coefficients: Array
    weights: Array
    visibility: Array
    energy: float
    alternatives: tuple[Alternative, ...]
    history: Sequence[Iteration]
    everywhere: bool = False


def search_pose(problem: Problem, initial: Box3D | float | Array | None = None) -> PoseEstimate:
    """Estimate the pose.

    Args:
        problem: What is to be solved.
        initial: A 3D box to start from as well; or a guess of rotation_y in radians to trust within 45 degrees; or the
            pose (4, 4) where the vehicle should be by what went before, which takes the place of ASPnP's.

    Raises:
        DegenerateProblemError: No start ends in front of the camera, or the weights leave the pose undetermined.
    """
    count, dimension = problem.options.search.basis_vectors, problem.model.prior.dimension
    if count >= dimension:
        return _adjusted(problem, initial)
    coarse = replace(problem, model=problem.model.truncated(count), energy=problem.energy.truncated(count))
    return _padded(_adjusted(coarse, initial), dimension - count)


def _padded(estimate: PoseEstimate, missing: int) -> PoseEstimate:
    """The estimate as one with so many more coefficients, all of them zero."""

    def pad(coefficients: Array) -> Array:
        return np.concatenate([coefficients, np.zeros(missing)])

    return replace(
        estimate,
        coefficients=pad(estimate.coefficients),
        alternatives=tuple(replace(a, coefficients=pad(a.coefficients)) for a in estimate.alternatives),
        history=_padded_history(estimate.history, pad),
    )


def _padded_history(history: Sequence[Iteration], pad: Callable[[Array], Array]) -> Sequence[Iteration]:
    if not isinstance(history, Deferred):
        return history
    return Deferred(lambda: [replace(step, coefficients=pad(step.coefficients)) for step in history])


def _adjusted(problem: Problem, initial: Box3D | float | Array | None) -> PoseEstimate:
    if problem.options.strategy.is_paper:
        return _by_algorithm1(problem)
    result = search(problem.energy, _starts(problem, initial), SETTINGS.iterations, dict(SETTINGS.kept_hypotheses))
    if not np.isfinite(result.energy[0]):
        raise DegenerateProblemError("keypoints", "no pose in front of the camera", "Check intrinsics, box and points.")
    best = result.hypotheses.matrices()
    return PoseEstimate(
        camera_T_object=best[0],
        coefficients=result.hypotheses.coefficients[0],
        weights=result.weights[0],
        visibility=problem.energy.visible_from(best[0]),
        energy=float(result.energy[0]),
        alternatives=tuple(
            Alternative(best[i], result.hypotheses.coefficients[i], float(result.energy[i] - result.energy[0]))
            for i in distinct(best)[1:]
        ),
        history=_history(problem, result.path, result.path_weights),
        everywhere=not isinstance(initial, int | float),
    )


def _starts(problem: Problem, initial: Box3D | float | Array | None) -> Hypotheses:
    camera, model, ground = problem.camera, problem.model, problem.ground
    box = view_box(problem.observation)
    if isinstance(initial, int | float):
        azimuths = float(initial) + np.array(SETTINGS.heading_guess_radians)
        return at_azimuths(box, camera, model, ground, azimuths, relative=False)
    foreseen = initial if isinstance(initial, np.ndarray) else None
    count = max(problem.options.search.azimuths // (1 if foreseen is None else SETTINGS.foreseen_azimuth_divisor), 1)
    clock = 2.0 * np.pi * np.arange(count) / count
    parts = [at_azimuths(box, camera, model, ground, clock, relative=True)]
    if isinstance(initial, Box3D):
        parts.append(from_box3d(initial, model, ground))
    if foreseen is not None:
        parts.append(from_pose(foreseen, model.prior.dimension))
    else:
        parts.append(_from_aspnp(problem))
    return Hypotheses.joined(parts)


def _from_aspnp(problem: Problem) -> Hypotheses:
    """The minima of ASPnP with the confidences as weights; none where it finds the points degenerate."""
    prior = problem.model.prior
    none = np.zeros((0, 4, 4))
    weights = problem.energy.keypoints.evidence.right
    used = np.flatnonzero(weights > SETTINGS.pnp_least_right_probability)
    if len(used) < SETTINGS.pnp_least_keypoints:
        return from_pose(none, prior.dimension)
    rays = problem.camera.rays(problem.observation.keypoints[used])[:, :2]
    try:
        found = aspnp(prior.mean[used], rays, weights[used], every=False)
    except DegenerateProblemError:
        return from_pose(none, prior.dimension)
    return from_pose(np.array([solution.camera_T_object for solution in found]), prior.dimension)


def _by_algorithm1(problem: Problem) -> PoseEstimate:
    try:
        result = algorithm1(problem)
    except DegenerateProblemError as error:  # in the words of this function's caller
        raise DegenerateProblemError("keypoints", error.value, error.fix) from error
    zero = np.zeros((len(result.poses), problem.model.prior.dimension))
    path = Hypotheses(result.poses[:, :3, :3], result.poses[:, :3, 3], zero)
    visibility = problem.energy.visibility(result.poses[-1:])
    last = path.take(np.array([len(path) - 1]))
    total, _ = problem.energy.evaluate(last)
    return PoseEstimate(
        camera_T_object=result.poses[-1],
        coefficients=zero[-1],
        weights=result.weights[-1],
        visibility=visibility[0],
        energy=float(total.energy[0]),
        alternatives=tuple(Alternative(pose, zero[-1], float("nan")) for pose in result.others),
        history=_history(problem, path, result.weights),
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


def _history(problem: Problem, path: Hypotheses, weights: Array) -> Sequence[Iteration]:
    """The steps of the search, made when they are looked at; none where they are not wanted."""
    return Deferred(lambda: _steps(problem, path, weights)) if problem.options.keep_history else ()


def _steps(problem: Problem, path: Hypotheses, weights: Array) -> tuple[Iteration, ...]:
    energies, keypoints = problem.energy.energies(path), problem.energy.keypoints
    points = keypoints.mean + np.tensordot(path.coefficients, keypoints.basis, axes=1)
    camera = points @ path.rotation.transpose(0, 2, 1) + path.translation[:, None]
    homogeneous = camera @ keypoints.matrix.T
    pixels = homogeneous[..., :2] / homogeneous[..., 2:]
    return tuple(
        Iteration(
            stage="pose" if i else "initialisation",
            irls=max(i - 1, 0),
            step=0,
            camera_T_object=pose,
            coefficients=path.coefficients[i],
            keypoints=points[i],
            projections=pixels[i],
            weights=weights[i],
            energies={name: float(energy[i]) for name, energy in energies.items()},
        )
        for i, pose in enumerate(path.matrices())
    )
