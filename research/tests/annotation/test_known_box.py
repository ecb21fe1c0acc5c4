"""Keypoints of simulated cars of known boxes: near the truth whatever the network says, and as sure as they claim."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import Reason
from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.simulation.keypoint_noise import HOURGLASS, Twins
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from fgrecon_research.annotation import known_box
from fgrecon_research.annotation.annotation import Fit
from fgrecon_research.annotation.known_box import SETTINGS, BoxedView, fit_known_boxes

POSES = [yaw_pose(yaw, np.array([x, 1.65, z])) for yaw, x, z in ((1.2, -3, 14), (1.1, -2.5, 12), (0.9, -2.0, 10))]


@pytest.fixture(scope="module")
def vehicle(scene):
    return Vehicle.sample(scene.prior, np.random.default_rng(11))


def box_of(pose, prior, vehicle):
    return Box3D(pose[:3, 3], rotation_y(pose), prior.box_size(vehicle.coefficients))


def track(prior, vehicle, seed=3, poses=POSES):
    """The views of a car by a network's noise, and what is true."""
    rng = np.random.default_rng(seed)
    seen = [simulate(vehicle, KITTI_CAMERA, pose, rng, HOURGLASS) for pose in poses]
    views = [
        BoxedView(found, KITTI_CAMERA, box_of(pose, prior, vehicle))
        for pose, (found, _) in zip(poses, seen, strict=True)
    ]
    return views, [truth for _, truth in seen]


def errors(fits, views, truths):
    """Of every keypoint of every image, as shares of the box."""
    return np.array(
        [
            np.linalg.norm(fit.result.pose.wireframe_uv - truth.projections, axis=1) / view.observation.extent
            for fit, view, truth in zip(fits, views, truths, strict=True)
        ]
    )


def turned(view, prior):
    """A network that takes the front for the rear with every keypoint, and is sure of it."""
    seen = view.observation
    other = Twins.of(prior.category).rotated
    return replace(view, observation=replace(seen, keypoints=seen.keypoints[other], confidence=np.full(14, 0.9)))


def test_labels_are_near_the_truth_hidden_ones_as_well(scene, vehicle):
    views, truths = track(scene.prior, vehicle)
    found = errors(fit_known_boxes(views, scene.prior), views, truths)
    network = np.array(
        [
            np.linalg.norm(v.observation.keypoints - t.projections, axis=1) / v.observation.extent
            for v, t in zip(views, truths, strict=True)
        ]
    )
    assert np.median(found) < 0.02
    assert found.max() < 0.08
    assert network.max() > 0.2  # what the network lost is found again


def test_boxes_outvote_a_network_that_takes_the_front_for_the_rear(scene, vehicle):
    views, truths = track(scene.prior, vehicle)
    views[1] = turned(views[1], scene.prior)
    fits = fit_known_boxes(views, scene.prior)
    found = errors(fits, views, truths)
    assert np.median(found[1]) < 0.04
    assert np.median(found[[0, 2]]) < 0.025
    (alone,) = fit_known_boxes(views[1:2], scene.prior)
    assert abs(np.rad2deg(rotation_y(alone.result.camera_T_object) - rotation_y(POSES[1]))) < 5.0


def test_covariances_hold_for_cars_drawn_from_all_that_is_assumed(scene):
    """Boxes off by their sigmas, shapes of the prior, pixels off by the keypoints' covariances."""
    rng, prior, how = np.random.default_rng(5), scene.prior, SETTINGS
    squares = []
    for _ in range(30):
        true = Vehicle.sample(prior, rng)
        offsets = prior.offset_sigma[:, None] * rng.standard_normal((14, 3))
        offsets = (offsets + offsets[prior.category.mirror] * [1, 1, -1]) / np.sqrt(2.0)  # symmetric ones
        pose = yaw_pose(rng.uniform(-np.pi, np.pi), np.array([rng.uniform(-3, 3), 1.65, rng.uniform(8, 25)]))
        pixels = KITTI_CAMERA.project((true.keypoints + offsets) @ pose[:3, :3].T + pose[:3, 3])
        box2d = np.array([*pixels.min(axis=0), *pixels.max(axis=0)])
        sigma = 0.03 * (box2d[2:] - box2d[:2]).max()
        seen = Observation(
            pixels + sigma * rng.standard_normal((14, 2)),
            np.full(14, 0.95),
            box2d,
            np.tile(sigma**2 * np.eye(2), (14, 1, 1)),
            confidence_midpoint=0.5,
        )
        size = prior.box_size(true.coefficients, offsets)
        box = Box3D(
            pose[:3, 3] + how.shift_sigma * rng.standard_normal(3),
            rotation_y(pose) + how.turn_sigma * rng.standard_normal(),
            size * (1.0 + how.size_share * rng.standard_normal(3)),
        )
        (fit,) = fit_known_boxes([BoxedView(seen, KITTI_CAMERA, box)], prior)
        off = fit.result.pose.wireframe_uv - pixels
        squares.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(fit.covariance), off))
    assert 1.2 < np.mean(squares) < 3.0  # 2 where they hold


@pytest.mark.parametrize(
    ("option", "tight", "loose"),
    [("turn_sigma", 1e-4, 0.2), ("shift_sigma", 1e-4, 0.5), ("depth_share", 0.0, 0.2), ("size_share", 0.005, 0.2)],
)
def test_tighter_boxes_are_kept_more_closely(scene, vehicle, monkeypatch, option, tight, loose):
    views, _ = track(scene.prior, vehicle)
    box = views[0].box
    off = replace(box, location=box.location * 1.03, rotation_y=box.rotation_y + 0.1, size=box.size * [1.1, 1.0, 1.0])
    view = replace(views[0], box=off)

    def distance(value):
        monkeypatch.setattr(known_box, "SETTINGS", replace(SETTINGS, **{option: value}))
        (fit,) = fit_known_boxes([view], scene.prior)
        result = fit.result
        return {
            "turn_sigma": abs(result.rotation_y - off.rotation_y),
            "shift_sigma": np.linalg.norm(result.location - off.location),
            "depth_share": np.linalg.norm(result.location - off.location),
            "size_share": np.abs(result.box_size - off.size).max(),
        }[option]

    assert distance(tight) < distance(loose)


def test_images_that_err_alike_count_less(scene, vehicle, monkeypatch):
    views, _ = track(scene.prior, vehicle)
    spread = []
    for share in (0.0, 1.0):
        monkeypatch.setattr(known_box, "SETTINGS", replace(SETTINGS, common_error=share))
        spread.append(np.trace(fit_known_boxes(views, scene.prior)[0].covariance.sum(axis=0)))
    assert spread[0] < spread[1]


def test_a_prior_without_a_surface_has_a_hull(scene, vehicle):
    views, truths = track(scene.prior, vehicle)
    fits = fit_known_boxes(views, replace(scene.prior, surface=None))
    assert np.median(errors(fits, views, truths)) < 0.02
    for fit in fits:
        assert fit.result.shape.surface_vertices is None
        assert fit.solid.vertices[fit.solid.faces].shape[1:] == (3, 3)
        low, high = fit.solid.vertices.min(axis=0), fit.solid.vertices.max(axis=0)
        assert ((fit.points >= low - 1e-9) & (fit.points <= high + 1e-9))[:8].all()


def test_an_image_with_too_few_points_is_left_out_alone(scene, vehicle):
    views, _ = track(scene.prior, vehicle)
    points = np.where(np.arange(14)[:, None] < 2, views[1].observation.keypoints, np.nan)
    views[1] = replace(views[1], observation=replace(views[1].observation, keypoints=points))
    fits = fit_known_boxes(views, scene.prior)
    assert fits[1] is Reason.FEW_POINTS
    assert isinstance(fits[0], Fit)
    assert isinstance(fits[2], Fit)


def test_what_cannot_be_used_is_refused(scene, vehicle):
    views, _ = track(scene.prior, vehicle)
    with pytest.raises(InvalidInputError, match="at least one"):
        fit_known_boxes([], scene.prior)
    with pytest.raises(InvalidInputError, match="size of its box"):
        fit_known_boxes([replace(views[0], box=replace(views[0].box, size=None))], scene.prior)
