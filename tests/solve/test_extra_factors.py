"""The caller's own factors: in every solve, in the covariances, in what is reported, for one image as for a track."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares

import fgrecon
from factors import L, O, X, guarded_factor
from fgrecon.core.errors import FactorCallbackError, InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate
from fgrecon.solve.graph.graph import Graph
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.track import reconstruct_track
from tests.cars import CAMERA, observe, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.support import energy_of, half_a_car, problem_of, solve


def distance(metres, sigma, image=0, vehicle=0):
    """|t| - metres, of the car in an image."""
    key = X(vehicle, image)

    def callback(values, _):
        pose = values.atPose3(key)
        t = pose.translation()
        jacobian = np.zeros((1, 6))
        jacobian[0, 3:] = t @ pose.rotation().matrix() / np.linalg.norm(t)
        return np.array([np.linalg.norm(t) - metres]), jacobian

    return guarded_factor("distance", sigma, [key], [6], 1, callback)


def isotropic(size, sigma):
    return gtsam.noiseModel.Isotropic.Sigma(size, sigma)


def prior_on_lambda(target, sigma):
    return gtsam.PriorFactorVector(L(0), np.asarray(target, dtype=np.float64), isotropic(len(target), sigma))


@pytest.fixture(scope="module")
def seen():
    return observe(load_prior("car14"), yaw_pose(0.7), [0.4, -0.8, 0.2, 0.5, -0.3], noise=2.0)


@pytest.mark.parametrize("settings", [{}, {"strategy": "huber"}, {"strategy": "paper"}, {"strategy": "gnc"}], ids=str)
def test_they_are_in_every_solve(settings, monkeypatch):
    """However often the weights change; the paper's solve at the fixed pose has no place for a factor on the pose."""
    problem, start = problem_of(1, **settings)
    graphs = []

    def watched(original):
        def watch(self, *arguments):
            free = self.observations[0].pose_key is not None
            kinds = [next(c for c in type(f).mro() if c.__module__ == "gtsam.gtsam") for f in [*self._own, *self.extra]]
            graphs.append((free, kinds))
            return original(self, *arguments)

        return watch

    for name in ("build", "step"):
        monkeypatch.setattr(Graph, name, watched(getattr(Graph, name)))
    pose = gtsam.PriorFactorPose3(X(0, 0), gtsam.Pose3(start.camera_T_object), isotropic(6, 0.1))
    solve(problem, start)
    (own,) = {kinds.count(gtsam.PriorFactorVector) for _, kinds in graphs}
    graphs.clear()
    solve(problem, start, [pose, prior_on_lambda(np.zeros(5), 0.5)])
    assert sum(free for free, _ in graphs) > 2
    for free, kinds in graphs:
        assert kinds.count(gtsam.PriorFactorVector) == own + 1
        assert kinds.count(gtsam.PriorFactorPose3) == free


@pytest.mark.parametrize("sigma", [0.5, 0.02])
def test_the_result_is_the_minimum_with_them(sigma):
    """Another solver with the factor's residual added by hand ends there; the tighter, the nearer to what it says."""
    problem, start = problem_of(3)
    plain = solve(problem, start)
    wanted = np.linalg.norm(plain.pose.translation()) + 0.7
    result = solve(problem, start, [distance(wanted, sigma)])
    assert result.failure is None
    energy = energy_of(problem, result.weights, plain.pose.matrix(), joint=True)

    def residual(x):
        away = np.linalg.norm(energy.pose_at(x)[:3, 3]) - wanted
        return np.append(energy.residual(x), away / sigma)

    x = least_squares(
        residual, energy.start(plain.coefficients, plain.offsets), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-13
    ).x
    np.testing.assert_allclose(result.pose.matrix(), energy.pose_at(x), atol=2e-6)
    np.testing.assert_allclose(result.coefficients, energy.split(x)[1], atol=2e-6)
    away = np.linalg.norm(result.pose.translation()) - wanted
    assert result.energies["extra"] == pytest.approx(0.5 * (away / sigma) ** 2, rel=1e-6)
    assert abs(away) < 0.6
    assert abs(away) < 0.02 or sigma > 0.1


def test_they_shrink_the_covariances(seen):
    """A prior centred at the result adds its information to the pose's or to lambda's, and moves nothing."""
    plain = reconstruct(seen, CAMERA, ground=1.65)
    information = np.linalg.inv(plain.uncertainty.pose_covariance)
    on_pose = gtsam.PriorFactorPose3(X(0, 0), plain.pose.gtsam, isotropic(6, 0.01))
    tied = reconstruct(seen, CAMERA, ground=1.65, extra_factors=[on_pose])
    np.testing.assert_allclose(tied.camera_T_object, plain.camera_T_object, atol=1e-4)
    expected = np.linalg.inv(information + np.eye(6) / 0.01**2)
    np.testing.assert_allclose(tied.uncertainty.pose_covariance, expected, atol=1e-3 * expected.max())
    assert np.linalg.eigvalsh(tied.uncertainty.pose_covariance).max() <= 0.01**2 * (1 + 1e-6)
    on_shape = prior_on_lambda(plain.shape.coefficients, 0.1)
    tied = reconstruct(seen, CAMERA, ground=1.65, extra_factors=[on_shape])
    information = np.linalg.inv(plain.uncertainty.coefficients_covariance)
    expected = np.linalg.inv(information + np.eye(5) / 0.1**2)
    np.testing.assert_allclose(tied.uncertainty.coefficients_covariance, expected, atol=1e-3 * expected.max())


def test_they_are_reported(seen):
    factor = distance(13.0, 0.2)
    result = reconstruct(seen, CAMERA, extra_factors=[factor])
    away = np.linalg.norm(result.location) - 13.0
    assert result.diagnostics.energies["extra"] == pytest.approx(0.5 * (away / 0.2) ** 2, rel=1e-6)
    for step in result.diagnostics.history:
        if step.stage == "joint":
            off = np.linalg.norm(step.camera_T_object[:3, 3]) - 13.0
            assert step.energies["extra"] == pytest.approx(0.5 * (off / 0.2) ** 2, rel=1e-6, abs=1e-12)
        else:
            assert "extra" not in step.energies
    (reported,) = [factor for factor in result.diagnostics.graph if factor.term == "extra"]
    assert reported.variables == ("X(v=0,t=0)",)
    plain = reconstruct(seen, CAMERA)
    assert "extra" not in plain.diagnostics.energies
    assert "extra" not in {factor.term for factor in plain.diagnostics.graph}


def test_they_decide_between_proposals():
    """A gyro that says the car points the other way: the proposal that the keypoints like less wins."""
    problem, start = half_a_car()
    plain = solve(problem, start)
    other = start.alternatives[0]
    close = replace(start, alternatives=(replace(other, excess=5.0),))
    turned = gtsam.PoseRotationPrior3D(X(0, 0), gtsam.Rot3(other.camera_T_object[:3, :3]), isotropic(3, 0.05))
    decided = solve(problem, close, [turned])
    assert np.abs(plain.pose.matrix()[:3, 0] - other.camera_T_object[:3, 0]).max() > 0.3
    np.testing.assert_allclose(decided.pose.matrix()[:3, 0], other.camera_T_object[:3, 0], atol=0.2)
    assert decided.energies["extra"] < 20.0
    # A vague one that says the car points as it is thought to: the other proposal is so much worse.
    problem, start = problem_of(0)
    plain, close = solve(problem, start), replace(start, alternatives=(replace(start.alternatives[0], excess=5.0),))
    forward = gtsam.PoseRotationPrior3D(X(0, 0), plain.pose.rotation(), isotropic(3, 0.8))
    (free,), (tied,) = (solve(problem, close, extra).alternatives[:1] for extra in ((), [forward]))
    assert tied.excess > free.excess + 1.0


@pytest.mark.parametrize(
    ("factor", "name"),
    [
        (distance(10.0, 1.0, image=1), "X(v=0,t=1)"),
        (gtsam.PriorFactorVector(L(3), np.zeros(5), isotropic(5, 1.0)), "L(v=3)"),
        (gtsam.PriorFactorVector(O(0), np.zeros(42), isotropic(42, 1.0)), "O(v=0)"),
    ],
    ids=["pose", "lambda", "offsets"],
)
def test_an_unknown_variable_is_refused_by_name(seen, factor, name):
    options = make_options(free_offsets=False)
    with pytest.raises(InvalidInputError) as caught:
        reconstruct(seen, CAMERA, options=options, extra_factors=[distance(10.0, 1.0), factor])
    assert caught.value.field == "extra_factors"
    assert name in str(caught.value)
    assert "X(v=0,t=0)" in caught.value.fix
    with pytest.raises(InvalidInputError, match="extra_factors"):
        reconstruct_track([seen], CAMERA, options=options, extra_factors=[factor])


@pytest.mark.parametrize(
    "factor",
    [
        gtsam.PriorFactorPose3(L(0), gtsam.Pose3(), isotropic(6, 1.0)),
        gtsam.PriorFactorVector(L(0), np.zeros(2), isotropic(2, 1.0)),
    ],
    ids=["type", "size"],
)
def test_a_factor_of_another_type_than_its_variable_is_refused(seen, factor):
    with pytest.raises(InvalidInputError, match=r"^extra_factors\[1\]: got PriorFactor.* on L\(v=0\)"):
        reconstruct(seen, CAMERA, extra_factors=[distance(10.0, 1.0), factor])


def test_offsets_can_be_meant():
    prior = load_prior("car14")
    seen = observe(prior, yaw_pose(0.7), noise=2.0)
    wanted = np.zeros(42)
    wanted[7] = 0.05
    factor = gtsam.PriorFactorVector(O(0), wanted, isotropic(42, 1e-4))
    result = reconstruct(seen, CAMERA, options=make_options(free_offsets=True), extra_factors=[factor])
    np.testing.assert_allclose(result.shape.offsets.ravel(), wanted, atol=1e-3)


@pytest.mark.filterwarnings("ignore::fgrecon.core.errors.ContradictoryInputWarning")
def test_at_a_fixed_pose_those_on_it_are_refused(seen):
    options = make_options(joint=False)
    plain = reconstruct(seen, CAMERA, options=options)
    with pytest.raises(InvalidInputError, match=r"X\(v=0,t=0\). The graph has L"):
        reconstruct(seen, CAMERA, options=options, extra_factors=[distance(30.0, 1e-3)])
    target = plain.shape.coefficients + 1.0
    on_shape = reconstruct(seen, CAMERA, options=options, extra_factors=[prior_on_lambda(target, 1e-3)])
    np.testing.assert_array_equal(on_shape.camera_T_object, plain.camera_T_object)
    np.testing.assert_allclose(on_shape.shape.coefficients, target, atol=1e-3)
    assert on_shape.diagnostics.energies["extra"] > 0.0


def test_a_broken_one_is_named(seen):
    broken = guarded_factor("my own", 1.0, [X(0, 0)], [6], 1, lambda *_: (np.zeros(2), np.zeros((1, 6))))
    with pytest.raises(FactorCallbackError, match="my own"):
        reconstruct(seen, CAMERA, extra_factors=[broken])


def test_none_changes_nothing(seen):
    one, other = (reconstruct(seen, CAMERA, extra_factors=extra) for extra in ((), []))
    assert one.camera_T_object.tobytes() == other.camera_T_object.tobytes()


@pytest.fixture(scope="module")
def drive():
    """A car in three of four images."""
    prior = load_prior("car14")
    poses = [yaw_pose(-2.3 + 0.3 * t, (-3.0 + 1.5 * t, 1.65, 15.0 - t)) for t in range(3)]
    seen = [observe(prior, pose, [0.4, -0.8, 0.2, 0.5, -0.3], noise=3.0, seed=t) for t, pose in enumerate(poses)]
    return poses, [seen[0], None, seen[1], seen[2]]


def test_a_track_has_them_by_the_place_in_the_list(drive):
    _, seen = drive
    plain = reconstruct_track(seen, CAMERA)
    wanted = np.linalg.norm(plain.frames[1].location) + 0.5
    tied = reconstruct_track(seen, CAMERA, extra_factors=[distance(wanted, 0.01, image=2)])
    assert tied.numbers == (0, 2, 3)
    assert np.linalg.norm(tied.frames[1].location) == pytest.approx(wanted, abs=0.01)
    away = np.linalg.norm(tied.frames[1].location) - wanted
    assert tied.energies["extra"] == pytest.approx(0.5 * (away / 0.01) ** 2, rel=1e-6)
    assert all("extra" in step.energies for step in tied.history)
    assert all("extra" not in frame.diagnostics.energies for frame in tied.frames)  # it belongs to the whole
    assert [factor.variables for factor in tied.graph if factor.term == "extra"] == [("X(v=0,t=2)",)]
    with pytest.raises(InvalidInputError, match=r"X\(v=0,t=1\)"):  # an image without the car
        reconstruct_track(seen, CAMERA, extra_factors=[distance(wanted, 0.01, image=1)])


def test_they_shrink_the_covariances_of_a_track(drive):
    """That of the pose which a factor is about, along the line of sight."""
    _, seen = drive
    plain = reconstruct_track(seen, CAMERA)
    measured = distance(np.linalg.norm(plain.frames[1].location), 0.01, image=2)
    tied = reconstruct_track(seen, CAMERA, extra_factors=[measured])
    spread = []
    for frame in (*plain.frames, *tied.frames):
        ray = frame.camera_T_object[:3, :3].T @ frame.location / np.linalg.norm(frame.location)
        spread.append(np.sqrt(ray @ frame.uncertainty.pose_covariance[3:, 3:] @ ray))
    assert min(spread[:3]) > 0.1
    assert spread[4] < 0.011
    assert min(spread[3], spread[5]) > 0.05


def test_odometry_between_the_images_of_a_track(drive):
    """Known motion between two images: the poses keep to it, which they do not without."""
    poses, seen = drive
    truth = [gtsam.Pose3(pose) for pose in poses]
    moves = [
        gtsam.BetweenFactorPose3(X(0, a), X(0, b), truth[i].between(truth[i + 1]), isotropic(6, 1e-3))
        for i, (a, b) in enumerate([(0, 2), (2, 3)])
    ]
    plain, tied = (reconstruct_track(seen, CAMERA, extra_factors=extra) for extra in ((), moves))
    misses = []
    for track in (plain, tied):
        met = [track.frames[i].pose.gtsam.between(track.frames[i + 1].pose.gtsam) for i in range(2)]
        known = [truth[i].between(truth[i + 1]) for i in range(2)]
        misses.append([np.linalg.norm(a.localCoordinates(b)) for a, b in zip(known, met, strict=True)])
    assert min(misses[0]) > 0.05
    assert max(misses[1]) < 0.01


def test_the_same_in_a_track_of_one_image(seen):
    factor = distance(13.0, 0.2)
    alone = fgrecon.reconstruct(seen, CAMERA, extra_factors=[factor])
    track = fgrecon.reconstruct_track([seen], CAMERA, extra_factors=[factor])
    np.testing.assert_allclose(track.frames[0].camera_T_object, alone.camera_T_object, atol=1e-9)
    assert track.energies == pytest.approx(alone.diagnostics.energies, abs=1e-9)


def test_a_jacobian_that_does_not_fit_the_variables_is_refused(seen):
    """GTSAM would compute something: `dims` says what the callback returns, and here not what the variable has."""
    seven = guarded_factor("seven", 1.0, [X(0, 0)], [7], 1, lambda *_: (np.zeros(1), np.ones((1, 7))))
    with pytest.raises(
        InvalidInputError, match=r"^extra_factors\[1\]: got a Jacobian of 7 columns.* 6: X\(v=0,t=0\) 6\."
    ):
        reconstruct(seen, CAMERA, extra_factors=[distance(10.0, 1.0), seven])


@pytest.fixture(scope="module")
def street():
    """Two cars of an image."""
    prior = load_prior("car14")
    return [observe(prior, yaw_pose(yaw, (x, 1.65, 15.0)), noise=2.0) for yaw, x in ((0.7, -3.0), (-2.3, 3.0))]


def test_a_scene_has_their_energies_with_the_vehicles_that_they_are_on(street):
    apart = gtsam.BetweenFactorPose3(X(0, 0), X(1, 0), gtsam.Pose3(), isotropic(6, 100.0))
    scene = fgrecon.reconstruct_scene(street, CAMERA, extra_factors=[distance(15.0, 0.1), apart])
    poses = [gtsam.Pose3(one.camera_T_object) for one in scene.vehicles]
    values = gtsam.Values()
    for number, pose in enumerate(poses):
        values.insert(X(number, 0), pose)
    both, first = apart.error(values), distance(15.0, 0.1).error(values)
    energies = [one.diagnostics.energies["extra"] for one in scene.vehicles]
    np.testing.assert_allclose(energies, [both + first, both], rtol=1e-9)


def impossible(_values, _):
    return np.array([np.inf]), np.zeros((1, 6))


@pytest.mark.parametrize(
    "factor",
    [
        guarded_factor("never", 0.1, [X(0, 0)], [6], 1, impossible, allow_infinite=True),
        distance(60.0, 0.1),
    ],
    ids=["no energy", "another place"],
)
def test_vehicles_of_a_scene_whose_factors_have_no_solution_are_weak_without_them(factor):
    prior, places = load_prior("car14"), ((5, (4.0, 1.65, 25.0)), (6, (-3.0, 1.65, 20.0)))
    rngs = [(np.random.default_rng(seed), place) for seed, place in places]
    two = [simulate(Vehicle.sample(prior, rng), KITTI_CAMERA, yaw_pose(1.9, place), rng)[0] for rng, place in rngs]
    plain = fgrecon.reconstruct_scene(two, KITTI_CAMERA)
    scene = fgrecon.reconstruct_scene(two, KITTI_CAMERA, extra_factors=[factor])
    assert [one.status.value for one in plain.vehicles] == ["converged", "converged"]
    assert [one.status.value for one in scene.vehicles] == ["weak", "converged"]
    assert any("extra_factors" in reason for reason in scene.vehicles[0].reasons)


def test_all_that_is_on_a_refused_vehicle_is_left_out(street):
    factor = guarded_factor("o", 1.0, [O(1)], [42], 1, lambda *_: (np.zeros(1), np.zeros((1, 42))))
    scene = fgrecon.reconstruct_scene([street[0], np.full((14, 2), np.nan)], CAMERA, extra_factors=[factor])
    assert (scene.numbers, scene.vehicles[0].status.value) == ((0,), "converged")


@pytest.mark.parametrize("made", [None, distance(10.0, 1.0), [3]], ids=["None", "a factor", "numbers"])
def test_what_a_tracker_gets_is_a_sequence_of_factors(made, drive):
    tracker = fgrecon.Tracker(motion_factors=lambda *_: made)
    tracker.update(0.0, {7: drive[1][0]}, camera=CAMERA)
    tracker.update(0.1, {7: drive[1][2]}, camera=CAMERA)
    assert tracker.refused[7].field.startswith("motion_factors")
