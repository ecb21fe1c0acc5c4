"""From detections to cars: the network's direction decides between poses that explain the keypoints alike."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.metrics import orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative
from fgrecon.io.catalogue import load_prior
from fgrecon.perception import from_image
from fgrecon.perception.from_image import direction_penalty, reconstruct_detection
from fgrecon.perception.keypoints.crops import crop_of
from fgrecon.perception.keypoints.detect import CascadeDetection

CAMERA = Camera.of([700.0, 700.0, 600.0, 180.0])
FAST = Options(keep_history=False, box="off")


def pose_at(rotation_y, location=(1.0, 1.6, 15.0)):
    c, s = np.cos(rotation_y), np.sin(rotation_y)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]], location
    return pose


def seen_from(azimuth):
    bins = np.arange(36) * 2 * np.pi / 36
    directions = np.exp((np.cos(azimuth - bins) - 1) / 0.05)
    return directions / directions.sum()


def azimuth_of(pose):
    x, _, z = -pose[:3, :3].T @ pose[:3, 3]
    return np.arctan2(z, x)


def detection(pose, confidence, azimuth):
    prior = load_prior("car14")
    pixels = CAMERA.project(prior.mean @ pose[:3, :3].T + pose[:3, 3])
    box = np.concatenate([pixels.min(axis=0) - 5, pixels.max(axis=0) + 5])
    observation = Observation(pixels, confidence, box, np.broadcast_to(4.0 * np.eye(2), (14, 2, 2)))
    return CascadeDetection(observation, seen_from(azimuth), confidence, confidence, crop_of(box, 96))


@pytest.mark.parametrize("turn", np.radians([-170, -60, 0, 45, 100]))
def test_the_penalty_is_least_at_the_direction_seen(turn):
    pose = pose_at(turn)
    found = detection(pose, np.full(14, 0.5), azimuth_of(pose))
    assert direction_penalty(found, pose) < 0.3
    assert direction_penalty(found, pose_at(turn + np.pi)) > 4.0
    unsure = replace(found, azimuth=np.full(36, 1 / 36))
    assert direction_penalty(unsure, pose_at(turn + 2.0)) == pytest.approx(0.0)


def test_clear_keypoints_give_the_pose_whatever_the_direction():
    pose = pose_at(0.8)
    visible = np.where(np.arange(14) % 2 == 0, 0.95, 0.05)
    for azimuth in (azimuth_of(pose), azimuth_of(pose) + 0.1):
        result = reconstruct_detection(detection(pose, visible, azimuth), CAMERA, options=FAST)
        assert orientation_error([result.rotation_y], [0.8])[0] < 5.0


@pytest.mark.parametrize(
    ("excess", "seen_behind", "turned"), [(1.0, True, True), (1.0, False, False), (50.0, True, False)]
)
def test_the_direction_decides_between_poses_that_explain_the_keypoints_alike(monkeypatch, excess, seen_behind, turned):
    ahead, behind = pose_at(np.pi / 2), pose_at(-np.pi / 2)
    calls = []

    def stub(keypoints, camera, *, initial=None, **_):
        calls.append(initial)
        if initial is None:
            return SimpleNamespace(camera_T_object=ahead, alternatives=(Alternative(behind, np.zeros(5), excess),))
        return SimpleNamespace(camera_T_object=behind, alternatives=())

    monkeypatch.setattr(from_image, "reconstruct", stub)
    found = detection(ahead, np.full(14, 0.5), azimuth_of(behind if seen_behind else ahead))
    result = reconstruct_detection(found, CAMERA)
    assert (result.camera_T_object is behind) == turned
    assert calls == ([None, pytest.approx(-np.pi / 2)] if turned else [None])
