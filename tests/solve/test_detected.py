"""Another detector's 3D boxes in the graph: nearer to the truth, the right way round; without them nothing changes."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.metrics import orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Regions, Status, rotation_y
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.sample import disturbed_boxes
from fgrecon.solve.detected import refined
from fgrecon.solve.scene import reconstruct_scene
from fgrecon.solve.time.heading_filter import Belief, box_evidence
from fgrecon.solve.vehicle.model import prepare, sized
from tests.cars import CAMERA, observe, yaw_pose
from tests.solve.test_scene import on_the_road

OPTIONS = Options(keep_history=False)
ERRORS = BoxErrors(flip_probability=1e-3)


def street(seed, count=5):
    """Poses of cars on a road, their keypoints, and their true boxes."""
    rng = np.random.default_rng(seed)
    prior = load_prior("car14").for_fleet(fgrecon.SIZE_PRIORS["kitti"])
    poses, seen, boxes = [], [], []
    for number in range(count):
        pose = on_the_road(rng, pitch=0.0)[0]
        shape = 0.7 * rng.normal(size=5)
        poses.append(pose)
        seen.append(observe(prior, pose, shape, noise=1.5, seed=seed + number))
        boxes.append(Box3D(pose[:3, 3], rotation_y(pose), prior.box_size(shape)))
    return poses, seen, boxes


def far(boxes, poses):
    return np.array([np.linalg.norm(box.location - pose[:3, 3]) for box, pose in zip(boxes, poses, strict=True)])


def test_boxes_come_nearer_to_the_truth():
    before, after, within = [], [], []
    for seed in range(6):
        poses, seen, true = street(20 * seed)
        boxes = disturbed_boxes(true, CAMERA, ERRORS, np.random.default_rng(seed))
        scene = reconstruct_scene(seen, CAMERA, boxes=boxes, box_errors=ERRORS, options=OPTIONS)
        solved = dict(zip(scene.numbers, scene.vehicles, strict=True))
        better = [refined(box, ERRORS, solved.get(i), scene.refused.get(i)) for i, box in enumerate(boxes)]
        assert all(one.changed for one in better)
        before += far(boxes, poses).tolist()
        after += far([one.box for one in better], poses).tolist()
        for one, pose in zip(better, poses, strict=True):
            assert orientation_error([one.box.rotation_y], [rotation_y(pose)])[0] < 15.0
            ray = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
            off = ray @ (one.box.location - pose[:3, 3])
            within.append(off / np.sqrt(ray @ one.location_covariance @ ray))
    assert np.mean(after) < 0.85 * np.mean(before)
    assert 0.4 < np.sqrt(np.mean(np.square(within))) < 1.6


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_with_little_to_see_the_box_stays_near_what_it_was():
    """Points that are anywhere: depth is the box's."""
    pose = yaw_pose(0.6, (1.0, 1.65, 30.0))
    seen = observe(load_prior("car14"), pose, noise=40.0, box=False)
    faint = Observation(seen.keypoints, 0.05 * seen.confidence)
    given = Box3D(pose[:3, 3], 0.6, np.array([4.5, 1.8, 1.5]))
    scene = reconstruct_scene([faint], CAMERA, boxes=[given], options=OPTIONS)
    assert np.linalg.norm(scene.vehicles[0].location - given.location) < 0.06 * 30.0
    assert not refined(given, BoxErrors(), scene.vehicles[0], None).changed


@pytest.mark.parametrize("turned", [False, True])
def test_a_sure_network_turns_a_box_round_and_an_unsure_one_does_not(turned):
    """Keypoints of the true side; directions that say it surely, or nothing."""
    pose = yaw_pose(0.6)
    seen = observe(load_prior("car14"), pose, noise=1.0)
    azimuth = np.arctan2(*(-pose[:3, :3].T @ pose[:3, 3])[[2, 0]])
    directions = np.exp((np.cos(azimuth - 2.0 * np.pi * np.arange(36) / 36) - 1.0) / 0.05)
    sure = Observation(seen.keypoints, seen.confidence, seen.box, azimuth=directions / directions.sum())
    given = Box3D(pose[:3, 3], 0.6 + np.pi * turned, None)
    vehicle = reconstruct_scene([sure], CAMERA, boxes=[given], options=OPTIONS).vehicles[0]
    assert orientation_error([vehicle.rotation_y], [0.6])[0] < 10.0
    assert vehicle.facing_probability > (0.8 if turned else 0.99)


def test_keypoints_flipped_as_a_whole_are_taken_so():
    """The network took the front for the rear, and its directions leave that open: the box decides."""
    prior, pose = load_prior("car14"), yaw_pose(0.6)
    there = pose @ np.diag([-1.0, 1.0, -1.0, 1.0])
    seen = observe(prior, there, noise=1.0)
    open_ = Observation(seen.keypoints, seen.confidence, seen.box, azimuth=np.full(36, 1.0 / 36))
    given = Box3D(pose[:3, 3], 0.6, None)
    vehicle = reconstruct_scene([open_], CAMERA, boxes=[given], options=OPTIONS).vehicles[0]
    assert orientation_error([vehicle.rotation_y], [0.6])[0] < 15.0
    assert 0.5 < vehicle.facing_probability < 0.99
    trusting = BoxErrors(flip_probability=0.5)
    vehicle = reconstruct_scene([open_], CAMERA, boxes=[given], box_errors=trusting, options=OPTIONS).vehicles[0]
    assert orientation_error([vehicle.rotation_y], [0.6])[0] > 160.0, "a box that tells no side leaves it to the points"


def test_a_vehicle_without_a_box_among_others_is_as_it_would_be():
    _, seen, true = street(3, count=3)
    boxes = [*true[:2], None]
    scene = reconstruct_scene(seen, CAMERA, size_prior="kitti", boxes=boxes, options=OPTIONS)
    assert scene.numbers == (0, 1, 2)
    assert all(vehicle.status is not Status.FAILED for vehicle in scene.vehicles)
    alone = reconstruct_scene(seen, CAMERA, size_prior="kitti", boxes=[None] * 3, options=OPTIONS)
    without = reconstruct_scene(seen, CAMERA, size_prior="kitti", options=OPTIONS)
    for one, other in zip(alone.vehicles, without.vehicles, strict=True):
        assert np.array_equal(one.camera_T_object, other.camera_T_object)


def test_of_an_assumed_fleet_are_those_without_a_box():
    """A vehicle whose box tells its size says nothing of the others' fleet, wherever it stands in the list."""
    _, seen, boxes = street(7, count=3)
    orders = [[0, 1, 2], [1, 2, 0]]
    found = []
    for order in orders:
        given = [boxes[i] if i == 0 else None for i in order]
        scene = reconstruct_scene([seen[i] for i in order], CAMERA, ground=1.65, boxes=given, options=OPTIONS)
        found.append(dict(zip(order, scene.vehicles, strict=True)))
    for i in range(3):
        np.testing.assert_allclose(found[0][i].camera_T_object, found[1][i].camera_T_object, atol=1e-3)
        np.testing.assert_allclose(
            found[0][i].uncertainty.size_covariance, found[1][i].uncertainty.size_covariance, rtol=1e-2, atol=1e-6
        )
    assert np.trace(found[0][0].uncertainty.size_covariance) < 0.5 * np.trace(found[0][1].uncertainty.size_covariance)


def test_the_size_is_the_boxes_own_as_far_as_that_is_known():
    """A van among cars: its size is not pulled to a fleet's."""
    size = np.array([4.9, 1.95, 1.95])
    pose = yaw_pose(0.4, (2.0, 1.65, 16.0))
    prior = load_prior("car14").for_fleet(SizePrior("van", size, 0.05 * size))
    seen = observe(prior, pose, noise=1.0)
    given = Box3D(pose[:3, 3], 0.4, 1.04 * size)
    (vehicle,) = reconstruct_scene([seen], CAMERA, size_prior="kitti", boxes=[given], options=OPTIONS).vehicles
    assert vehicle.box_size == pytest.approx(size, rel=0.06)
    assert (np.sqrt(np.diag(vehicle.uncertainty.size_covariance)) < 0.06 * size).all()


def test_a_model_of_a_size_is_the_prepared_one_but_for_what_hides_what():
    prior, size = load_prior("car14"), SizePrior("one", np.array([4.2, 1.7, 1.45]), np.array([0.2, 0.08, 0.07]))
    own, made = sized(prepare(prior), size), prepare(prior, size)
    assert np.array_equal(own.prior.mean, made.prior.mean)
    assert np.array_equal(own.outline.mean, made.outline.mean)
    assert own.size is made.size is size
    pose = yaw_pose(0.5)[None]
    assert own.visibility.lookup(pose) == pytest.approx(made.visibility.lookup(pose), abs=0.15)


@pytest.mark.parametrize("turned", [0.05, 0.4])
def test_what_a_box_says_of_the_heading(turned):
    belief = Belief.none().updated(box_evidence(0.7, np.radians(10), turned))
    assert belief.facing(0.7) == pytest.approx(1.0 - turned, abs=0.04)
    assert belief.heading == pytest.approx(0.7, abs=0.1)


def test_bad_boxes_are_refused():
    _, seen, boxes = street(1, count=2)
    with pytest.raises(InvalidInputError, match="boxes"):
        reconstruct_scene(seen, CAMERA, boxes=boxes[:1])
    with pytest.raises(InvalidInputError, match="focal"):
        reconstruct_scene(seen, Camera.of_unknown(1242, 375), boxes=boxes)
    for wrong in ({"depth": 0.0}, {"yaw": np.nan}, {"flip_probability": 0.6}, {"size": "much"}, {"bearing": -1.0}):
        with pytest.raises(InvalidInputError, match=f"box_errors.{next(iter(wrong))}"):
            BoxErrors(**wrong)


def test_what_says_nothing_or_the_contrary_leaves_a_box_as_it_is():
    pose = yaw_pose(0.6)
    given = Box3D(pose[:3, 3], 0.6, np.array([4.5, 1.8, 1.6]))
    nothing = refined(given, BoxErrors(), None, DegenerateProblemError("keypoints", "no measured point", "Give some."))
    assert (nothing.changed, nothing.box is given) == (False, True)
    assert "no measured point" in nothing.message
    result = fgrecon.reconstruct(observe(load_prior("car14"), pose), CAMERA, options=OPTIONS)
    assert refined(given, BoxErrors(), result, None).changed
    farther = Box3D(1.6 * pose[:3, 3], 0.6, given.size)
    kept = refined(farther, BoxErrors(), result, None)
    assert not kept.changed
    assert "nearer" in kept.message
    across = Box3D(pose[:3, 3], 0.6 + np.radians(70), given.size)
    assert "degrees against the box" in refined(across, BoxErrors(), result, None).message
    assert refined(Box3D(pose[:3, 3], 0.6 + np.pi, given.size), BoxErrors(), result, None).flipped
    plain = refined(given, BoxErrors(), result, None).to_dict()
    assert plain["sigma"]["rotation_y"] > 0.0
    assert plain["changed"] is True
    assert refined(farther, BoxErrors(), result, None).to_dict()["sigma"]["location"] is None


def test_regions_rest_on_what_the_keypoints_brought_with_them():
    _, seen, boxes = street(0, count=1)
    plain = reconstruct_scene(seen, CAMERA, boxes=boxes, options=OPTIONS).vehicles[0]
    assert plain.uncertainty.regions is Regions.ASSUMED
    given = [replace(one, covariance=np.tile(4.0 * np.eye(2), (14, 1, 1))) for one in seen]
    assert (
        reconstruct_scene(given, CAMERA, boxes=boxes, options=OPTIONS).vehicles[0].uncertainty.regions
        is Regions.SHIPPED
    )
