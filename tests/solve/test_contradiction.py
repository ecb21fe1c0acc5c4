"""Factors of the caller's own that contradict the images: told whatever the entry; right ones are no worse for it."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import fgrecon
from factors import L, X
from fgrecon.core.errors import ContradictoryInputWarning
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from tests.solve.test_extra_factors import distance

PRIOR = fgrecon.load_prior("car14")
GIVEN = {"ground": 1.65}
SIGMAS = np.array([0.01] * 3 + [0.05] * 3)
CONTRADICT = "factors of yours contradict"


def contradicted(result):
    return any(reason.startswith(CONTRADICT) for reason in result.reasons)


def car_at(pose, rng):
    return simulate(Vehicle.sample(PRIOR, rng), KITTI_CAMERA, pose, rng)[0]


def moves(poses, step):
    """Between images: that the camera has gone so many metres towards a parked car."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    moved = np.eye(4)
    moved[2, 3] = -step
    pairs = enumerate(np.linalg.inv(pose) @ moved @ pose for pose in poses[:-1])
    return [gtsam.BetweenFactorPose3(X(0, t), X(0, t + 1), gtsam.Pose3(move), noise) for t, move in pairs]


@pytest.fixture(scope="module")
def approached():
    """A parked car, 2 m nearer in each of five images."""
    rng = np.random.default_rng(5)
    car = Vehicle.sample(PRIOR, rng)
    poses = [yaw_pose(1.9, np.array([4.0, 1.65, 25.0 - 2.0 * t])) for t in range(5)]
    return poses, [simulate(car, KITTI_CAMERA, pose, rng)[0] for pose in poses]


def test_right_ones_make_no_result_weak():
    """Distances and poses as they are, with noise as it is given, of forty cars."""
    rng = np.random.default_rng(77)
    for _ in range(40):
        pose = yaw_pose(rng.uniform(-np.pi, np.pi), np.array([rng.uniform(-8, 8), 1.65, rng.uniform(10, 40)]))
        seen, metres = car_at(pose, rng), np.linalg.norm(pose[:3, 3])
        noisy = gtsam.Pose3(pose).retract(rng.normal(0.0, SIGMAS))
        known = gtsam.PriorFactorPose3(X(0, 0), noisy, gtsam.noiseModel.Diagonal.Sigmas(SIGMAS))
        for factor in (distance(metres + rng.normal(0.0, 0.1), 0.1), known):
            result = fgrecon.reconstruct(seen, KITTI_CAMERA, extra_factors=[factor], **GIVEN)
            assert not contradicted(result)


@pytest.mark.filterwarnings("ignore::fgrecon.core.errors.ContradictoryInputWarning")
def test_ranges_that_contradict_are_named_and_right_ones_are_not(approached):
    """By a vehicle alone, in a scene, in a track and over time; the distance is to the middle of its 3D box."""
    poses, images = approached
    middle = [float(np.linalg.norm(pose[:3, 3] - [0.0, 0.75, 0.0])) for pose in poses]
    for times, named in ((1.0, False), (0.7, True)):
        given = [
            seen.with_evidence([fgrecon.Range(times * metres, 0.2, to_centre=True)])
            for seen, metres in zip(images, middle, strict=True)
        ]
        if named:
            with pytest.warns(ContradictoryInputWarning, match=r"range of the vehicle contradicts"):
                fgrecon.reconstruct(given[0], KITTI_CAMERA, size_prior="kitti", **GIVEN)
        tracker = fgrecon.Tracker(size_prior="kitti")
        online = [tracker.update(0.1 * t, {0: one}, camera=KITTI_CAMERA, **GIVEN)[0] for t, one in enumerate(given)]
        found = [
            fgrecon.reconstruct(given[0], KITTI_CAMERA, size_prior="kitti", **GIVEN),
            fgrecon.reconstruct_scene(given[:1], KITTI_CAMERA, size_prior="kitti", **GIVEN).vehicles[0],
            *fgrecon.reconstruct_track(given, KITTI_CAMERA, size_prior="kitti", **GIVEN).frames,
            online[0].reconstruction,
        ]
        for one in found:
            assert any(reason.startswith("its range contradicts") for reason in one.reasons) == named, one


@pytest.mark.parametrize("strategy", ["huber", "paper", "gnc"])
def test_other_energies_say_nothing_of_them(strategy):
    """Keypoints that are wrong pull at the pose, and the truth costs as much as a factor that is wrong."""
    rng = np.random.default_rng(2)
    pose = yaw_pose(1.9, np.array([4.0, 1.65, 20.0]))
    known = gtsam.PriorFactorPose3(X(0, 0), gtsam.Pose3(pose), gtsam.noiseModel.Isotropic.Sigma(6, 0.05))
    options = fgrecon.Options(strategy=strategy)
    result = fgrecon.reconstruct(car_at(pose, rng), KITTI_CAMERA, options=options, extra_factors=[known], **GIVEN)
    assert not contradicted(result)


@pytest.mark.parametrize(("metres", "status"), [(25.4, "converged"), (38.0, "weak"), (82.0, "degenerate")])
def test_the_status_names_them(approached, metres, status):
    _, (seen, *_) = approached
    calls = {"size_prior": "kitti", "extra_factors": [distance(metres, 0.1)], **GIVEN}
    if status == "converged":
        assert not contradicted(fgrecon.reconstruct(seen, KITTI_CAMERA, **calls))
        return
    with pytest.warns(ContradictoryInputWarning, match=r"extra_factors"):
        result = fgrecon.reconstruct(seen, KITTI_CAMERA, **calls)
    assert result.status.value == status
    assert contradicted(result)
    assert CONTRADICT in result.message.lower()


@pytest.mark.parametrize("entry", ["track", "tracker"])
@pytest.mark.parametrize("share", [1.0, 2.0, -1.0], ids=["right", "twice", "backwards"])
@pytest.mark.filterwarnings("ignore::fgrecon.core.errors.ContradictoryInputWarning")
def test_a_motion_that_is_another_one_makes_the_images_weak(approached, entry, share):
    poses, seen = approached
    factors = moves(poses, 2.0 * share)
    if entry == "track":
        track = fgrecon.reconstruct_track(seen, KITTI_CAMERA, extra_factors=factors, **GIVEN)
        results = track.frames
        assert track.status.value == ("converged" if share == 1.0 else "weak")
    else:
        tracker = fgrecon.Tracker(motion_factors=lambda one, _other, _seconds, _share: [factors[one]], window=6)
        for t, one in enumerate(seen):
            tracker.update(0.1 * t, {7: one}, camera=KITTI_CAMERA, **GIVEN)
        results = [estimate.reconstruction for estimate in tracker.smooth()[7]]
    assert len(results) >= 4  # a tracker leaves out what it cannot bring together
    assert {contradicted(result) for result in results} == {share != 1.0}


def test_in_a_scene_those_are_weak_that_they_are_on():
    rng = np.random.default_rng(2)
    poses = [yaw_pose(1.9, np.array([x, 1.65, z])) for x, z in ((4.0, 20.0), (-3.0, 15.0), (0.5, 30.0))]
    cars = [car_at(pose, rng) for pose in poses]
    metres = [float(np.linalg.norm(pose[:3, 3])) for pose in poses]
    for wrong in (None, 1):
        factors = [distance(one * (1.5 if v == wrong else 1.0), 0.1, vehicle=v) for v, one in enumerate(metres)]
        scene = fgrecon.reconstruct_scene(cars, KITTI_CAMERA, extra_factors=factors, **GIVEN)
        assert [contradicted(one) for one in scene.vehicles] == [v == wrong for v in range(3)]


def test_who_knows_the_shape_does_not_contradict_the_prior(approached):
    """A shape that hardly a car has, and that the images show."""
    rare = np.array([2.5, -2.5, 2.5, 0.0, 0.0])
    pose = approached[0][0]
    seen = simulate(Vehicle.of_prior(PRIOR, rare), KITTI_CAMERA, pose, np.random.default_rng(1))[0]
    known = gtsam.PriorFactorVector(L(0), rare, gtsam.noiseModel.Isotropic.Sigma(5, 0.01))
    assert not contradicted(fgrecon.reconstruct(seen, KITTI_CAMERA, extra_factors=[known], **GIVEN))
