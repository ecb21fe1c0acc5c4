"""The camera's own motion: from made-up points, from rendered images, and on KITTI's parked cars."""

import gtsam
import numpy as np
import pytest

from factors.native import native
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import exponential
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import read_drive
from fgrecon.video.egomotion import CameraMotion, _Problem, camera_motion, motion_of_points, tracked_points
from tests.video.streets import rendered

CAMERA = Camera(np.array([[720.0, 0, 620], [0, 720.0, 180], [0, 0, 1]]), image_size=(1242, 375))
GROUND = Ground.level(1.65)


def motion_of(rng, length, degrees=0.6):
    motion = np.eye(4)
    motion[:3, :3] = exponential(rng.normal(0.0, np.radians(degrees), 3))
    motion[:3, 3] = [0.02 * length, 0.01 * length, length]
    return motion


def street(rng, motion, wrong=0.1):
    """Pixels of a road and of walls beside it, before and after the motion; some points are tracked wrongly."""
    road = np.stack([rng.uniform(-6, 6, 300), 1.65 + rng.normal(0, 0.01, 300), rng.uniform(6, 35, 300)], axis=1)
    walls = np.stack(
        [rng.choice([-1, 1], 300) * rng.uniform(5, 15, 300), rng.uniform(-5, 1.5, 300), rng.uniform(8, 80, 300)], axis=1
    )
    points = np.concatenate([road, walls])
    later = (points - motion[:3, 3]) @ motion[:3, :3]
    seen = later[:, 2] > 2.0
    before, after = CAMERA.project(points[seen]), CAMERA.project(later[seen])
    inside = ((before > 0) & (before < (1241, 374)) & (after > 0) & (after < (1241, 374))).all(axis=1)
    before, after = (p[inside] + rng.normal(0, 0.3, (inside.sum(), 2)) for p in (before, after))
    off = rng.random(len(after)) < wrong
    after[off] += rng.normal(0, 15, (off.sum(), 2))
    return before, after


def error_of(found, motion):
    """(6,) rotation and translation by which a motion is off, in the current camera's frame."""
    off = np.linalg.inv(found.previous_T_current) @ motion
    return np.array([off[2, 1], off[0, 2], off[1, 0], *off[:3, 3]])


@pytest.mark.parametrize("length", [0.4, 0.8, 1.5])
def test_a_driving_camera(length):
    errors, normalised = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        motion = motion_of(rng, length)
        found = motion_of_points(*street(rng, motion), CAMERA, GROUND)
        errors.append(error_of(found, motion))
        normalised.append(errors[-1] @ np.linalg.solve(found.covariance, errors[-1]) / 6.0)
        assert found.points > 300
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[:3].max() < np.radians(0.03)
    assert rms[3:5].max() < 0.01
    assert rms[5] < 0.1 * length
    assert np.mean(normalised) < 2.0


def test_a_standing_camera_stands_and_may_turn():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion = motion_of(rng, 0.0)
        found = motion_of_points(*street(rng, motion), CAMERA, GROUND)
        off = error_of(found, motion)
        assert np.abs(off[:3]).max() < np.radians(0.02)
        assert np.abs(off[3:]).max() < 1e-6
        assert 0.01 < np.sqrt(found.covariance[5, 5]) < 0.05


def test_two_motions_are_one_as_gtsam_has_it():
    rng = np.random.default_rng(0)
    motions = [gtsam.Pose3.Expmap(rng.normal(size=6)) for _ in range(2)]
    roots = rng.normal(size=(2, 6, 6))
    first, second = (
        CameraMotion(m.matrix(), r @ r.T, 9 - i) for i, (m, r) in enumerate(zip(motions, roots, strict=True))
    )
    both = first.then(second)
    np.testing.assert_allclose(both.previous_T_current, motions[0].compose(motions[1]).matrix(), atol=1e-12)
    seen = motions[1].inverse().AdjointMap()
    np.testing.assert_allclose(both.covariance, seen @ first.covariance @ seen.T + second.covariance, atol=1e-9)
    assert both.points == 8


def test_the_ground_gives_the_scale():
    rng = np.random.default_rng(3)
    motion = motion_of(rng, 1.0)
    points = street(rng, motion)
    as_high, twice = (motion_of_points(*points, CAMERA, Ground.level(h)) for h in (1.65, 3.3))
    assert twice.previous_T_current[2, 3] == pytest.approx(2.0 * as_high.previous_T_current[2, 3], rel=0.1)


def test_a_guess_does_not_lead_astray():
    rng = np.random.default_rng(5)
    motion = motion_of(rng, 1.0)
    points = street(rng, motion)
    wrong = np.eye(4)
    wrong[2, 3] = 3.0
    alone, guessed = (motion_of_points(*points, CAMERA, GROUND, guess) for guess in (None, wrong))
    assert guessed.previous_T_current == pytest.approx(alone.previous_T_current, abs=0.02)


def test_too_few_points_are_no_motion():
    rng = np.random.default_rng(0)
    before, after = street(rng, motion_of(rng, 1.0))
    assert motion_of_points(before[:10], after[:10], CAMERA, GROUND) is None
    sky = before[:, 1] < 180
    assert motion_of_points(before[sky], after[sky], CAMERA, GROUND) is None
    blank = np.zeros((375, 1242), np.uint8)
    assert camera_motion(blank, blank, CAMERA, GROUND) is None
    assert camera_motion(blank, blank[:-1], CAMERA, GROUND) is None


def test_rendered_images():
    motion = motion_of(np.random.default_rng(1), 0.6, degrees=0.3)
    found = camera_motion(rendered(np.eye(4), CAMERA), rendered(motion, CAMERA), CAMERA, GROUND)
    off = error_of(found, motion)
    assert np.abs(off[:3]).max() < np.radians(0.05)
    assert np.abs(off[3:]).max() < 0.06


def test_points_on_vehicles_do_not_count():
    image = rendered(np.eye(4), CAMERA)
    box = np.array([500.0, 100.0, 800.0, 300.0])
    for boxes in ({"boxes_before": [box]}, {"boxes_after": [box]}):
        points, _ = tracked_points(image, image, CAMERA, GROUND, **boxes)
        assert len(points) > 50
        assert not ((points > box[:2]) & (points < box[2:])).all(axis=1).any()


@pytest.mark.data
@pytest.mark.slow
def test_kittis_parked_cars_stand_still(data):
    """Labelled cars of a street of parked cars, in the world that the estimated motion makes."""
    import cv2

    drive = read_drive(data / "kitti_video" / "drive_0095")
    camera, offset = drive.calibration.camera, drive.calibration.label_offset
    world_T_camera, motion, places, previous, boxes = np.eye(4), None, {}, None, []
    for frame in drive.frames[:40]:
        image = cv2.cvtColor(read_image(frame.image), cv2.COLOR_RGB2GRAY)
        now = list(frame.objects.box)
        if previous is not None:
            found = camera_motion(previous, image, camera, GROUND, boxes, now, motion)
            assert found is not None
            motion = found.previous_T_current
            world_T_camera = world_T_camera @ motion
        previous, boxes = image, now
        for i in np.flatnonzero(frame.boxed & np.array([kind == "Car" for kind in frame.objects.kind], dtype=bool)):
            place = world_T_camera[:3, :3] @ (frame.objects.location[i] + offset) + world_T_camera[:3, 3]
            places.setdefault(int(frame.tracks[i]), []).append(place)
    tracks = [np.array(p) for p in places.values() if len(p) >= 8]
    assert len(tracks) >= 5
    scatter = [np.linalg.norm((p - np.median(p, axis=0))[:, [0, 2]], axis=1).mean() for p in tracks]
    assert np.median(scatter) < 0.5
    assert max(np.ptp(p[:, 0]) for p in tracks) < 0.5


@pytest.mark.skipif(native("fgrecon.video._egomotion") is None, reason="no compiled kernel")
@pytest.mark.parametrize("length", [0.0, 0.8, 1.5])
def test_the_kernel_does_what_numpy_does(monkeypatch, length):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion = motion_of(rng, length)
        points = street(rng, motion, wrong=0.2)
        guess = motion if seed % 2 else None
        found = motion_of_points(*points, CAMERA, GROUND, guess)
        monkeypatch.setenv("FGRECON_KERNEL", "numpy")
        plain = motion_of_points(*points, CAMERA, GROUND, guess)
        monkeypatch.delenv("FGRECON_KERNEL")
        np.testing.assert_allclose(found.previous_T_current, plain.previous_T_current, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-6, atol=1e-15)
        assert found.points == plain.points


@pytest.mark.parametrize("kernel", ["", "numpy"])
def test_points_behind_the_camera_are_no_motion(monkeypatch, kernel):
    monkeypatch.setenv("FGRECON_KERNEL", kernel)
    rng = np.random.default_rng(0)
    before, after = street(rng, np.eye(4), wrong=0.0)
    problem = _Problem.of(before, after, CAMERA, GROUND)
    backwards = np.eye(4)
    backwards[2, 3] = -1e3
    assert problem.solve(backwards) is None
