"""The pose stage as a whole: strategies, starts, alternatives, history, and what it refuses."""

import numpy as np
import pytest

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.robust import StrategyName
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.aspnp import aspnp
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.vehicle.model import prepare
from tests.cars import CAMERA, observe, rotation_angle, yaw_pose
from tests.settings import options as make_options

GROUND = Ground.level(1.65)


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def adjust(prior, observation, *, ground=None, initial=None, size=None, **options):
    problem = Problem.of(observation, CAMERA, prepare(prior, size), ground, make_options(**options))
    return search_pose(problem, initial)


@pytest.mark.parametrize("strategy", StrategyName)
@pytest.mark.parametrize("degrees", [-100, -30, 15, 80, 160])
def test_every_strategy_finds_exact_cars(prior, strategy, degrees):
    """The printed form of the paper's Eq. 5 as well, as long as no point is wrong."""
    truth = yaw_pose(np.radians(degrees))
    estimate = adjust(prior, observe(prior, truth), strategy=strategy.value)
    assert np.degrees(rotation_angle(estimate.camera_T_object, truth)) < 3.5
    assert np.linalg.norm(estimate.camera_T_object[:3, 3] - truth[:3, 3]) < 0.3
    assert np.isfinite(estimate.energy)


@pytest.mark.parametrize("strategy", ["mixture", "gnc", "paper"])
def test_weights_tell_wrong_points(prior, strategy):
    observation = observe(prior, yaw_pose(0.9))
    sure = np.flatnonzero(observation.confidence > 0.5)
    wrong = sure[[0, 3]]
    pixels = observation.keypoints.copy()
    pixels[wrong] += [[60.0, -40.0], [-70.0, 30.0]]
    estimate = adjust(prior, Observation(pixels, observation.confidence, observation.box), strategy=strategy)
    assert estimate.weights[wrong].max() < estimate.weights[np.setdiff1d(sure, wrong)].min()


def test_energy_is_that_of_the_problem(prior):
    observation = observe(prior, yaw_pose(0.4), noise=3.0)
    size, model = SIZE_PRIORS["kitti"], prepare(prior, SIZE_PRIORS["kitti"])
    estimate = adjust(prior, observation, ground=GROUND, size=size)
    pose = estimate.camera_T_object
    one = Hypotheses(pose[None, :3, :3], pose[None, :3, 3], estimate.coefficients[None])
    problem = Problem.of(observation, CAMERA, model, GROUND, Options()).energy
    total, weights = problem.evaluate(one)
    assert estimate.energy == pytest.approx(total.energy[0])
    np.testing.assert_allclose(estimate.weights, weights[0])
    np.testing.assert_allclose(estimate.visibility, model.visibility.lookup(pose))


def test_alternatives_are_distinct_and_worse(prior):
    """Wheels and roof corners of one side, all as likely right as wrong, leave open which way the car faces."""
    observation = observe(prior, yaw_pose(np.radians(45)))
    pixels = observation.keypoints.copy()
    pixels[np.setdiff1d(np.arange(14), [0, 2, 10, 12])] = np.nan
    estimate = adjust(prior, Observation(pixels, np.full(14, 0.3), observation.box))
    assert estimate.alternatives
    excess = [alternative.excess for alternative in estimate.alternatives]
    assert excess == sorted(excess)
    poses = [estimate.camera_T_object, *(a.camera_T_object for a in estimate.alternatives)]
    for i, a in enumerate(poses):
        for b in poses[:i]:
            assert np.degrees(rotation_angle(a, b)) > 20
    assert all(e >= 0 for e in excess)


def test_history_starts_at_a_start_and_ends_at_the_result(prior):
    estimate = adjust(prior, observe(prior, yaw_pose(0.4), noise=3.0), ground=GROUND)
    stages = [iteration.stage for iteration in estimate.history]
    assert stages[0] == "initialisation"
    assert set(stages[1:]) == {"pose"}
    last = estimate.history[-1]
    np.testing.assert_array_equal(last.camera_T_object, estimate.camera_T_object)
    np.testing.assert_array_equal(last.coefficients, estimate.coefficients)
    assert sum(last.energies.values()) == pytest.approx(estimate.energy)
    totals = [sum(iteration.energies.values()) for iteration in estimate.history]
    assert totals == sorted(totals, reverse=True)
    np.testing.assert_allclose(last.keypoints, prior.keypoints(estimate.coefficients))
    in_camera = last.keypoints @ last.camera_T_object[:3, :3].T + last.camera_T_object[:3, 3]
    np.testing.assert_allclose(last.projections, CAMERA.project(in_camera))


def test_history_is_optional_and_changes_nothing(prior):
    observation = observe(prior, yaw_pose(0.4), noise=3.0)
    for strategy in ("mixture", "paper"):
        with_history = adjust(prior, observation, strategy=strategy)
        without = adjust(prior, observation, strategy=strategy, keep_history=False)
        assert without.history == ()
        assert with_history.camera_T_object.tobytes() == without.camera_T_object.tobytes()


def test_a_guess_is_trusted(prior):
    """A guess keeps the search on its side, even where the keypoints speak for the other."""
    truth = yaw_pose(np.radians(70))
    observation = observe(prior, truth, noise=2.0)
    near = adjust(prior, observation, initial=float(np.radians(70 + 40)))
    assert np.degrees(rotation_angle(near.camera_T_object, truth)) < 5
    away = adjust(prior, observation, initial=float(np.radians(70 - 180)))
    assert np.degrees(rotation_angle(away.camera_T_object, truth)) > 60
    assert away.energy > near.energy


@pytest.mark.parametrize("degrees", [90, 150, 180, -120])
def test_pnp_is_a_start(prior, degrees):
    """With a single start azimuth, far from the truth, the pose is still found: from a minimum of ASPnP."""
    truth = yaw_pose(np.radians(degrees))
    honest = observe(prior, truth, noise=1.0)
    confidence = np.where(honest.confidence > 0.5, np.linspace(0.2, 0.95, 14), 0.02)
    observation = Observation(honest.keypoints, confidence, honest.box)
    estimate = adjust(prior, observation, azimuths=1)
    assert np.degrees(rotation_angle(estimate.camera_T_object, truth)) < 5
    evidence = Problem.of(observation, CAMERA, prepare(prior), None, Options()).energy.keypoints.evidence
    used = np.flatnonzero(evidence.right > 0.3)
    found = aspnp(prior.mean[used], CAMERA.rays(observation.keypoints[used])[:, :2], evidence.right[used])
    starts = [solution.camera_T_object for solution in found]
    assert any(np.allclose(estimate.history[0].camera_T_object, start, atol=1e-9) for start in starts)


def test_a_3d_box_is_one_more_start(prior):
    """It never makes the result worse, and is found where the search is given nothing else to go by."""
    truth = yaw_pose(np.radians(170))
    observation = observe(prior, truth, noise=2.0)
    box = Box3D(np.array(truth[:3, 3]), np.radians(165), np.array([4.5, 1.8, 1.6]))
    with_box, without = (adjust(prior, observation, initial=initial) for initial in (box, None))
    assert with_box.energy <= without.energy + 0.05
    unsure = Observation(observation.keypoints, np.full(14, 0.1), observation.box)  # ASPnP takes surer points alone
    with_box, without = (adjust(prior, unsure, initial=initial, azimuths=1) for initial in (box, None))
    np.testing.assert_allclose(with_box.history[0].camera_T_object[:3, 3], box.location)
    assert np.degrees(rotation_angle(with_box.camera_T_object, truth)) < 6
    assert np.degrees(rotation_angle(without.camera_T_object, truth)) > 60
    assert with_box.energy < without.energy


def test_three_points_are_enough(prior):
    observation = observe(prior, yaw_pose(0.7))
    pixels = observation.keypoints.copy()
    pixels[np.setdiff1d(np.arange(14), [0, 2, 10])] = np.nan
    estimate = adjust(prior, Observation(pixels, observation.confidence, observation.box), ground=GROUND)
    assert np.degrees(rotation_angle(estimate.camera_T_object, yaw_pose(0.7))) < 5
    np.testing.assert_allclose(estimate.camera_T_object[:3, 3], yaw_pose(0.7)[:3, 3], atol=0.5)
    assert (estimate.weights[np.isnan(pixels[:, 0])] == 0).all()


def line():
    return np.column_stack([np.linspace(0, 100, 14), np.linspace(30, 80, 14)])


def gaps(count):
    pixels = np.random.default_rng(0).uniform(0, 300, (14, 2))
    pixels[count:] = np.nan
    return pixels


@pytest.mark.parametrize(
    ("field", "pixels", "confidence"),
    [
        ("keypoints", gaps(0), np.ones(14)),
        ("keypoints", gaps(2), np.ones(14)),
        ("confidence", gaps(14), np.zeros(14)),
        ("keypoints", gaps(14), np.eye(14)[0]),
        ("keypoints", line(), np.ones(14)),
        ("keypoints", np.full((14, 2), 50.0), np.ones(14)),
        ("keypoints", np.where(np.arange(14)[:, None] < 7, [10.0, 10.0], [90.0, 40.0]), np.ones(14)),
    ],
    ids=["none", "two", "no weight", "one with weight", "line", "one place", "two places"],
)
def test_what_determines_no_pose_is_refused(field, pixels, confidence):
    with pytest.raises(DegenerateProblemError) as caught:
        adjust(load_prior("car14"), Observation(pixels, confidence))
    assert caught.value.field == field
    assert caught.value.fix
