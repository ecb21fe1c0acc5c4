"""Covariances against the inverse of a numeric Gauss-Newton matrix of the independent energy."""

import gtsam
import numpy as np
import pytest

from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import adjust_shape
from fgrecon.solve.graph.covariance import covariances
from fgrecon.solve.graph.graph import VehicleGraph, build
from fgrecon.solve.pipeline import reconstruct
from tests.solve.graph.support import energy_of, problem_of, unsymmetric, vector

SCENES = {
    "symmetric": {},
    "covariances": {"covariance": True},
    "no ground": {"ground": False, "size": False, "box_model": "off"},
    "offsets": {"free_offsets": True},
    "unsymmetric": {"prior": unsymmetric(load_prior("car14"))},
    "penalty": {"plane_penalty": 0.7},
    "one vector": {"basis_vectors": 1},
    "no vector": {"basis_vectors": 0},
}


def at_result(seed=3, **settings):
    problem, start = problem_of(seed, **settings)
    result = adjust_shape(problem, start)
    vehicle = VehicleGraph(problem, result.pose, pose_free=True)
    values = vehicle.values(result.pose, result.coefficients, result.offsets)
    graph = build(vehicle.terms(result.weights, result.box_weights))
    return problem, result, vehicle, graph, values


@pytest.mark.parametrize("settings", SCENES.values(), ids=SCENES)
def test_the_inverse_of_the_gauss_newton_matrix(settings):
    problem, result, vehicle, graph, values = at_result(**settings)
    found = covariances(vehicle, graph, values)
    energy = energy_of(problem, result.weights, result.box_weights, result.pose.matrix(), joint=True)
    jacobian = energy.jacobian(vector(energy, vehicle, values))
    whole = np.linalg.inv(jacobian.T @ jacobian)
    count = problem.model.prior.dimension

    def same(actual, expected):
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-5 * max(np.abs(expected).max(initial=0.0), 1e-9))

    same(found.pose, whole[:6, :6])
    same(found.coefficients, whole[6 : 6 + count, 6 : 6 + count])
    variables = whole[6:, 6:]
    for k in range(14):
        derivative = np.zeros((3, len(variables)))
        derivative[:, :count] = problem.model.prior.basis[:, k].T
        if problem.options.shape.free_offsets:
            derivative[:, count + 3 * k : count + 3 * k + 3] = np.eye(3)
        same(found.keypoints[k], derivative @ variables @ derivative.T)


def test_more_evidence_is_less_uncertainty():
    _, result, vehicle, graph, values = at_result()
    sure = covariances(vehicle, graph, values)
    weaker = covariances(vehicle, build(vehicle.terms(0.25 * result.weights, 0.25 * result.box_weights)), values)
    assert (np.linalg.eigvalsh(weaker.pose - sure.pose) > -1e-12).all()
    assert (np.linalg.eigvalsh(weaker.coefficients - sure.coefficients) > -1e-12).all()
    assert np.linalg.eigvalsh(sure.coefficients).max() <= 1.0 + 1e-9  # never beyond the prior


def test_the_pose_of_no_keypoint_is_undetermined():
    _, _, vehicle, _, values = at_result(ground=False, size=False, box_model="off")
    assert covariances(vehicle, build(vehicle.terms(np.zeros(14), np.zeros(4))), values) is None


def test_the_frame_is_the_objects_own():
    """Far away the position is least sure along the viewing ray: the object-frame covariance, turned, says so."""
    _, result, vehicle, graph, values = at_result(ground=False, size=False, box_model="off", yaw=1.1)
    found = covariances(vehicle, graph, values)
    R = result.pose.rotation().matrix()
    worst = np.linalg.eigh(R @ found.pose[3:, 3:] @ R.T)[1][:, -1]
    ray = result.pose.translation() / np.linalg.norm(result.pose.translation())
    assert abs(worst @ ray) > 0.98


@pytest.mark.parametrize("strategy", ["mixture", "cauchy", "tukey"])
def test_what_is_told_is_that_of_the_weighted_keypoints(strategy):
    """End to end, also where the graph holds an m-estimator: each keypoint counts by its final weight, and once."""
    problem, _ = problem_of(4, strategy=strategy, box_model="off")
    told = reconstruct(
        problem.observation, problem.camera, ground=problem.ground, size_prior="kitti", options=problem.options
    )
    vehicle = VehicleGraph(problem, gtsam.Pose3(told.camera_T_object), pose_free=True)
    values = vehicle.values(gtsam.Pose3(told.camera_T_object), told.coefficients, told.offsets)
    energy = energy_of(problem, told.weights, np.ones(4), told.camera_T_object, joint=True)
    jacobian = energy.jacobian(vector(energy, vehicle, values))
    whole = np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(told.pose_covariance, whole[:6, :6], atol=0.02 * np.abs(whole[:6, :6]).max())
    np.testing.assert_allclose(told.coefficients_covariance, whole[6:11, 6:11], atol=0.02)
