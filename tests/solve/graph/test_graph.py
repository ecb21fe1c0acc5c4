"""The factor graph against the same energy written out independently, and solved by other solvers."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors import L, M, O, P, X
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph import VehicleGraph, build, energies
from fgrecon.solve.graph.solver import minimise
from tests.solve.graph.energy import minimise_by_ceres, minimise_by_scipy
from tests.solve.graph.support import energy_of, problem_of, unsymmetric, vector, weights_of

NO_OFFSETS = np.zeros((14, 3))
PRIOR = load_prior("car14")
SCENES = {
    "symmetric": {},
    "covariances": {"seed": 1, "covariance": True},
    "neither ground nor size": {"seed": 2, "ground": False, "size": False},
    "cuboid": {"seed": 3, "box_model": "cuboid"},
    "no box": {"seed": 4, "box_model": "off"},
    "offsets": {"seed": 5, "free_offsets": True},
    "unsymmetric": {"seed": 6, "prior": unsymmetric(PRIOR)},
    "unsymmetric with offsets": {"seed": 7, "prior": unsymmetric(PRIOR), "free_offsets": True},
    "penalty": {"seed": 8, "plane_penalty": 0.5},
    "unsymmetric with penalty": {"seed": 9, "prior": unsymmetric(PRIOR), "plane_penalty": 1.0},
    "literal Laplacian": {"seed": 10, "literal_laplacian": True},
    "one vector": {"seed": 11, "basis_vectors": 1},
    "few terms": {"seed": 12, "disabled_terms": {"planarity", "laplacian", "dimensions", "box", "ground"}},
}


class Case:
    """Graph and independent energy of one problem at the pose stage's result."""

    def __init__(self, *, joint, **settings):
        self.problem, self.estimate = problem_of(**settings)
        pose = gtsam.Pose3(self.estimate.camera_T_object)
        self.vehicle = VehicleGraph(self.problem, pose, pose_free=joint)
        weights, box_weights = weights_of(self.problem, self.estimate)
        self.terms = self.vehicle.terms(weights, box_weights)
        self.values = self.vehicle.values(pose, self.estimate.coefficients, NO_OFFSETS)
        self.energy = energy_of(self.problem, weights, box_weights, self.estimate.camera_T_object, joint=joint)

    def start(self):
        return self.energy.start(self.estimate.coefficients, NO_OFFSETS)


@pytest.fixture(scope="module", params=[False, True], ids=["shape", "joint"])
def joint(request):
    return request.param


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES)
def case(request, joint):
    return Case(joint=joint, **request.param)


def test_each_term_is_the_independent_one(case):
    mine = energies(case.terms, case.values)
    assert mine.pop("cheirality") == 0.0
    x = vector(case.energy, case.vehicle, case.values)
    theirs = {name: 0.5 * np.sum(term**2) for name, term in case.energy.terms(x).items()}
    assert set(mine) == {name for name, term in case.energy.terms(x).items() if len(term)}
    for name, value in mine.items():
        assert value == pytest.approx(theirs[name], rel=1e-9, abs=1e-12)


def test_the_optimum_is_scipys(case):
    found = minimise(build(case.terms), case.values, relative_tolerance=1e-15, max_iterations=100)
    oracle = minimise_by_scipy(case.energy, case.start())
    np.testing.assert_allclose(vector(case.energy, case.vehicle, found.values), oracle, atol=1e-6)
    assert found.error == pytest.approx(case.energy.cost(oracle), abs=1e-6)


@pytest.mark.parametrize("name", ["symmetric", "covariances", "unsymmetric", "penalty", "unsymmetric with offsets"])
def test_the_optimum_is_ceress(name, joint):
    pytest.importorskip("pyceres")
    case = Case(joint=joint, **SCENES[name])
    found = minimise(build(case.terms), case.values, relative_tolerance=1e-15, max_iterations=100)
    oracle = minimise_by_ceres(case.energy, case.start())
    np.testing.assert_allclose(vector(case.energy, case.vehicle, found.values), oracle, atol=1e-6)
    assert found.error == pytest.approx(case.energy.cost(oracle), abs=1e-6)


def variables(case):
    return set(case.values.keys())


def _sigma2(problem):
    return (
        problem.options.keypoints.sigma_relative * problem.observation.extent
    ) ** 2 + problem.options.keypoints.sigma_pixels**2


def test_a_symmetric_prior_needs_neither_symmetry_nor_mirrored_planes():
    """Both vanish for every lambda; the ground-parallel wheels stay, for their direction."""
    case = Case(joint=True, **SCENES["symmetric"])
    assert "symmetry" not in case.terms
    assert len(case.terms["planarity"]) == 2
    assert variables(case) == {X(), L(), P(0, 0)}
    for coefficients in np.random.default_rng(0).normal(size=(5, 5)):
        points = PRIOR.keypoints(coefficients)
        for face in PRIOR.category.faces:
            quad = points[list(face.keypoints)]
            assert np.linalg.svd(quad - quad.mean(axis=0), compute_uv=False)[2] < 1e-6
        np.testing.assert_allclose(points[PRIOR.category.mirror] * [1, 1, -1], points, atol=1e-6)


@pytest.mark.parametrize("name", ["offsets", "unsymmetric", "unsymmetric with offsets"])
def test_other_shapes_need_both(name):
    case = Case(joint=True, **SCENES[name])
    assert len(case.terms["symmetry"]) == 1
    assert len(case.terms["planarity"]) == len(PRIOR.category.faces) + 1
    offsets = {O()} if "offsets" in name else set()
    assert variables(case) == {X(), L(), M(), P(0, 0), P(0, 1), P(0, 2)} | offsets


def test_the_pose_is_a_constant_in_the_shape_stage():
    case = Case(joint=False, **SCENES["symmetric"])
    assert variables(case) == {L(), P(0, 0)}
    assert "ground" not in case.terms
    assert case.vehicle.read(case.values)[0].equals(gtsam.Pose3(case.estimate.camera_T_object), 0.0)


@pytest.mark.parametrize("term", Options.TERMS)
def test_each_term_can_be_left_out(term):
    problem, estimate = problem_of(5, free_offsets=True, disabled_terms={term})
    whole = Case(joint=True, seed=5, free_offsets=True)
    vehicle = VehicleGraph(problem, gtsam.Pose3(estimate.camera_T_object), pose_free=True)
    assert set(whole.terms) - set(vehicle.terms(*weights_of(problem, estimate))) == {term}
    graph = build(vehicle.terms(*weights_of(problem, estimate)))
    used = {key for i in range(graph.size()) for key in list(graph.at(i).keys())}
    values = vehicle.values(gtsam.Pose3(estimate.camera_T_object), estimate.coefficients, NO_OFFSETS)
    assert set(values.keys()) == used  # no variable is left without a factor


def test_every_keypoint_has_its_own_factor_and_weight():
    problem, estimate = problem_of(1)
    vehicle = VehicleGraph(problem, gtsam.Pose3(estimate.camera_T_object), pose_free=True)
    weights, box_weights = weights_of(problem, estimate)
    values = vehicle.values(gtsam.Pose3(estimate.camera_T_object), estimate.coefficients, NO_OFFSETS)
    weights = np.where(np.arange(14) == 4, 0.0, np.linspace(0.1, 1.0, 14))
    factors_ = vehicle.terms(weights, box_weights)["reprojection"]
    assert len(factors_) == 13  # weight zero: no factor
    for factor, weight in zip(factors_, np.delete(weights, 4), strict=True):
        plain = float(np.sum(factor.unwhitenedError(values) ** 2))
        sigma2 = _sigma2(problem)
        assert factor.error(values) == pytest.approx(0.5 * weight * plain / sigma2)


@pytest.mark.parametrize("strategy", ["huber", "cauchy", "geman_mcclure", "tukey"])
def test_m_estimators_stand_in_the_graph(strategy):
    """Each keypoint's energy is its weight times the robust loss of its whitened residual."""

    problem, estimate = problem_of(1, strategy=strategy)
    vehicle = VehicleGraph(problem, gtsam.Pose3(estimate.camera_T_object), pose_free=True)
    values = vehicle.values(gtsam.Pose3(estimate.camera_T_object), estimate.coefficients, NO_OFFSETS)
    weights = np.linspace(0.2, 1.0, 14)
    loss = problem.options.strategy.robust_loss
    sigma2 = _sigma2(problem)
    for factor, weight in zip(vehicle.terms(weights, np.ones(4))["reprojection"], weights, strict=True):
        distance = np.linalg.norm(factor.unwhitenedError(values)) / np.sqrt(sigma2)
        assert factor.error(values) == pytest.approx(weight * loss.losses(distance))


def test_edges_of_no_weight_say_nothing():
    problem, estimate = problem_of(1)
    vehicle = VehicleGraph(problem, gtsam.Pose3(estimate.camera_T_object), pose_free=True)
    values = vehicle.values(gtsam.Pose3(estimate.camera_T_object), estimate.coefficients, NO_OFFSETS)
    some = vehicle.terms(estimate.weights, np.array([1.0, 0.0, 0.5, 1e-9]))["box"][0]
    assert len(some.unwhitenedError(values)) == 2
    assert "box" not in vehicle.terms(estimate.weights, np.zeros(4))


def test_edges_on_the_images_border_say_nothing():
    problem, estimate = problem_of(1)
    box = replace(problem.energy.box, used=np.array([True, False, True, True]))
    cut = replace(problem, energy=replace(problem.energy, box=box))
    pose = gtsam.Pose3(estimate.camera_T_object)
    whole, part = (VehicleGraph(p, pose, pose_free=True) for p in (problem, cut))
    values = whole.values(pose, estimate.coefficients, NO_OFFSETS)
    residuals = [v.terms(estimate.weights, np.ones(4))["box"][0].unwhitenedError(values) for v in (whole, part)]
    np.testing.assert_array_equal(residuals[1], residuals[0][[0, 2, 3]])


def test_values_are_read_back():
    problem, estimate = problem_of(5, free_offsets=True)
    vehicle = VehicleGraph(problem, gtsam.Pose3(estimate.camera_T_object), pose_free=True, vehicle=3, frame=7)
    pose, offsets = gtsam.Pose3(estimate.camera_T_object), np.random.default_rng(0).normal(size=(14, 3)) * 0.02
    values = vehicle.values(pose, estimate.coefficients, offsets)
    back = vehicle.read(values)
    assert back[0].equals(pose, 0.0)
    np.testing.assert_array_equal(back[1], estimate.coefficients)
    np.testing.assert_array_equal(back[2], offsets)
    assert {X(3, 7), L(3), O(3), M(3)} <= set(values.keys())
