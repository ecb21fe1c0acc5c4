"""The registry: every method finds an exact pose, is given what its name says, and refuses what it cannot solve."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.solve.vehicle.conditioning import of_fleet
from fgrecon_research.evaluation.methods import METHODS, select
from tests.made_up_track import K, pose_of

BASELINES = ("epnp", "sqpnp", "sqpnp_confident", "poselib_ransac", "aspnp")


def observe(shape, camera, camera_T_object):
    points = shape @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    pixels = camera.distort(camera.project(points))
    box = np.concatenate([pixels.min(0), pixels.max(0)])
    return Observation(pixels, np.linspace(0.4, 0.9, len(pixels)), box)


def test_the_registry_names_every_row():
    expected = [*BASELINES, *(f"{name}+size" for name in BASELINES)]
    assert list(METHODS) == [*expected, "fgrecon", "fgrecon+size", "fgrecon+ground+size"]
    assert all(name == method.name for name, method in METHODS.items())


def test_selection_keeps_the_order_given_and_drops_repetitions():
    assert [m.name for m in select(["sqpnp", "epnp", "sqpnp"])] == ["sqpnp", "epnp"]
    assert select() == tuple(METHODS.values())
    with pytest.raises(InvalidInputError, match="fgrecon\\+ground\\+size"):
        select(["upnp"])


@pytest.mark.parametrize("suffix", ["", "+size"])
@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize("distortion", [None, [-0.2, 0.05, 0.001, -0.001, 0.0]], ids=["pinhole", "distorted"])
def test_baselines_find_an_exact_pose(scene, name, suffix, distortion):
    camera = Camera(K, distortion)
    prior = of_fleet(scene.prior, scene.size) if suffix else scene.prior
    truth = pose_of(1.1, [1.5, 1.65, 12.0])
    estimate = METHODS[name + suffix].bind(scene)(observe(prior.mean, camera, truth), camera)
    assert estimate.camera_T_object == pytest.approx(truth, abs=1e-3)
    assert list(estimate.milliseconds) == ["pose"]


def test_rows_name_their_prior(scene):
    assert METHODS["sqpnp"].prior_name(scene) == "mean shape of car14"
    assert METHODS["sqpnp+size"].prior_name(scene) == "mean shape of car14 of kitti"
    assert METHODS["fgrecon"].prior_name(scene) == "car14"
    assert METHODS["fgrecon+ground+size"].prior_name(scene) == "car14 of kitti"


def test_confident_points_alone_are_used_while_there_are_four(scene):
    camera, truth = Camera(K), pose_of(2.0, [-1.0, 1.65, 9.0])
    exact = observe(scene.prior.mean, camera, truth)
    wrong = exact.keypoints + np.where(np.arange(14)[:, None] % 2, 60.0, 0.0)
    for low in (0.3, 0.0):  # 0.3 is not above 0.3
        confidence = np.where(np.arange(14) % 2, low, 0.5)
        estimate = METHODS["sqpnp_confident"].bind(scene)(Observation(wrong, confidence, exact.box), camera)
        assert estimate.camera_T_object == pytest.approx(truth, abs=1e-4)


def test_the_four_most_confident_points_stand_in_for_confident_ones(scene):
    camera, truth = Camera(K), pose_of(0.4, [0.0, 1.65, 8.0])
    exact = observe(scene.prior.mean, camera, truth)
    good = [0, 3, 7, 10]  # not in one plane
    confidence = np.full(14, 0.05)
    confidence[good] = [0.2, 0.2, 0.1, 0.9]
    keypoints = exact.keypoints + 80.0
    keypoints[good] = exact.keypoints[good]
    estimate = METHODS["sqpnp_confident"].bind(scene)(Observation(keypoints, confidence, exact.box), camera)
    assert estimate.camera_T_object == pytest.approx(truth, abs=1e-3)


@pytest.mark.parametrize("name", BASELINES)
def test_too_few_points_are_refused(scene, name):
    exact = observe(scene.prior.mean, Camera(K), pose_of(0.4, [0.0, 1.65, 8.0]))
    keypoints = exact.keypoints.copy()
    keypoints[3:] = np.nan
    with pytest.raises(FgreconError, match="keypoints: got 3 measured"):
        METHODS[name].bind(scene)(replace(exact, keypoints=keypoints), Camera(K))
