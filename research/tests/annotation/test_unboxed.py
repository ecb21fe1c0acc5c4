"""Vehicles of which only 2D boxes and tracks are known: their own reconstruction, where it is sure."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.half_turn import partners
from fgrecon.io.kitti_files import read_drive
from fgrecon.simulation.vehicles import KITTI_CAMERA
from fgrecon_research.annotation.annotate import LeftOut, Reason, annotate
from fgrecon_research.annotation.annotation import Fit
from fgrecon_research.annotation.unboxed import Unboxed, fit_unboxed
from research.tests.annotation.streets import Car, GivenKeypoints, directions, write_drive
from tests.cars import observe, project, yaw_pose

KNOWN = Unboxed(Ground.level(1.6))


def alone(seen, pose, prior, known=KNOWN, camera=KITTI_CAMERA):
    """The fit of a vehicle of one image, whose network says where it is seen from, or why there is none."""
    seen = replace(seen, azimuth=directions(pose))
    (found,) = fit_unboxed({0: (camera, {0: seen})}, prior, known).values()
    return found


PATH = [Car((-3.0 + 0.3 * t, 1.6, 13.0 - 0.7 * t), 1.0 + 0.02 * t, boxed=False) for t in range(5)]


def test_a_track_is_reconstructed_where_boxes_are_missing(scene, tmp_path):
    frames = [{4: car} for car in PATH]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    detector = GivenKeypoints(frames, scene.prior, noise=1.0)
    made, left = annotate(drive, detector, scene.prior)
    assert made == []
    assert [one.reason for one in left] == [Reason.NO_BOX] * 5
    made, left = annotate(drive, detector, scene.prior, unboxed=KNOWN)
    assert left == []
    assert len(made) == 5
    for one, car in zip(made, PATH, strict=True):
        box = car.box(scene.prior)
        off = np.linalg.norm(one.keypoints - car.keypoints(scene.prior), axis=1) / (box[2:] - box[:2]).max()
        assert np.median(off) < 0.02
        assert off.max() < 0.08
        np.testing.assert_allclose(one.size, scene.prior.box_size(np.zeros(scene.prior.dimension)), rtol=0.1)
        assert (np.linalg.eigvalsh(one.covariance) > 0).all()


def test_what_is_nearer_hides_without_boxes_as_well(scene, tmp_path):
    far, near = Car((0.0, 1.6, 20.0), np.pi / 2, boxed=False), Car((0.3, 1.6, 12.0), 0.0, boxed=False)
    frames = [{1: far, 2: near}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    made, _ = annotate(drive, GivenKeypoints(frames, scene.prior), scene.prior, unboxed=KNOWN)
    seen = {one.track: one for one in made}
    assert len(seen[1].before) == 1
    assert (seen[1].visible[:4] == 0.0).all()
    assert seen[2].before == ()


def test_boxes_are_used_where_they_are(scene, tmp_path):
    frames = [{4: replace(PATH[0], boxed=True)}, {4: PATH[1]}]
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    (first, second), left = annotate(drive, GivenKeypoints(frames, scene.prior), scene.prior, unboxed=KNOWN)
    assert left == []
    np.testing.assert_allclose(first.size, drive.frames[0].objects.size[0])
    assert (drive.frames[1].objects.size[0] == -1.0).all()
    assert (second.size > 1.0).all()


def test_images_that_are_not_sure_are_left_out(scene, tmp_path):
    frames = [{4: car} for car in PATH]

    def lose(number, car, points, confidence):
        return (np.where(np.arange(14)[:, None] < 2, points, np.nan) if number == 2 else points), confidence

    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    made, left = annotate(drive, GivenKeypoints(frames, scene.prior, changed=lose), scene.prior, unboxed=KNOWN)
    assert [one.frame.number for one in made] == [0, 1, 3, 4]
    assert left == [LeftOut(2, 4, Reason.FEW_POINTS, "Car")]


def test_a_track_without_any_pose(scene):
    seen = observe(scene.prior, yaw_pose(0.5))
    nothing = replace(seen, keypoints=np.full((14, 2), np.nan), confidence=np.zeros(14))
    frames = {n: (KITTI_CAMERA, {7: nothing}) for n in (3, 4)}
    assert fit_unboxed(frames, scene.prior, KNOWN) == {(3, 7): Reason.FEW_POINTS, (4, 7): Reason.FEW_POINTS}


def test_an_image_that_leaves_the_direction_open_is_not_sure(scene):
    """Four keypoints of the side that is seen edge on."""
    seen = observe(scene.prior, yaw_pose(0.0))
    few = np.where(np.isin(np.arange(14), [0, 2, 10, 12])[:, None], seen.keypoints, np.nan)
    seen = replace(seen, keypoints=few, confidence=np.full(14, 0.3))
    assert alone(seen, yaw_pose(0.0), scene.prior) is Reason.UNSURE


def test_images_that_show_it_flipped_are_put_right(scene, tmp_path):
    """Two of nine show the other end; the network is outvoted there."""
    path = [Car((-3.0 + 0.3 * t, 1.6, 15.0 - 0.7 * t), 1.0 + 0.02 * t, boxed=False) for t in range(9)]
    frames = [{4: car} for car in path]
    partner = np.asarray(partners(scene.prior))

    def turn(number, car, points, confidence):
        wrong = number in (3, 6)
        return (np.where(partner[:, None] >= 0, points[partner], np.nan) if wrong else points), confidence

    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, frames))
    made, left = annotate(drive, GivenKeypoints(frames, scene.prior, changed=turn), scene.prior, unboxed=KNOWN)
    assert left == []
    for one, car in zip(made, path, strict=True):
        extent = (one.box[2:] - one.box[:2]).max()
        assert np.median(np.linalg.norm(one.keypoints - car.keypoints(scene.prior), axis=1)) < 0.05 * extent
        assert one.camera_T_object[:3, 0] @ car.pose()[:3, 0] > 0.95


def test_two_vehicles_of_one_number_are_refused(scene, tmp_path):
    drive = read_drive(write_drive(tmp_path / "drive", scene.prior, [{1: PATH[0], 2: PATH[3]}]))
    (frame,) = drive.frames
    twice = replace(drive, frames=(replace(frame, tracks=np.array([1, 1])),))
    with pytest.raises(InvalidInputError, match="track 1 twice in frame 0"):
        annotate(twice, GivenKeypoints([{1: PATH[0], 2: PATH[3]}], scene.prior), scene.prior, unboxed=KNOWN)


def test_size_and_ground_tell_how_far_it_is(scene):
    seen = observe(scene.prior, yaw_pose(0.5))
    camera = Camera(KITTI_CAMERA.matrix)
    found = []
    for height in (1.65, 1.2):
        fit = alone(seen, yaw_pose(0.5), scene.prior, Unboxed(Ground.level(height), scene.size), camera)
        assert isinstance(fit, Fit)
        found.append(fit.result.location[2])
    assert found[0] - found[1] > 0.3


def test_covariances_are_those_of_independent_samples(scene):
    pose = yaw_pose(0.5)
    camera = Camera(KITTI_CAMERA.matrix)
    fit = alone(observe(scene.prior, pose), pose, scene.prior, KNOWN, camera)
    result, rng, scale = fit.result, np.random.default_rng(0), 0.05
    steps = scale * rng.multivariate_normal(np.zeros(6), result.uncertainty.pose_covariance, 3000)
    shifts = np.array(
        [scale * rng.multivariate_normal(np.zeros(3), c, 3000) for c in result.uncertainty.keypoint_covariance]
    )
    drawn = [
        project(result.wireframe + shifts[:, i], result.pose.gtsam.retract(step).matrix(), camera.matrix)
        for i, step in enumerate(steps)
    ]
    off = (np.array(drawn) - result.pose.wireframe_uv) / scale
    sampled = np.einsum("ski,skj->kij", off, off) / len(off)
    for one, other in zip(fit.covariance, sampled, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=0.1 * np.trace(one))


@pytest.mark.parametrize("size", [None, "kitti"])
def test_the_surface_is_that_of_the_result(scene, size):
    known = Unboxed(Ground.level(1.65), None if size is None else scene.size)
    fit = alone(observe(scene.prior, yaw_pose(0.5)), yaw_pose(0.5), scene.prior, known)
    pose = fit.result.camera_T_object
    expected = fit.result.shape.surface_vertices @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(fit.solid.vertices, expected, atol=1e-12)
