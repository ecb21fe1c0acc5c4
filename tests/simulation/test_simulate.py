"""Simulated observations: determinism, the noise model's own statistics, poses, and the fit to real tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.keypoint_noise import HOURGLASS, OUTLIER, Twins
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, kitti_like_pose, simulate, simulate_track, yaw_pose
from fgrecon_research.simulation import HARD

PRIOR = load_prior("car14")
POSE = yaw_pose(0.7, np.array([2.0, 1.65, 15.0]))
SILENT = replace(
    HOURGLASS,
    found_visible=1.0,
    found_hidden=1.0,
    sigma_visible=0.0,
    sigma_hidden=0.0,
    confident_lost=0.0,
    box_sigma=0.0,
)


def draw(noise, count=300, seed=1):
    rng = np.random.default_rng(seed)
    pairs = [simulate(Vehicle.sample(PRIOR, rng), KITTI_CAMERA, kitti_like_pose(rng), rng, noise) for _ in range(count)]
    return [o for o, _ in pairs], [t for _, t in pairs]


def errors(observations, truths):
    """(n, K) distance to the truth in units of the true box's extent."""
    extent = np.array([max(t.box[2] - t.box[0], t.box[3] - t.box[1]) for t in truths])
    apart = np.array([o.keypoints - t.projections for o, t in zip(observations, truths, strict=True)])
    return np.linalg.norm(apart, axis=2) / extent[:, None]


def test_twins_of_a_car():
    twins = Twins.of(PRIOR.category)
    names = np.array(PRIOR.category.keypoints)
    rotated = dict(zip(names, names[twins.rotated], strict=True))
    assert rotated["left_headlight"] == "right_taillight"
    assert rotated["left_front_wheel"] == "right_back_wheel"
    assert rotated["left_front_roof"] == "right_back_roof"
    assert rotated["left_side_mirror"] == "right_side_mirror"
    assert dict(zip(names, names[twins.swapped], strict=True))["left_headlight"] == "left_taillight"
    for index in (twins.mirrored, twins.rotated, twins.swapped):
        np.testing.assert_array_equal(index[index], np.arange(len(names)))


def test_the_same_seed_gives_the_same_bits():
    (a, ta), (b, tb) = (
        simulate(Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension)), KITTI_CAMERA, POSE, np.random.default_rng(3), HARD)
        for _ in range(2)
    )
    np.testing.assert_array_equal(a.keypoints, b.keypoints)
    np.testing.assert_array_equal(a.confidence, b.confidence)
    np.testing.assert_array_equal(ta.outlier, tb.outlier)


def test_without_noise_the_truth_is_measured():
    rng = np.random.default_rng(0)
    observation, truth = simulate(Vehicle.sample(PRIOR, rng), KITTI_CAMERA, POSE, rng, SILENT)
    inside = np.clip(truth.projections, truth.box[:2], truth.box[2:])
    np.testing.assert_allclose(observation.keypoints, inside, atol=1e-9)
    np.testing.assert_allclose(observation.box, truth.box)
    assert not truth.outlier.any()
    assert 0 < truth.visible.sum() < PRIOR.category.size


def test_lens_distortion_is_applied():
    lens = Camera(KITTI_CAMERA.matrix, np.array([-0.2, 0.05, 0.0, 0.0]), KITTI_CAMERA.image_size)
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    _, ideal = simulate(vehicle, KITTI_CAMERA, POSE, np.random.default_rng(0), SILENT)
    _, bent = simulate(vehicle, lens, POSE, np.random.default_rng(0), SILENT)
    assert np.abs(bent.projections - ideal.projections).max() > 0.1
    np.testing.assert_allclose(lens.undistort(bent.projections), ideal.projections, atol=1e-6)


def test_statistics_are_the_models():
    observations, truths = draw(HOURGLASS)
    error = errors(observations, truths)
    visible = np.array([t.visible for t in truths])
    confidence = np.array([o.confidence for o in observations])
    found = error <= OUTLIER
    np.testing.assert_array_equal(found, [~t.outlier for t in truths])
    assert found[visible].mean() == pytest.approx(HOURGLASS.found_visible, abs=0.03)
    # lost points fall near their own place by chance: a car seen from behind has its lamps in one another's image
    assert HOURGLASS.found_hidden < found[~visible].mean() < HOURGLASS.found_hidden + 0.25
    a, b = HOURGLASS.confidence_visible
    assert np.median(confidence[visible & found]) == pytest.approx(a / (a + b), abs=0.05)
    assert np.median(confidence[visible & ~found]) < 0.1
    narrow = error[visible & found & (confidence > 0.3)]
    assert np.sqrt(np.mean(narrow**2) / 2) == pytest.approx(HOURGLASS.sigma_visible, rel=0.15)


def test_a_confused_end_names_hidden_keypoints_where_their_twins_are():
    noise = replace(SILENT, confusion=1.0, confusion_share=1.0)
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    rng = np.random.default_rng(4)
    observation, truth = simulate(vehicle, KITTI_CAMERA, yaw_pose(-np.pi / 2, np.array([0.0, 1.65, 15.0])), rng, noise)
    names = PRIOR.category.index
    for hidden, seen in (("left_headlight", "right_taillight"), ("right_headlight", "left_taillight")):
        assert not truth.visible[names(hidden)]
        assert truth.visible[names(seen)]
        np.testing.assert_allclose(observation.keypoints[names(hidden)], truth.projections[names(seen)], atol=1e-9)
        assert observation.confidence[names(hidden)] > observation.confidence[names(seen)]


def test_missing_and_covered_keypoints():
    noise = replace(HOURGLASS, missing=1.0)
    observation, _ = simulate(
        Vehicle.sample(PRIOR, np.random.default_rng(0)), KITTI_CAMERA, POSE, np.random.default_rng(0), noise
    )
    assert not observation.measured.any()
    assert (observation.confidence == 0).all()
    seen = [np.mean([t.visible.mean() for t in draw(replace(HOURGLASS, covered=c), 80)[1]]) for c in (0.0, 1.0)]
    assert seen[1] < seen[0] - 0.1


def test_poses_are_kittis():
    rng = np.random.default_rng(0)
    poses = np.array([kitti_like_pose(rng) for _ in range(2000)])
    assert poses[:, 2, 3].min() > 7.0
    assert poses[:, 2, 3].max() < 46.0
    yaw = np.array([rotation_y(pose) for pose in poses])
    along = np.abs(np.abs(yaw) - np.pi / 2) < np.radians(15)
    assert along.mean() == pytest.approx(0.8, abs=0.05)
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1), np.eye(3)[None].repeat(2000, 0), atol=1e-12
    )
    pixels = KITTI_CAMERA.project(poses[:, :3, 3])
    assert (pixels[:, 0] > 0).all()
    assert (pixels[:, 0] < 1242).all()
    assert np.median(poses[:, 1, 3]) == pytest.approx(1.65, abs=0.05)


@pytest.mark.parametrize("field", ["found_visible", "covered", "sigma_visible", "lost_to", "confidence_lost"])
def test_bad_numbers_are_named(field):
    bad = {"lost_to": (0.5, 0.1, 0.1, 0.1, 0.1), "confidence_lost": (0.0, 1.0)}.get(field, -0.1)
    with pytest.raises(InvalidInputError, match=field):
        replace(HOURGLASS, **{field: bad})


def test_a_vehicle_behind_or_beside_the_camera_is_refused():
    rng = np.random.default_rng(0)
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    for location in ([0.0, 1.65, 1.0], [100.0, 1.65, 20.0]):
        with pytest.raises(InvalidInputError, match="camera_T_object"):
            simulate(vehicle, KITTI_CAMERA, yaw_pose(0.0, np.array(location)), rng)
    with pytest.raises(InvalidInputError, match="surface"):
        Vehicle.of_prior(replace(PRIOR, surface=None), np.zeros(PRIOR.dimension))


def test_hidden_keypoints_are_not_visible():
    hidden = np.zeros(PRIOR.category.size, dtype=bool)
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    _, free = simulate(vehicle, KITTI_CAMERA, POSE, np.random.default_rng(0))
    hidden[np.flatnonzero(free.visible)[:2]] = True
    _, partly = simulate(vehicle, KITTI_CAMERA, POSE, np.random.default_rng(0), hidden=hidden)
    np.testing.assert_array_equal(partly.visible, free.visible & ~hidden)


def test_a_track_moves_smoothly():
    track = simulate_track(Vehicle.sample(PRIOR, np.random.default_rng(2)), 12, np.random.default_rng(3))
    assert 1 < len(track) <= 12
    locations = np.array([t.camera_T_object[:3, 3] for _, t in track])
    steps = np.linalg.norm(np.diff(locations, axis=0), axis=1)
    assert steps.max() <= 1.0
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert len({id(t.vehicle) for _, t in track}) == 1
