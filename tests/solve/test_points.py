"""Vehicles with measured points: where the picture alone is metres off, and where there is hardly a picture."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy.optimize import minimize

from factors import L, X
from factors.mixture import Form
from fgrecon import (
    Camera,
    Observation,
    Options,
    Points,
    Reconstruction,
    SizePrior,
    Status,
    Tracker,
    reconstruct,
    reconstruct_scene,
    reconstruct_track,
)
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.point_search import search_with_points
from fgrecon.solve.proposals.point_term import with_its_points
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import best_of
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.vehicle.visibility import clearance, probability

CAMERA = Camera.of(np.array([[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]]))
PRIOR = load_prior("car14")
SHAPE = np.array([1.5, -1.0, 0.3, 0.2, -0.4])


def scanned(
    yaw: float, place: np.ndarray, seed: int = 0, count: int = 120, prior: ShapePrior = PRIOR
) -> tuple[Observation, np.ndarray]:
    """A car larger than the mean: what a network says of it, and a scan of it, of the road and of a wall."""
    rng = np.random.default_rng(seed)
    rotation, surface = yaw_rotation(yaw), prior.surface
    assert surface is not None
    vertices, centre = surface.vertices(SHAPE), -rotation.T @ place
    corners = vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shown = np.flatnonzero(((centre - corners.mean(axis=1)) * normals).sum(axis=1) > 0.0)
    share = rng.dirichlet(np.ones(3), count)
    local = (corners[rng.choice(shown, count)] * share[:, :, None]).sum(axis=1)
    road = rng.uniform([-4.0, 0.0, -4.0], [4.0, 0.0, 4.0], (60, 3))
    wall = rng.uniform([-9.0, -3.0, 0.0], [9.0, 0.0, 0.5], (40, 3)) + np.array([0.0, 0.0, 6.0])
    points = np.concatenate([local @ rotation.T, road, wall]) + place
    keypoints = prior.keypoints(SHAPE)
    seen = probability(clearance(vertices, surface.faces, keypoints, centre))
    pixels = CAMERA.project(keypoints @ rotation.T + place) + rng.normal(0.0, 1.5, (14, 2))
    outline = CAMERA.project(vertices @ rotation.T + place)
    box = np.concatenate([outline.min(axis=0), outline.max(axis=0)])
    points += 0.02 * rng.normal(0.0, 1.0, (len(points), 3))
    return Observation.of(pixels, np.where(seen > 0.5, 0.9, 0.1), box), points


PLACE = np.array([2.0, 1.65, 18.0])
OPTIONS = Options(keep_history=False)


@pytest.mark.parametrize("yaw", [-1.5, -0.8, 0.4, 2.2])
def test_points_tell_the_depth(yaw: float) -> None:
    observation, points = scanned(yaw, PLACE)
    alone = reconstruct(observation, CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS)
    sensed = reconstruct(
        observation, CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS, evidence=[Points(points)]
    )
    assert np.linalg.norm(alone.location - PLACE) > 0.8  # a larger car than the fleet's mean is nearer by the picture
    assert np.linalg.norm(sensed.location - PLACE) < 0.3
    weights, looked_at = sensed.diagnostics.point_weights, sensed.diagnostics.points
    assert weights.shape == (len(looked_at),)
    assert 40 < weights.sum() < 120
    assert sensed.diagnostics.energies["points"] > 0.0
    assert sensed.diagnostics.evidence["points"] > 1.5  # times smaller is the position's standard deviation
    assert not alone.diagnostics.evidence
    assert not len(alone.diagnostics.points)
    covariance, before = sensed.uncertainty.pose_covariance, alone.uncertainty.pose_covariance
    assert covariance is not None
    assert before is not None
    assert np.trace(covariance[3:, 3:]) < 0.5 * np.trace(before[3:, 3:])


@pytest.mark.parametrize("yaw", [-1.5, 0.4])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (-1.0, 0.0, 0.0), (2.0, 0.0, 0.0)])
def test_a_vehicle_is_weak_where_points_put_it_beside_its_keypoints(yaw: float, shift: tuple[float, ...]) -> None:
    observation, points = scanned(yaw, PLACE)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = reconstruct(observation, CAMERA, size_prior="kitti", evidence=[Points(points + np.array(shift))])
    sure = observation.confidence > 0.5
    beside = float(np.median(np.linalg.norm(found.pose.wireframe_uv - observation.keypoints, axis=1)[sure]))
    named = any(reason.startswith("points on it contradict") for reason in found.reasons)
    assert named == (beside > 20.0), (beside, found.reasons)  # pixels; 1.5 is the noise
    assert named == any("Measured points put the vehicle" in str(one.message) for one in warned)
    assert not (named and found.status is Status.CONVERGED)


@pytest.mark.parametrize("yaw", [-1.5, 0.4])
def test_points_tell_that_a_vehicle_is_as_high_as_a_van(yaw: float) -> None:
    size = np.array([5.0, 1.9, 2.2])
    van = PRIOR.for_fleet(SizePrior("van", size, 0.05 * size))
    observation, points = scanned(yaw, PLACE, count=200, prior=van)
    found = reconstruct(
        observation, CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS, evidence=[Points(points)]
    )
    assert abs(found.box_size[2] - van.box_size(SHAPE)[2]) < 0.3  # the fleet's mean is as high as a car
    assert np.linalg.norm(found.location - PLACE) < 0.45


def test_a_step_of_the_result_does_not_lower_the_energy() -> None:
    """Scipy's minimiser, from the result on, finds nothing lower in the energy of pose and shape."""
    observation, points = scanned(0.4, PLACE)
    setup = SolveSetup.of("car14", "kitti", OPTIONS, 1.65)
    problem = Problem.of(replace(observation, evidence=(Points(points),)), CAMERA, setup.model, setup.ground, OPTIONS)
    start = search_pose(problem)
    adjusted = minimise_from_proposals([GraphObservation(problem)], [start])
    graph, values, weights = adjusted.graph, adjusted.optimum.values, adjusted.optimum.state.weights
    graph.look(values)
    system = graph.system(values)
    graph.step(system.point(values), weights, Form.NEWTON)
    keys = [X(0, 0), L(0)]

    def energy(step: np.ndarray) -> float:
        moved = gtsam.Values(values)
        moved.update(keys[0], values.atPose3(keys[0]).retract(step[:6]))
        moved.update(keys[1], values.atVector(keys[1]) + step[6:])
        return graph.error(system.point(moved))

    found = minimize(energy, np.zeros(11), method="BFGS")
    assert energy(np.zeros(11)) - found.fun < 1e-3
    assert np.abs(found.x[:6]).max() < 2e-3


@pytest.mark.parametrize("lost", [True, False])
def test_where_the_picture_ended_elsewhere_the_search_goes_all_round(lost: bool) -> None:
    observation, points = scanned(0.4, PLACE)
    setup = SolveSetup.of("car14", "kitti", OPTIONS, 1.65)
    problem = Problem.of(replace(observation, evidence=(Points(points),)), CAMERA, setup.model, setup.ground, OPTIONS)
    aside = np.eye(4)
    aside[:3, 3] = 40.0, 1.0, 12.0
    found = search_with_points(problem, Hypotheses.at_poses(aside[None], PRIOR.dimension), 0.0 if lost else 5.0)
    assert (np.linalg.norm(found.poses[0, :3, 3] - PLACE) < 1.0) == lost


@pytest.mark.parametrize("count", [1, 16, 200])
def test_the_best_starts_are_those_of_the_least_energies(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Though those are given up early whose energies are above the best."""
    observation, points = scanned(-0.8, PLACE)
    setup = SolveSetup.of(PRIOR, "kitti", OPTIONS, 1.65)
    given = observation.with_evidence([Points(points)])
    energy = Problem.of(given, CAMERA, setup.model_of([given], [CAMERA]), setup.ground, OPTIONS).energy
    assert energy.points
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, :3] = [yaw_rotation(yaw) for yaw in rng.uniform(-3.0, 3.0, 60)]
    poses[:, :3, 3] = PLACE + rng.normal(0.0, [1.0, 0.1, 3.0], (60, 3))
    starts = Hypotheses.at_poses(poses, PRIOR.dimension)
    expected = starts.take(np.argsort(energy.evaluate(starts)[0].energy, kind="stable")[:count])
    assert (best_of(energy, starts, count).translation == expected.translation).all()
    monkeypatch.setenv("FGRECON_KERNEL", "numpy")
    assert (best_of(replace(energy), starts, count).translation == expected.translation).all()


def test_an_empty_scan_is_none() -> None:
    observation, _ = scanned(-0.8, PLACE)
    how = {"ground": 1.65, "size_prior": "kitti", "options": OPTIONS}
    alone = reconstruct(observation, CAMERA, **how)
    empty = reconstruct(observation, CAMERA, **how, evidence=[Points(np.zeros((0, 3)))])
    assert (empty.camera_T_object == alone.camera_T_object).all()


def test_a_vehicle_without_keypoints() -> None:
    observation, points = scanned(-0.8, PLACE)
    none = replace(observation, keypoints=np.full((14, 2), np.nan), evidence=(Points(points),))
    found = reconstruct(none, CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS)
    assert np.linalg.norm(found.location - PLACE) < 0.5
    turn = abs((found.rotation_y + 0.8 + np.pi / 2.0) % np.pi - np.pi / 2.0)  # which way it faces nobody says
    assert turn < np.deg2rad(6.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_vehicle_whose_end_shows_behind_a_wall_is_not_the_wall(seed: int) -> None:
    """Its 2D box is that of all of it, and most of the points in there are the wall's."""
    observation, points = scanned(-0.1, PLACE, seed, count=160)
    assert observation.box is not None
    shown = CAMERA.project(points)[:, 0] < observation.box[0] + 0.5 * (observation.box[2] - observation.box[0])
    left = (observation.box[0] + 0.55 * (observation.box[2] - observation.box[0]) - 600.0) / 700.0
    x, y = np.meshgrid(np.arange(13.0 * left, 13.0 * left + 6.0, 0.15), np.arange(-1.5, 1.6, 0.15))
    wall = np.stack([x.ravel(), y.ravel(), np.full(x.size, 13.0)], axis=1)
    none = replace(observation, keypoints=np.full((14, 2), np.nan))
    scan = Points(np.concatenate([points[shown], wall]))
    found = reconstruct(none, CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS, evidence=[scan])
    assert np.linalg.norm(found.location - PLACE) < 0.3


@pytest.mark.parametrize(("aside", "blind"), [(0.0, False), (0.4, False), (0.4, True)])
def test_a_hidden_vehicle_leaves_the_points_of_the_one_before_it(aside: float, blind: bool) -> None:
    """By itself it is five metres too near, on the other's points, though none of its keypoints be measured."""
    places = PLACE, PLACE + np.array([aside, 0.0, 4.5])
    (front, points), (back, few) = (scanned(-1.5, place, seed) for seed, place in enumerate(places, start=1))
    if blind:
        back = replace(back, keypoints=np.full((14, 2), np.nan))
    options = Options(keep_history=False, box="cuboid")
    scan = Points(np.concatenate([points, few[:5]]))
    scene = reconstruct_scene([front, back], CAMERA, ground=1.65, size_prior="kitti", options=options, evidence=[scan])
    for vehicle, place in zip(scene.vehicles, places, strict=True):
        assert np.linalg.norm(vehicle.location - place) < 0.5


@pytest.mark.parametrize("seen_before", [True, False])
def test_over_time_too_a_hidden_vehicle_leaves_the_points_of_the_one_before_it(seen_before: bool) -> None:
    """Whether it is new or was seen before; the one that hides it was, and is where it is expected."""
    places = PLACE, PLACE + np.array([0.4, 0.0, 4.5])
    tracker = Tracker(size_prior="kitti", options=Options(keep_history=False, box="cuboid"))
    for frame in range(3):
        (front, points), (back, few) = (scanned(-1.5, at, 10 * frame + i) for i, at in enumerate(places, start=1))
        hidden = frame == 2
        back = replace(back, keypoints=np.full((14, 2), np.nan)) if hidden else back
        vehicles = {1: front, 2: back} if hidden or seen_before else {1: front}
        scan = Points(np.concatenate([points, few[: 5 if hidden else 120]]))
        found = tracker.update(frame / 10.0, vehicles, camera=CAMERA, ground=1.65, evidence=[scan])
    for number, place in enumerate(places, start=1):
        assert np.linalg.norm(found[number].reconstruction.location - place) < 0.5


def test_vehicles_of_an_image_with_one_scan_and_a_factor_of_ones_own() -> None:
    one, points = scanned(-1.5, PLACE)
    other_place = np.array([-3.0, 1.65, 14.0])
    other, more = scanned(-1.4, other_place, seed=1)
    scan = Points(np.concatenate([points, more]))
    found = reconstruct_scene([one, other], CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS, evidence=[scan])
    for vehicle, place in zip(found.vehicles, (PLACE, other_place), strict=True):
        assert np.linalg.norm(vehicle.location - place) < 0.35
    pulled = gtsam.Pose3(gtsam.Rot3(yaw_rotation(-1.5)), PLACE + np.array([0.5, 0.0, 0.0]))
    factor = gtsam.PriorFactorPose3(X(0, 0), pulled, gtsam.noiseModel.Isotropic.Sigma(6, 1e-3))
    held = reconstruct_scene(
        [one, other], CAMERA, ground=1.65, size_prior="kitti", options=OPTIONS, extra_factors=[factor]
    )
    assert held.vehicles[0].location == pytest.approx(pulled.translation(), abs=0.02)


def test_over_images_and_over_time() -> None:
    places = [PLACE + np.array([0.0, 0.0, 0.5 * i]) for i in range(3)]
    frames = [scanned(-1.2, place, seed=i) for i, place in enumerate(places)]
    track = reconstruct_track(
        [one for one, _ in frames],
        CAMERA,
        ground=1.65,
        size_prior="kitti",
        options=OPTIONS,
        evidence=[[Points(points)] for _, points in frames],
    )
    for frame, place in zip(track.frames, places, strict=True):
        assert np.linalg.norm(frame.location - place) < 0.3
    tracker = Tracker(size_prior="kitti")
    for i, (one, points) in enumerate(frames):
        estimates = tracker.update(i / 10.0, {7: one}, camera=CAMERA, ground=1.65, evidence=[Points(points)])
    assert np.linalg.norm(estimates[7].reconstruction.location - places[-1]) < 0.3
    smoothed = [one.reconstruction for one in tracker.smooth()[7]]
    for found in (*track.frames, estimates[7].reconstruction, *smoothed):
        assert found.diagnostics.evidence["points"] > 1.0
    kept = [one.problem.observation.evidence[0].points for one in tracker._tracks[7].vehicle.past]
    assert max(map(len, kept)) <= len(estimates[7].reconstruction.diagnostics.points) + 20 < len(frames[0][1])
    (seen, points), far = frames[-1], np.array([[30.0, 1.0, 40.0], [0.0, 1.0, 90.0]])
    own = with_its_points(seen.with_evidence([Points(np.concatenate([far, points]))]), CAMERA)
    assert with_its_points(own, CAMERA).evidence[0].points.tolist() == own.evidence[0].points.tolist()
    how = {"size_prior": "kitti", "options": OPTIONS}
    both = Points(np.concatenate([far, points])), own.evidence[0]
    first, again = (reconstruct(seen, CAMERA, evidence=[one], **how) for one in both)
    assert (first.diagnostics.points == again.diagnostics.points).all()


def test_points_of_another_frame_are_refused() -> None:
    observation, points = scanned(0.4, PLACE)
    lidar = points[:, [2, 0, 1]] * (1.0, -1.0, -1.0)
    with pytest.raises(InvalidInputError, match=r"^evidence\[0\].*LiDAR"):
        reconstruct(observation, replace(CAMERA, image_size=(1242, 375)), evidence=[Points(lidar)])
    with pytest.raises(InvalidInputError, match="1 for 2 images"):
        reconstruct_track([observation, observation], CAMERA, evidence=[[]])


@pytest.mark.parametrize("kind", ["vehicle", "image", "track", "online"])
def test_the_ground_that_is_given_tells_frame_and_unit(kind: str) -> None:
    observation, points = scanned(0.4, PLACE)
    camera = replace(CAMERA, image_size=(1242, 375))
    how: dict[str, Any] = {"ground": 1.65}
    calls: dict[str, Callable[[list[Points]], object]] = {
        "vehicle": lambda given: reconstruct(observation, camera, evidence=given, **how),
        "image": lambda given: reconstruct_scene([observation], camera, evidence=given, **how),
        "track": lambda given: reconstruct_track([observation], camera, evidence=[given], **how),
        "online": lambda given: Tracker().update(0.0, {0: observation}, camera=camera, evidence=given, **how),
    }
    for wrong, named in ((points * (1.0, -1.0, 1.0), "y up, z forward"), (points / 0.3048, "feet")):
        with pytest.raises(InvalidInputError, match=named):
            calls[kind]([Points(wrong)])


@pytest.mark.parametrize("kind", ["vehicle", "image", "track", "online"])
def test_points_elsewhere_change_nothing(kind: str) -> None:
    """Nor does the size get free by them: two points about a vehicle are as good as none."""
    observation, points = scanned(0.4, PLACE)
    elsewhere = Points(np.concatenate([np.array([[-8.0, 1.0, 30.0 + i] for i in range(50)]), points[:2]]))
    how = {"ground": 1.65, "size_prior": "kitti", "options": OPTIONS}

    def solved(evidence: list[Points]) -> Reconstruction:
        if kind == "vehicle":
            return reconstruct(observation, CAMERA, evidence=evidence, **how)
        if kind == "image":
            return reconstruct_scene([observation], CAMERA, evidence=evidence, **how).vehicles[0]
        if kind == "track":
            return reconstruct_track([observation] * 2, CAMERA, evidence=[evidence] * 2, **how).frames[1]
        tracker = Tracker(size_prior="kitti", options=OPTIONS)
        for i in range(2):
            found = tracker.update(i / 10.0, {0: observation}, camera=CAMERA, ground=1.65, evidence=evidence)
        return found[0].reconstruction

    alone, sensed = solved([]), solved([elsewhere])
    assert np.array_equal(alone.camera_T_object, sensed.camera_T_object)
    assert np.array_equal(alone.box_size, sensed.box_size)


def test_points_can_be_left_out_as_any_term() -> None:
    observation, points = scanned(0.4, PLACE)
    off = Options(keep_history=False, disabled_terms={*OPTIONS.disabled_terms, "points"})
    alone = reconstruct(observation, CAMERA, ground=1.65, options=off)
    sensed = reconstruct(observation, CAMERA, ground=1.65, options=off, evidence=[Points(points)])
    assert np.array_equal(alone.camera_T_object, sensed.camera_T_object)
