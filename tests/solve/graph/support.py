"""A noisy observation of a random car, ready for the graph, and what the graph makes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors import M, P
from fgrecon.core.camera import Ground
from fgrecon.core.observation import Observation
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.multi_start import MultiStartResult, minimise_from_proposals
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.records import iterations
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.proposals.terms import Hypotheses
from tests.cars import observe, pose_problem, project, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.energy import Energy

GROUND = Ground(np.array([0.01, 1.0, -0.02]), 1.6)


def unsymmetric(prior, seed=0):
    """The prior with every keypoint a little off its place, as a prior learnt without symmetry would have it."""
    rng = np.random.default_rng(seed)
    mean = prior.mean + 0.03 * rng.normal(size=prior.mean.shape)
    basis = prior.basis + 0.01 * rng.normal(size=prior.basis.shape)
    return replace(prior, mean=mean, basis=basis, offset_sigma=np.full(len(mean), 0.04), surface=None)


def problem_of(seed=0, *, ground=True, size=True, covariance=False, prior=None, yaw=None, **settings):
    """A problem and its proposals; with every term, and without free offsets where they are not asked for."""
    rng = np.random.default_rng(seed)
    options = make_options(**{"free_offsets": False, "disabled_terms": (), **settings})
    car = load_prior("car14")
    prior = car if prior is None else prior
    pose = yaw_pose(rng.uniform(-3, 3) if yaw is None else yaw, (rng.uniform(-3, 3), 1.65, rng.uniform(8, 20)))
    observation = observe(car, pose, rng.normal(size=5), noise=2.5, seed=seed)
    if covariance:
        own = np.array([[6.0, 1.5], [1.5, 4.0]]) * rng.uniform(0.5, 2.0, (14, 1, 1))
        observation = Observation(observation.keypoints, observation.confidence, observation.box, own)
    plane = GROUND if ground else None
    fleet = SIZE_PRIORS["kitti"] if size else None
    problem, _ = pose_problem(prior, observation, ground=plane, size=fleet, options=options)
    return problem, search_pose(problem)


def half_a_car():
    """Five points of one side of a car seen from behind: front and back are hard to tell apart."""
    seen = observe(load_prior("car14"), yaw_pose(np.radians(90)), box=False)
    pixels = seen.keypoints.copy()
    pixels[np.setdiff1d(np.arange(14), [0, 2, 4, 10, 12])] = np.nan
    options = make_options(free_offsets=False)
    problem, _ = pose_problem(
        load_prior("car14"), replace(seen, keypoints=pixels, confidence=np.full(14, 0.9)), options=options
    )
    return problem, search_pose(problem)


@dataclass(frozen=True)
class Solved:
    """Where one observation of one vehicle ended, and what its graph was built from."""

    problem: Problem
    start: PoseEstimate
    adjusted: MultiStartResult

    @property
    def optimum(self):
        return self.adjusted.optimum

    @property
    def failure(self):
        return self.optimum.failure

    @property
    def pose(self):
        return self.optimum.state.poses[0]

    @property
    def coefficients(self):
        return self.optimum.state.shapes[0][0]

    @property
    def offsets(self):
        return self.optimum.state.shapes[0][1]

    @property
    def weights(self):
        """All that is held fixed in a solve: of keypoints, visibility, box edges, and the ground's depth."""
        return self.optimum.state.weights[0]

    @property
    def energies(self):
        return self.optimum.energies

    @property
    def history(self):
        return iterations(self.adjusted.stages, 0, alone=True)

    @property
    def alternatives(self):
        return self.adjusted.alternatives[0]

    def graph(self, *, pose_free=True):
        """The graph at the result."""
        return graph_at(self.problem, self.optimum.state, pose_free=pose_free)


def solve(problem, start, extra=()):
    """One observation of one vehicle from its proposals to the minimum."""
    return Solved(problem, start, minimise_from_proposals([GraphObservation(problem)], [start], extra))


def solved(seed=0, **settings):
    """The same of a problem of its own."""
    return solve(*problem_of(seed, **settings))


def constant(problem, table):
    """The problem with the same visibility everywhere."""
    energy = replace(problem.energy, visibility=lambda poses: np.tile(table, (len(poses), 1)))
    return replace(problem, energy=energy)


def graph_at(problem, state, *, pose_free=True, extra=()):
    """The graph of one observation at a state."""
    return Graph([GraphObservation(problem)], state, pose_free=pose_free, extra=extra)


def state_of(pose, coefficients, weights, offsets=None):
    """The state of one observation."""
    pose = pose if isinstance(pose, gtsam.Pose3) else gtsam.Pose3(pose)
    offsets = np.zeros((len(weights.keypoints), 3)) if offsets is None else offsets
    return State([pose], {0: (coefficients, offsets)}, [weights])


def proposal(problem, estimate, **changes):
    """The state at the best proposal, with the weights there or others."""
    return state_of(estimate.camera_T_object, estimate.coefficients, replace(weights_of(problem, estimate), **changes))


def terms_of(graph, weights):
    """Factors of one observation by energy term."""
    terms = {}
    for name, members in graph.terms([weights]):
        terms.setdefault(name, []).extend(members)
    return terms


def weights_of(problem, estimate):
    """Weights at the best proposal, those of the box edges made there."""
    pose = estimate.camera_T_object
    here = Hypotheses(pose[None, :3, :3], pose[None, :3, 3], estimate.coefficients[None])
    box = problem.energy.box
    box = np.ones(4) if box is None else box.rows.assess(box.residuals(here))[0][0]
    return Weights(estimate.weights, estimate.visibility, box, float(pose[2, 3]))


def weights_at(problem, pose, coefficients, *, previous=None, progress=1.0):
    """Weights of keypoints and box edges at a pose and lambda, by loops of their own, and the visibility there."""
    observation, prior, term = problem.observation, problem.model.prior, problem.energy.keypoints
    pixels = project(prior.keypoints(coefficients), pose, problem.camera.matrix)
    squared = np.zeros(len(pixels))
    for k, covariance in enumerate(keypoint_covariances(observation, problem.options.keypoints)):
        if observation.measured[k]:
            away = pixels[k] - observation.keypoints[k]
            squared[k] = away @ np.linalg.solve(covariance, away)
    visibility = problem.model.visibility.lookup(pose)
    weights, _ = term.strategy.evaluate(squared, term.evidence, visibility, previous=previous, progress=progress)
    box = problem.energy.box
    if box is None:
        return weights, np.ones(4), visibility
    plain = Weights(weights, visibility, np.ones(4), float(pose[2, 3]))
    edges = energy_of(problem, plain, pose, joint=False)._box(pose, coefficients)
    return (
        weights,
        np.where(box.rows.used, np.exp(-0.5 * edges**2) / (np.exp(-0.5 * edges**2) + box.rows.wrong), 0),
        visibility,
    )


def energy_of(problem, weights, camera_T_object, *, joint):
    """The independent energy of a problem under fixed weights."""
    covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
    return Energy(problem, covariances, weights, camera_T_object, joint=joint)


def vector(energy, graph, values):
    """The graph's values in the parameters of the independent energy."""
    pose = graph.observations[0].pose(values)
    coefficients, offsets = graph.vehicles[0].read(values)
    parts = []
    if energy.joint:
        change = gtsam.Pose3(energy.pose).between(pose)
        parts = [gtsam.Rot3.Logmap(change.rotation()), change.translation()]
    parts.append(coefficients)
    if energy.options.shape.free_offsets:
        parts.append(offsets.ravel())
    for index, face in enumerate(energy.category.faces):
        if face in energy.faces:
            if energy.penalty is not None:
                parts.append(values.atVector(P(0, index)))
            else:
                a, b, c, d = values.atOrientedPlane3(P(0, index)).planeCoefficients()
                parts.append(np.array([a, c, d * abs(b)]) / b)
    if energy.medial:
        a, b, c, d = values.atOrientedPlane3(M(0)).planeCoefficients()
        parts.append(np.array([a, b, d * abs(c)]) / c)
    return np.concatenate(parts)
