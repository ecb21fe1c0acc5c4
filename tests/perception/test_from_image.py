"""From detections to cars: the network's direction decides between poses that explain the keypoints alike."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors import X
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.metrics import orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.catalogue import load_prior
from fgrecon.perception.from_image import (
    reconstruct_detection,
    reconstruct_detections,
    reconstruct_image,
)
from fgrecon.perception.keypoints.crops import crop_of
from fgrecon.perception.keypoints.detect import CascadeDetection
from fgrecon.perception.vehicles import Vehicles
from fgrecon.solve.proposals.terms import direction_penalty
from fgrecon.solve.track import reconstruct_track

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
    assert direction_penalty(found.azimuth, pose) < 0.3
    assert direction_penalty(found.azimuth, pose_at(turn + np.pi)) > 4.0
    unsure = replace(found, azimuth=np.full(36, 1 / 36))
    assert direction_penalty(unsure.azimuth, pose_at(turn + 2.0)) == pytest.approx(0.0)


def test_clear_keypoints_give_the_pose_whatever_the_direction():
    pose = pose_at(0.8)
    visible = np.where(np.arange(14) % 2 == 0, 0.95, 0.05)
    for azimuth in (azimuth_of(pose), azimuth_of(pose) + 0.1):
        result = reconstruct_detection(detection(pose, visible, azimuth), CAMERA, options=FAST)
        assert orientation_error([result.rotation_y], [0.8])[0] < 5.0


def torn(turn):
    """A car whose keypoints are half those of a pose and half those of the same pose flipped."""
    ahead, behind = pose_at(turn), pose_at(turn + np.pi)
    whole, other = (detection(pose, np.full(14, 0.9), azimuth_of(pose)) for pose in (ahead, behind))
    first = np.isin(np.arange(14), [0, 1, 4, 5, 10, 11, 8])
    pixels = np.where(first[:, None], whole.observation.keypoints, other.observation.keypoints)
    vague = np.broadcast_to(60.0 * np.eye(2), (14, 2, 2))
    return replace(whole, observation=replace(whole.observation, keypoints=pixels, covariance=vague)), ahead, behind


@pytest.mark.parametrize("turn", [1.8, 2.2, 2.6])
def test_the_direction_decides_between_poses_that_explain_the_keypoints_alike(turn):
    seen, ahead, behind = torn(turn)
    for pose in (ahead, behind):
        directed = replace(seen, azimuth=seen_from(azimuth_of(pose)))
        result = reconstruct_detection(directed, CAMERA, options=FAST)
        assert orientation_error([result.rotation_y], [rotation_y(pose)])[0] < 30.0
        assert result.diagnostics.energies["direction"] < 0.7
        assert result.diagnostics.energies["direction"] == pytest.approx(
            direction_penalty(directed.azimuth, result.camera_T_object)
        )
    off = replace(FAST, disabled_terms=[*FAST.disabled_terms, "direction"])
    ends = [
        reconstruct_detection(replace(seen, azimuth=seen_from(azimuth_of(pose))), CAMERA, options=off)
        for pose in (ahead, behind)
    ]
    np.testing.assert_array_equal(ends[0].camera_T_object, ends[1].camera_T_object)
    assert "direction" not in ends[0].diagnostics.energies


def test_in_a_track_the_directions_of_all_images_count():
    seen, ahead, behind = torn(1.8)
    for pose in (ahead, behind):
        directed = replace(seen, azimuth=seen_from(azimuth_of(pose)))
        unsure = replace(seen, azimuth=np.full(36, 1 / 36))
        track = reconstruct_track([directed.evidence, unsure.evidence, directed.evidence], CAMERA, options=FAST)
        turns = [frame.rotation_y for frame in track.frames]
        assert orientation_error(turns, [rotation_y(pose)] * 3).max() < 30.0


def test_a_vehicle_is_shown_in_a_line():
    seen = detection(pose_at(0.8), np.full(14, 0.9), azimuth_of(pose_at(0.8)))
    other = detection(pose_at(0.8, (-4.0, 1.6, 18.0)), np.full(14, 0.9), azimuth_of(pose_at(0.8)))
    found, _ = reconstruct_detections([seen, other], CAMERA, options=FAST)
    x1, y1, x2, y2 = seen.observation.box
    (x, y, z), yaw = found.result.location, np.degrees(found.result.rotation_y)
    assert repr(found) == (
        f"FromImage(box ({x1:.0f}, {y1:.0f}, {x2:.0f}, {y2:.0f}): {found.result.status.value} "
        f"at ({x:.2f}, {y:.2f}, {z:.2f}) m, yaw {yaw:.1f} degrees)"
    )
    assert " ms" not in repr(found.result)
    refused = replace(found, result=None, error=InvalidInputError("box", 1, "Give another."))
    assert repr(refused).endswith(": refused, box: got 1. Give another.)")


def test_classes_of_boxes_or_of_their_detector_tell_sizes():
    poses = [pose_at(0.7), pose_at(2.0, (-4.0, 1.6, 20.0))]
    found = [detection(pose, np.full(14, 0.9), azimuth_of(pose)).observation for pose in poses]

    def keypoints(image, boxes):
        return found

    keypoints.category = "car14"
    boxes, van, nothing = np.array([one.box for one in found]), VehicleClass("van"), np.zeros((375, 1242, 3), np.uint8)

    def looking(classes):
        return lambda image: Vehicles(boxes, np.ones(2), classes=classes)

    def priors(**given):
        vehicles = reconstruct_image(nothing, CAMERA, keypoint_detector=keypoints, options=FAST, **given)
        return [one.result.shape.prior for one in vehicles]

    assert priors(boxes=boxes, classes=[None, van]) == ["car14", "car14 of van"]
    classifying = looking((van, VehicleClass("car")))
    assert priors(vehicle_detector=classifying) == ["car14", "car14"]  # unless it is requested
    assert priors(vehicle_detector=classifying, classes="detected") == ["car14 of van", "car14"]
    found = [
        replace(detection(pose, np.full(14, 0.9), azimuth_of(pose)), kinds=kinds)
        for pose, kinds in zip(poses, [{"van": 1.0}, None], strict=True)
    ]
    assert priors(boxes=boxes) == ["car14", "car14"]
    assert priors(boxes=boxes, classes="keypoints") == ["car14 of van", "car14"]
    with pytest.raises(InvalidInputError, match="0 for 2 vehicles"):
        priors(vehicle_detector=looking(()), classes="detected")
    with pytest.raises(InvalidInputError, match=r"vehicles\.classes.*1 for 2"):
        Vehicles(boxes, np.ones(2), classes=(van,))


def test_factors_of_ones_own_are_about_the_box_by_its_number():
    poses = [pose_at(0.7), pose_at(2.0, (-4.0, 1.6, 20.0))]
    found = [detection(pose, np.full(14, 0.9), azimuth_of(pose)) for pose in poses]

    def keypoints(image, boxes):
        return [one.observation for one in found]

    keypoints.category = "car14"
    held = poses[1][:3, 3] + np.array([0.0, 0.0, 1.0])
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 1e-3)
    factor = gtsam.PriorFactorPose3(X(1, 0), gtsam.Pose3(gtsam.Rot3(poses[1][:3, :3]), held), noise)
    boxes, image = np.array([one.observation.box for one in found]), np.zeros((375, 1242, 3), np.uint8)
    how = {"keypoint_detector": keypoints, "options": FAST, "extra_factors": [factor]}
    vehicles = reconstruct_image(image, CAMERA, boxes, **how)
    assert vehicles[1].result.location == pytest.approx(held, abs=0.02)
    with pytest.raises(InvalidInputError, match=r"extra_factors.*together"):
        reconstruct_image(image, CAMERA, boxes, together=False, **how)
