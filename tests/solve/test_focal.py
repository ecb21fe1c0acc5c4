"""A focal length that nobody knows is found with the vehicles, and how sure it is is honest."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.focal import candidates, starts
from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes
from tests.cars import CAMERA, observe
from tests.solve.test_scene import street

KNOWN = Camera.of(CAMERA)


def near(seed, count):
    """Cars that are near enough for their perspective to tell."""
    rng = np.random.default_rng(seed)
    prior = load_prior("car14").for_fleet(fgrecon.SIZE_PRIORS["kitti"])
    poses = []
    for _ in range(count):
        yaw = rng.uniform(-np.pi, np.pi)
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
        pose[:3, 3] = [rng.uniform(-2, 2), 1.65, rng.uniform(6.5, 9)]
        poses.append(pose)
    return poses, [
        observe(prior, pose, 0.5 * rng.normal(size=5), noise=1.0, seed=seed + i) for i, pose in enumerate(poses)
    ]


def unknown(seed=0):
    """The camera with a focal length that is off as the prior says."""
    return replace(KNOWN.scaled(np.exp(0.5 * np.random.default_rng(seed).normal())), focal_sigma=0.5)


def error(scene):
    return float(np.log(scene.camera.matrix[0, 0] / KNOWN.matrix[0, 0]))


def test_near_cars_tell_the_focal_length():
    errors = []
    for seed in range(6):
        scene = reconstruct_scene(near(10 * seed, 3)[1], unknown(seed), size_prior="kitti")
        assert scene.camera.focal_sigma < 0.3  # 0.5 was given
        assert abs(error(scene)) < 3.0 * scene.camera.focal_sigma
        assert scene.focal_lengths[0] == (pytest.approx(scene.camera.matrix[0, 0]), 0.0)
        errors.append(error(scene))
    assert np.sqrt(np.mean(np.square(errors))) < 0.25


def test_rotations_are_nearly_those_with_the_known_camera():
    turns = {"unknown": [], "known": []}
    for seed in range(8):
        (pose,), seen = near(100 + 10 * seed, 1)
        for name, camera in (("unknown", unknown(seed)), ("known", KNOWN)):
            found = reconstruct_scene(seen, camera, size_prior="kitti").vehicles[0].camera_T_object
            turns[name].append(np.arccos(np.clip((np.trace(found[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1)))
    assert np.median(turns["unknown"]) < 1.5 * np.median(turns["known"]) + np.radians(0.5)


def test_the_95_percent_region_holds():
    """Far cars in the street: little is given, and that is said."""
    away, squared = [], []
    for seed in range(20):
        poses, seen = street(50 * seed + 3, count=2)
        scene = reconstruct_scene(seen, unknown(seed), size_prior="kitti")
        away.append(abs(error(scene)) / scene.camera.focal_sigma)
        assert 0.05 < scene.camera.focal_sigma <= 0.5
        for number, car in zip(scene.numbers, scene.vehicles, strict=True):
            off = car.camera_T_object[:3, :3].T @ (car.location - poses[number][:3, 3])
            squared.append(off @ np.linalg.solve(car.uncertainty.pose_covariance[3:, 3:], off))
    assert np.mean(np.array(away) < 1.96) >= 0.9
    assert np.mean(np.array(away) < 1.0) <= 0.95
    assert len(squared) == 40
    assert np.mean(np.array(squared) < 7.81) >= 0.9  # of the positions, within the region of 95 %


def test_a_ground_at_a_known_height_tells_more():
    seen = street(4, count=4)[1]
    alone = reconstruct_scene(seen, unknown(1), size_prior="kitti")
    grounded = reconstruct_scene(seen, unknown(1), size_prior="kitti", ground=1.65)
    assert grounded.camera.focal_sigma < alone.camera.focal_sigma
    assert "the ground and the focal length" in grounded.message
    assert "focal length" in repr(grounded)


def test_the_uncertainty_is_in_the_poses():
    seen = near(0, 1)[1]
    known, found = (reconstruct_scene(seen, camera, size_prior="kitti").vehicles[0] for camera in (KNOWN, unknown(0)))
    assert np.trace(found.uncertainty.pose_covariance[3:, 3:]) > np.trace(known.uncertainty.pose_covariance[3:, 3:])


def test_the_status_says_how_far_the_focal_length_is_known():
    def solved(seen, camera):
        scene = reconstruct_scene(seen, camera, size_prior="kitti")
        return scene.camera.focal_sigma, {car.status for car in scene.vehicles}, scene.vehicles

    far, close = street(4, count=3)[1][-1:], near(0, 3)[1]
    sigma, status, (car,) = solved(far, unknown())
    assert sigma > 0.3
    assert status == {Status.AMBIGUOUS}
    assert car.message == f"The focal length is known to {100 * sigma:.0f} % only, and distances no better."
    assert car.reasons[-1].startswith("the focal length")
    sigma, status, _ = solved(close, unknown())
    assert 0.1 < sigma < 0.3
    assert status == {Status.WEAK}
    for camera in (replace(KNOWN, focal_sigma=0.05), KNOWN):  # by EXIF data, or by a calibration
        sigma, status, cars = solved(close, camera)
        assert sigma <= 0.05
        assert status == {Status.CONVERGED}
        assert not any(car.reasons for car in cars)


def test_a_known_camera_is_left_alone():
    scene = reconstruct_scene(near(0, 2)[1], KNOWN)
    assert scene.focal_lengths == ()
    assert scene.camera is KNOWN
    assert candidates(KNOWN) == [KNOWN]


def test_where_nothing_can_be_solved_nothing_is_said_of_the_camera():
    nothing = Observation(np.full((14, 2), np.nan), np.zeros(14))
    camera = unknown()
    scene = reconstruct_scene([nothing], camera)
    assert (scene.vehicles, scene.camera, list(scene.refused)) == ((), camera, [0])


def test_a_distorted_lens_needs_its_focal_length():
    camera = replace(KNOWN, distortion=np.array([0.1, 0.0, 0.0, 0.0]), focal_sigma=0.5)
    with pytest.raises(InvalidInputError, match="distortion"):
        reconstruct_scene([], camera)


def test_one_vehicle_alone_is_sent_to_the_scene():
    with pytest.raises(InvalidInputError, match="reconstruct_scene"):
        fgrecon.reconstruct(near(0, 1)[1][0], unknown())


@pytest.mark.parametrize("sigma", [-0.1, 2.5, np.nan])
def test_a_spread_that_is_none_is_refused(sigma):
    with pytest.raises(InvalidInputError, match="focal_sigma"):
        replace(KNOWN, focal_sigma=sigma)


def test_starts_are_the_low_minima():
    assert starts([3.0, 1.0, 2.0, 1.5, 4.0]) == [1, 3]
    assert starts([3.0, 1.0, 2.0, 9.0, 8.0]) == [1]
    assert starts([1.0]) == [0]
    assert starts([np.inf, np.inf]) == []
    assert starts([2.0, 2.0, 2.0]) == [2]


def test_images_of_one_camera_tell_its_focal_length_together():
    """Each image has two cars: together they are surer than the best of them, and right."""
    images = [near(seed, 2)[1] for seed in range(20, 24)]
    true = KNOWN.matrix[0, 0]
    unknown = replace(KNOWN.scaled(1.4), focal_sigma=0.5)
    alone = [reconstruct_scene(one, unknown, size_prior="kitti") for one in images]
    together = reconstruct_scenes(images, unknown, size_prior="kitti")
    assert [len(scene.vehicles) for scene in together] == [2, 2, 2, 2]
    (focal,) = {scene.camera.matrix[0, 0] for scene in together}
    sigma = together[0].camera.focal_sigma
    assert sigma < min(scene.camera.focal_sigma for scene in alone)
    assert abs(np.log(focal / true)) < 3.0 * sigma
    assert abs(np.log(focal / true)) < max(abs(np.log(scene.camera.matrix[0, 0] / true)) for scene in alone)
    assert all("as were 6 of other images" in scene.message for scene in together)


def test_one_image_is_a_scene_and_a_known_camera_ties_nothing():
    seen = near(30, 2)[1]
    for camera in (replace(KNOWN, focal_sigma=0.5), KNOWN):
        single = reconstruct_scene(seen, camera, ground=1.65)
        for other in reconstruct_scenes([seen] if camera.focal_sigma else [seen, seen], camera, ground=1.65):
            poses = [one.camera_T_object for one in other.vehicles]
            np.testing.assert_array_equal(poses, [one.camera_T_object for one in single.vehicles])
            assert other.camera.matrix[0, 0] == single.camera.matrix[0, 0]
