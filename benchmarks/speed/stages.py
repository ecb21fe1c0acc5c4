"""One car, stage by stage, and the same minimisation by others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from benchmarks.speed.cases import Case
from benchmarks.speed.measure import Clock, clock
from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.solve.graph.covariance import marginals_of, read_covariances
from fgrecon.solve.graph.graph import Graph, GraphObservation
from fgrecon.solve.graph.multi_start import MultiStartResult, minimise_from_proposals, start_state
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.evaluation.methods import METHODS
from tests.solve.graph.energy import Energy, Whitened, minimise_by_ceres
from tests.solve.graph.support import energy_of, vector


@dataclass(frozen=True)
class Car:
    """A case with everything prepared that is not timed."""

    case: Case
    prior: ShapePrior
    guess: float | None
    problem: Problem
    pose: PoseEstimate
    adjusted: MultiStartResult

    @classmethod
    def of(cls, case: Case, prior: ShapePrior, guess: float | None = None) -> Car:
        """Solve it once, which also warms every cache."""
        problem = _problem(case, prior)
        pose = search_pose(problem, guess)
        return cls(case, prior, guess, problem, pose, minimise_from_proposals([GraphObservation(problem)], [pose]))

    def propose(self) -> object:
        """The proposals."""
        return search_pose(_problem(self.case, self.prior), self.guess)

    def refine(self, *, joint: bool = True, keep_history: bool = False, alternatives: bool = True) -> object:
        """The graph's stage, from every proposal that matters or from the best alone."""
        shape = replace(self.problem.options.shape, joint=joint)
        options = replace(self.problem.options, shape=shape, keep_history=keep_history)
        start = self.pose if alternatives else replace(self.pose, alternatives=())
        return minimise_from_proposals([GraphObservation(replace(self.problem, options=options))], [start])

    def covariance(self) -> object:
        """Covariances at the result."""
        graph, state = self.adjusted.graph, self.adjusted.optimum.state
        values = graph.values(state)
        marginals = marginals_of(graph, values, state.weights)
        return read_covariances(graph.observations[0], state.weights[0], values, marginals)

    def everything(self, *, history: bool = False) -> object:
        """`reconstruct`."""
        return reconstruct(
            self.case.observation,
            self.case.camera,
            ground=self.case.ground,
            prior=self.prior,
            size_prior=self.case.size,
            initial=self.guess,
            options=replace(self.problem.options, keep_history=history),
        )

    def one_solve(self) -> object:
        """One joint minimisation with the final weights, from the best proposal."""
        seen = [GraphObservation(self.problem)]
        start = start_state(seen, [self.pose])
        graph = Graph(seen, start, pose_free=True)
        return minimise(graph.build(self.adjusted.optimum.state.weights), graph.values(start))

    def energy(self) -> tuple[Energy, Array]:
        """The same energy in plain numpy, and its start."""
        (weights,) = self.adjusted.optimum.state.weights
        energy = energy_of(self.problem, weights, self.pose.camera_T_object, joint=True)
        return energy, energy.start(self.pose.coefficients, np.zeros((len(weights.keypoints), 3)))

    def scipy_solve(self) -> object:
        """The same by scipy, numeric derivatives."""
        energy, start = self.energy()
        return least_squares(energy.residual, start, x_scale="jac")

    def ceres_solve(self) -> object:
        """The same by Ceres, the residual and its numeric derivatives from Python."""
        return minimise_by_ceres(*self.energy())

    def from_the_minimum(self, steps: int = 8) -> tuple[float, float]:
        """How far the result is from the robust energy's minimum, metres and degrees.

        From the result on, the energy is lowered without weights: it is written out in plain numpy (`tests`), and its
        slope is taken by differences, in coordinates in which the curvature is nearly that of a unit sphere.
        """
        optimum = self.adjusted.optimum
        pose = optimum.state.poses[0].matrix()
        energy = energy_of(self.problem, optimum.state.weights[0], pose, joint=True)
        x = vector(energy, self.adjusted.graph, optimum.values)
        around, y = Whitened(energy, x), np.zeros(len(x))
        for _ in range(steps):
            y = y - around.gradient(y)
        return pose_difference(energy.pose_at(around.at(y)), energy.pose_at(x))

    def baseline(self, name: str) -> Clock:
        """A method of the evaluation."""
        height = self.case.ground
        ground = None if height is None else Ground.level(height)
        size = None if self.case.size is None else SIZE_PRIORS[self.case.size]
        solver = METHODS[name].bind(SceneKnowledge(self.prior, ground, size))
        return clock(lambda: solver(self.case.observation, self.case.camera))


def _problem(case: Case, prior: ShapePrior) -> Problem:
    options = Options(box=BoxModel(case.box_model), keep_history=False)
    size = None if case.size is None else SIZE_PRIORS[case.size]
    ground = None if case.ground is None else Ground.level(case.ground)
    return Problem.of(case.observation, case.camera, prepare(prior, size), ground, options)


def pose_difference(one: Array, other: Array) -> tuple[float, float]:
    """Distance of two poses: metres and degrees."""
    turn = one[:3, :3].T @ other[:3, :3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1.0)
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(np.degrees(angle))


def stages(cars: Sequence[Car]) -> dict[str, list[Clock]]:
    """Rows of every stage."""
    return {
        "everything, `reconstruct()`": [clock(car.everything) for car in cars],
        "everything, with history": [clock(lambda car=car: car.everything(history=True)) for car in cars],
        "proposals": [clock(car.propose) for car in cars],
        "graph: shape, pose fixed": [clock(lambda car=car: car.refine(joint=False)) for car in cars],
        "graph: shape and pose": [clock(car.refine) for car in cars],
        "graph: from the best proposal alone": [clock(lambda car=car: car.refine(alternatives=False)) for car in cars],
        "covariances": [clock(car.covariance) for car in cars],
    }


def solvers(cars: Sequence[Car]) -> dict[str, list[Clock]]:
    """One joint minimisation under the final weights, by several solvers."""
    rows = {
        "GTSAM": [clock(car.one_solve) for car in cars],
        "scipy, numeric derivatives": [clock(car.scipy_solve) for car in cars],
    }
    try:
        import pyceres
    except ImportError:
        return rows
    return {**rows, f"pyceres {pyceres.__version__}, numeric derivatives": [clock(c.ceres_solve) for c in cars]}
