"""All vehicles of an image on one ground: the ground comes out, the vehicles come closer, outliers stay outliers."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.camera import Ground
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options, ShapeOptions
from fgrecon.core.reconstruction import Status
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.image_ground import own_deviations
from fgrecon.solve.independent import solve_independently
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes
from fgrecon.solve.vehicle.model import prepare
from tests.cars import CAMERA, observe

PITCH = np.radians(1.5)  # the camera looks up: the road falls away from its y axis


def on_the_road(rng, *, off=0.0, height=1.65, pitch=PITCH):
    """A pose on a road that a camera of that pitch sees."""
    turn = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    yaw = rng.uniform(-np.pi, np.pi)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    pose[:3, 3] = [rng.uniform(-6, 6), height + off, rng.uniform(14, 40)]
    pose[:3] = turn @ pose[:3]
    return pose, turn @ [0.0, 1.0, 0.0]


def street(seed, count=5, **road):
    rng = np.random.default_rng(seed)
    prior = load_prior("car14").for_fleet(fgrecon.SIZE_PRIORS["kitti"])
    poses = [on_the_road(rng, **road)[0] for _ in range(count)]
    seen = [observe(prior, pose, 0.7 * rng.normal(size=5), noise=1.5, seed=seed + i) for i, pose in enumerate(poses)]
    return poses, seen


def errors_of(scene, poses):
    return np.array(
        [
            np.linalg.norm(vehicle.location - poses[number][:3, 3])
            for number, vehicle in zip(scene.numbers, scene.vehicles, strict=True)
        ]
    )


def test_a_pitched_camera_is_found_and_cars_come_closer():
    """Given a level camera 1.65 m up; the road is pitched by 1.5 degrees."""
    alone, together, pitches = [], [], []
    for seed in range(4):
        poses, seen = street(10 * seed)
        single = [fgrecon.reconstruct(one, CAMERA, ground=1.65, size_prior="kitti") for one in seen]
        alone += [np.linalg.norm(one.location - pose[:3, 3]) for one, pose in zip(single, poses, strict=True)]
        scene = reconstruct_scene(seen, CAMERA, ground=1.65, size_prior="kitti")
        together += errors_of(scene, poses).tolist()
        pitches.append(np.arctan2(scene.ground.normal[2], scene.ground.normal[1]))
        assert scene.ground_covariance.shape == (3, 3)
        sigma = np.sqrt(np.diag(scene.ground_covariance))
        assert (sigma[0] < 0.2, sigma[1] < 0.0125) == (True, True)  # surer than what was given
    _, normal = on_the_road(np.random.default_rng(0))
    truth = np.arctan2(normal[2], normal[1])
    assert np.abs(np.array(pitches) - truth).mean() < 0.5 * abs(truth)
    assert np.mean(together) < 0.85 * np.mean(alone)


@pytest.mark.parametrize("images", [1, 2])
def test_a_vehicle_that_is_given_twice_is_named(images):
    """As by a detector that leaves overlapping boxes; in another image it may be."""
    _, seen = street(3)
    again = replace(seen[1], keypoints=seen[1].keypoints + 0.5)
    given = [[*seen, again]] if images == 1 else [seen, [again]]
    scenes = reconstruct_scenes(given, CAMERA, size_prior="kitti")
    found = {(i, n): one for i, s in enumerate(scenes) for n, one in zip(s.numbers, s.vehicles, strict=True)}
    twice = {key: one.reasons[-1] for key, one in found.items() if any("in its place" in why for why in one.reasons)}
    if images == 2:
        assert twice == {}
        return
    said = {
        (0, 1): "vehicle 5 is in its place: is one given twice?",
        (0, 5): "vehicle 1 is in its place: is one given twice?",
    }
    assert twice == said
    assert all(found[key].status is Status.WEAK for key in twice)


@pytest.mark.parametrize(
    ("ground", "size_prior", "furthest"), [(None, "kitti", 0.05), (Ground.of_height(6.0), None, 0.09)]
)
def test_a_roadside_camera_is_found(ground, size_prior, furthest):
    """6 m up, 15 degrees down; given are sizes or the height alone: cars are 7 % smaller than the prior's mean."""
    tilts, heights, shares = [], [], []
    for seed in (3, 4, 5):
        poses, seen = street(seed, count=6, height=6.0, pitch=np.radians(15.0))
        scene = reconstruct_scene(seen, CAMERA, ground=ground, size_prior=size_prior)
        _, normal = on_the_road(np.random.default_rng(0), pitch=np.radians(15.0))
        tilts.append(np.degrees(np.arccos(scene.ground.normal @ normal)))
        heights.append(scene.ground.distance)
        shares += (errors_of(scene, poses) / np.linalg.norm(np.array(poses)[:, :3, 3], axis=1)).tolist()
    assert np.median(tilts) < 1.0
    np.testing.assert_allclose(heights, 6.0, rtol=0.1 if ground is None else 0.02)
    assert np.median(shares) < furthest


def test_a_vaguely_given_ground_leaves_vehicles_as_near_to_it():
    """What is not known is the plane; the vehicles stand on it as on any other."""
    known, vague = Ground.level(1.65), Ground.of_height(1.65)
    assert (known.is_vague, vague.is_vague) == (False, True)
    assert own_deviations(vague, 20.0) == own_deviations(known, 20.0)
    narrow = replace(known, height_sigma=0.01, slope_sigma=0.001)
    assert all(np.less(own_deviations(narrow, 20.0), own_deviations(known, 20.0)))


def test_one_vehicle_is_as_alone():
    _, seen = street(0, count=1)
    scene = reconstruct_scene(seen, CAMERA, ground=1.65)
    alone = fgrecon.reconstruct(seen[0], CAMERA, ground=1.65)
    np.testing.assert_array_equal(scene.vehicles[0].camera_T_object, alone.camera_T_object)
    assert scene.ground_covariance is None
    assert "one by one" in scene.message


def test_a_vehicle_that_is_left_alone_is_solved_to_the_end():
    """Its neighbour is refused: it was to be solved with that one, and ended alone before it was at its minimum."""
    _, seen = street(0, count=1)
    nothing = Observation(np.full((14, 2), np.nan), np.zeros(14))
    scene = reconstruct_scene([nothing, *seen], CAMERA, ground=1.65)
    alone = fgrecon.reconstruct(seen[0], CAMERA, ground=1.65)
    np.testing.assert_array_equal(scene.vehicles[0].camera_T_object, alone.camera_T_object)
    assert scene.numbers == (1,)


def test_a_vehicle_on_another_road_leaves_the_plane_to_the_others():
    poses, seen = street(5, count=5)
    rng = np.random.default_rng(99)
    above, _ = on_the_road(rng, off=-1.5)
    prior = load_prior("car14").for_fleet(fgrecon.SIZE_PRIORS["kitti"])
    with_it = reconstruct_scene([*seen, observe(prior, above, noise=1.5)], CAMERA, ground=1.65, size_prior="kitti")
    without = reconstruct_scene(seen, CAMERA, ground=1.65, size_prior="kitti")
    assert np.degrees(np.arccos(with_it.ground.normal @ without.ground.normal)) < 0.35
    assert errors_of(with_it, [*poses, above])[:-1].mean() < errors_of(without, poses).mean() + 0.2


def test_what_cannot_be_solved_is_refused_and_the_rest_goes_on():
    _, seen = street(1, count=3)
    nothing = Observation(np.full((14, 2), np.nan), np.zeros(14))
    scene = reconstruct_scene([seen[0], nothing, *seen[1:]], CAMERA, ground=Ground.level(1.65))
    assert scene.numbers == (0, 2, 3)
    assert list(scene.refused) == [1]
    assert isinstance(scene.refused[1], DegenerateProblemError)
    assert all(vehicle.status in (Status.CONVERGED, Status.AMBIGUOUS) for vehicle in scene.vehicles)
    assert {step.stage for step in scene.vehicles[0].diagnostics.history} == {
        "initialisation",
        "pose",
        "joint",
        "scene",
    }
    assert scene.vehicles[0].diagnostics.energies["ground"] >= 0.0
    assert "3 vehicles, 1 refused" in repr(scene)


@pytest.mark.parametrize("seed", range(3))
def test_a_vehicle_that_nothing_determines_leaves_the_others_as_without_it(seed):
    """No keypoint of it is believed: the joint graph has no covariances with it, and its neighbours none either."""
    pixels = np.random.default_rng(seed).uniform([0, 0], [1200, 370], (14, 2))
    nothing = Observation(pixels, np.full(14, 0.02))
    images = [street(40 + seed, count=2)[1], street(50 + seed, count=2)[1]]
    known, without = (reconstruct_scene(seen, CAMERA, ground=1.65) for seen in ([*images[0], nothing], images[0]))
    for one, other in zip(known.vehicles, without.vehicles, strict=False):
        np.testing.assert_allclose(one.location, other.location, rtol=0.04, atol=0.05)  # it may tell of the fleet
        assert one.rotation_y == pytest.approx(other.rotation_y, abs=0.02)
        np.testing.assert_allclose(
            one.uncertainty.pose_covariance, other.uncertainty.pose_covariance, rtol=0.15, atol=1e-3
        )
    assert len(known.vehicles) == 3
    camera = replace(CAMERA, focal_sigma=0.5)
    shared, plain = (
        reconstruct_scenes(seen, camera, ground=1.65) for seen in ([[*images[0], nothing], images[1]], images)
    )
    assert shared[0].camera.focal_sigma == pytest.approx(plain[0].camera.focal_sigma, rel=0.05)
    assert shared[0].camera.matrix[0, 0] == pytest.approx(plain[0].camera.matrix[0, 0], rel=0.05)
    assert all(one.uncertainty.pose_covariance is not None for scene in shared for one in scene.vehicles[:2])


def test_the_same_input_gives_the_same_bits():
    _, seen = street(2, count=3)
    first, second = (reconstruct_scene(seen, CAMERA, ground=1.65) for _ in range(2))
    for one, other in zip(first.vehicles, second.vehicles, strict=True):
        assert one.camera_T_object.tobytes() == other.camera_T_object.tobytes()


def test_a_fixed_pose_is_refused():
    with pytest.raises(InvalidInputError, match="joint"):
        reconstruct_scene([], CAMERA, options=Options(shape=ShapeOptions(joint=False)))
    assert reconstruct_scene([], CAMERA).vehicles == ()


def test_vehicles_of_other_images_do_not_say_which_way_one_faces():
    prior = load_prior("car14")
    setup = SolveSetup(Options(), prior, prepare(prior))
    bins = 2.0 * np.pi * np.arange(36) / 36
    seen = []
    for yaw, place, sure in ((0.2, [1.0, 1.65, 12.0], 0.55), (0.25, [1.0, 1.65, 20.0], 0.999)):
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
        pose[:3, 3] = place
        towards = float(view_azimuth(pose[:3, :3], pose[:3, 3]))
        ahead = np.exp((np.cos(bins - towards) - 1.0) / 0.1)
        azimuth = (sure * ahead + (1.0 - sure) * np.roll(ahead, 18)) / ahead.sum()
        seen.append(replace(observe(prior, pose, np.zeros(5), noise=1.0, seed=3), azimuth=azimuth))
    apart = solve_independently(seen, CAMERA, setup, image_of=[0, 1])
    together = solve_independently(seen, CAMERA, setup)
    for number, one in enumerate(seen):
        np.testing.assert_array_equal(apart.vehicles[number].problem.observation.azimuth, one.azimuth)
    assert not np.allclose(together.vehicles[0].problem.observation.azimuth, seen[0].azimuth)


@pytest.mark.parametrize("kernel", ["compiled", "numpy"])
def test_each_vehicle_has_all_its_terms_and_its_factors(kernel, monkeypatch):
    """As one alone; what ties it to the ground is the term `ground`."""
    if kernel == "numpy":
        monkeypatch.setenv("FGRECON_KERNEL", "numpy")
    _, seen = street(1, count=2)
    scene = reconstruct_scene(seen, CAMERA, ground=1.65, size_prior="kitti")
    for number, (one, vehicle) in enumerate(zip(seen, scene.vehicles, strict=True)):
        alone = fgrecon.reconstruct(one, CAMERA, ground=1.65, size_prior="kitti").diagnostics
        found = vehicle.diagnostics
        assert set(found.energies) == set(alone.energies)
        assert found.history[-1].energies == pytest.approx(found.energies)
        assert {"pose", "joint", "scene"} <= {step.stage for step in found.history}
        variables = {name for factor in found.graph for name in factor.variables}
        assert variables == {f"X(v={number},t=0)", f"L(v={number})", f"O(v={number})", f"M(v={number})", "G(t=0)"}
        keypoints = [[one.label for one in graph if one.term == "reprojection"] for graph in (found.graph, alone.graph)]
        assert keypoints[0] == keypoints[1]
