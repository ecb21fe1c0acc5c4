"""A noisy observation of a random car, ready for the shape stage."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from factors import M, P
from fgrecon.core.camera import Ground
from fgrecon.core.observation import Observation
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.adjust import adjust_pose
from fgrecon.solve.proposals.problem import keypoint_covariances
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
    """A problem and the pose stage's result."""
    rng = np.random.default_rng(seed)
    options = make_options(**settings)
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
    return problem, adjust_pose(problem)


def weights_of(problem, estimate):
    """Weights of keypoints and box edges at the pose stage's result, and the keypoints' covariances."""
    pose = estimate.camera_T_object
    here = Hypotheses(pose[None, :3, :3], pose[None, :3, 3], estimate.coefficients[None])
    box = problem.energy.box
    box = np.ones(4) if box is None else box.weights(box.residuals(here))[0]
    return estimate.weights, box


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
    weights = term.strategy.weights(squared, term.evidence, visibility, previous=previous, progress=progress)
    box = problem.energy.box
    if box is None:
        return weights, np.ones(4), visibility
    edges = energy_of(problem, weights, np.ones(4), pose, joint=False)._box(pose, coefficients)
    return weights, np.where(box.used, np.exp(-0.5 * edges**2) / (np.exp(-0.5 * edges**2) + box.outlier), 0), visibility


def energy_of(problem, weights, box_weights, camera_T_object, *, joint):
    """The independent energy of a problem."""
    covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
    return Energy(problem, covariances, weights, box_weights, camera_T_object, joint=joint)


def vector(energy, vehicle, values):
    """The graph's values in the parameters of the independent energy."""
    pose, coefficients, offsets = vehicle.read(values)
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
