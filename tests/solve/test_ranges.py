"""Ranges and range rates of a vehicle beside its keypoints, in one image and over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgrecon import Observation, Options, Range, RangeRate, Tracker, reconstruct, reconstruct_scene, reconstruct_track
from fgrecon.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation import yaw_pose
from tests.cars import CAMERA, observe

PLACE = np.array([3.0, 1.65, 22.0])
SHAPE = [1.5, 0.6, -0.4, 0.2, 0.1]
ORIGIN = np.array([0.3, 0.5, 1.0])


def seen(place: np.ndarray = PLACE, yaw: float = 1.9, seed: int = 0) -> Observation:
    return observe(load_prior("car14"), yaw_pose(yaw, place), SHAPE, noise=1.0, seed=seed)


def nearest(place: np.ndarray, yaw: float) -> float:
    """Metres from the sensor to the cuboid of the vehicle."""
    rotation, prior = yaw_pose(yaw, place)[:3, :3], load_prior("car14")
    length, width, height = prior.box_size(np.array(SHAPE))
    sensor = rotation.T @ (ORIGIN - place)
    inside = np.clip(sensor, [-length / 2, -height, -width / 2], [length / 2, 0.0, width / 2])
    return float(np.linalg.norm(sensor - inside))


@pytest.mark.parametrize("to_centre", [True, False])
def test_a_range_tells_the_depth(to_centre: bool) -> None:
    height = load_prior("car14").box_size(np.array(SHAPE))[2]
    middle = float(np.linalg.norm(PLACE - [0.0, height / 2.0, 0.0] - ORIGIN))
    measured = Range(middle if to_centre else nearest(PLACE, 1.9), 0.05, ORIGIN, to_centre)
    alone, sensed = (reconstruct(seen(), CAMERA, evidence=some) for some in ((), [measured]))
    before, after = (np.linalg.norm(one.location - PLACE) for one in (alone, sensed))
    assert before > 0.5
    assert after < 0.2
    assert sensed.diagnostics.evidence["range"] > 2.0  # times smaller is the position's standard deviation
    assert "range" not in alone.diagnostics.evidence
    assert sensed.diagnostics.energies["range"] < 2.0
    off = Options(disabled_terms={"range", "laplacian", "planarity"})
    without = reconstruct(seen(), CAMERA, options=off, evidence=[measured])
    assert np.array_equal(without.camera_T_object, alone.camera_T_object)


def test_each_vehicle_of_a_scene_and_each_image_has_its_own() -> None:
    other = np.array([-4.0, 1.65, 15.0])
    given = [
        seen().with_evidence([Range(nearest(PLACE, 1.9), 0.05, ORIGIN)]),
        seen(other, 0.4, seed=1).with_evidence([Range(nearest(other, 0.4), 0.05, ORIGIN)]),
    ]
    scene = reconstruct_scene(given, CAMERA)
    for vehicle, place in zip(scene.vehicles, (PLACE, other), strict=True):
        assert np.linalg.norm(vehicle.location - place) < 0.25
    with pytest.raises(InvalidInputError, match=r"^evidence\[0\].*Observation"):
        reconstruct_scene(given, CAMERA, evidence=[Range(20.0, 0.1)])
    with pytest.raises(InvalidInputError, match=r"^evidence\[0\].*Tracker"):
        reconstruct(given[0], CAMERA, evidence=[RangeRate(1.0, 0.1)])
    rated = given[0].with_evidence([RangeRate(1.0, 0.1)])
    with pytest.raises(InvalidInputError, match=r"^evidence: .*Tracker.*without times"):
        reconstruct(rated, CAMERA)
    for refused in (
        reconstruct_scene([given[1], rated], CAMERA).refused[1],
        reconstruct_track([given[0], rated], CAMERA).refused[1],
    ):
        assert "to a `Tracker`: images without times have no velocity" in str(refused)
    track = reconstruct_track([given[0], seen(seed=2)], CAMERA)
    assert np.linalg.norm(track.frames[0].location - PLACE) < 0.25


def driven(rates: bool, *, over_ground: bool = False) -> tuple[float, float]:
    """How far off the speed of a vehicle ahead is in the end, and its standard deviation, metres per second."""
    tracker, speed, own = Tracker(size_prior="kitti"), 14.0, 10.0
    for i in range(5):
        time = i / 10.0
        place = np.array([2.0, 1.65, 20.0 + (speed - own) * time])
        one = seen(place, -np.pi / 2.0, seed=i)  # drives away
        ray = place[2] / np.linalg.norm(place - [0.0, 0.75, 0.0])
        rate = RangeRate(ray * (speed if over_ground else speed - own), 0.1, over_ground=over_ground)
        one = replace(one, evidence=(rate,)) if rates else one
        pose = np.eye(4)
        pose[2, 3] = own * time
        estimate = tracker.update(time, {3: one}, camera=CAMERA, ground=1.65, world_T_camera=pose)[3]
    assert estimate.velocity is not None
    assert estimate.velocity_covariance is not None
    return abs(float(estimate.velocity[2]) - speed), float(np.sqrt(estimate.velocity_covariance[2, 2]))


def test_a_range_rate_tells_the_speed_over_time() -> None:
    off, sigma = driven(rates=False)
    for over_ground in (False, True):
        off_with, sigma_with = driven(rates=True, over_ground=over_ground)
        assert off_with < min(0.3, off)
        assert sigma_with < 0.5 * sigma


def test_results_say_by_how_much_range_rates_make_velocities_surer() -> None:
    """As two trackers say, of which one has no rates: without noise both end at about the same place."""
    spread = {}
    for sigma in (None, 0.1):
        tracker = Tracker(size_prior="kitti")
        for i in range(4):
            place = np.array([2.0, 1.65, 20.0 + 0.4 * i])
            one = observe(load_prior("car14"), yaw_pose(-np.pi / 2.0, place), SHAPE, noise=0.0)
            rate = RangeRate(4.0 * place[2] / np.linalg.norm(place - [0.0, 0.75, 0.0]), sigma or 1.0)
            given = replace(one, evidence=(rate,) if sigma else ())
            found = tracker.update(i / 10.0, {3: given}, camera=CAMERA, ground=1.65)[3]
        assert found.velocity_covariance is not None
        spread[sigma] = np.sqrt(np.trace(found.velocity_covariance))
        gained = found.reconstruction.diagnostics.evidence
        assert gained.keys() == ({"range_rate"} if sigma else set())
    assert gained["range_rate"] == pytest.approx(spread[None] / spread[0.1], rel=0.05)
    assert gained["range_rate"] > 1.5
    for one in tracker.smooth()[3]:
        assert one.reconstruction.diagnostics.evidence["range_rate"] > 1.2


def test_relative_rates_need_no_motion_of_the_camera() -> None:
    speeds = {}
    for rates in (False, True):
        tracker = Tracker(size_prior="kitti")
        for i in range(4):
            one = seen(np.array([2.0, 1.65, 20.0 + 0.4 * i]), -np.pi / 2.0, seed=i)
            one = replace(one, evidence=(RangeRate(4.0 * 0.995, 0.1),)) if rates else one
            estimate = tracker.update(i / 10.0, {3: one}, camera=CAMERA, ground=1.65)[3]
        assert estimate.velocity is not None
        speeds[rates] = abs(float(estimate.velocity[2]) - 4.0)
    assert speeds[True] < 0.1 < speeds[False]


def test_a_rate_over_the_ground_is_left_out_where_nothing_says_how_the_camera_moves() -> None:
    found = []
    for evidence in ((), (RangeRate(14.0, 0.1, over_ground=True),)):
        tracker = Tracker(size_prior="kitti")
        for i in range(3):
            one = replace(seen(np.array([2.0, 1.65, 20.0 + 0.4 * i]), -np.pi / 2.0, seed=i), evidence=evidence)
            estimate = tracker.update(i / 10.0, {3: one}, camera=CAMERA, ground=1.65)[3]
        found.append(estimate)
    np.testing.assert_array_equal(found[0].reconstruction.location, found[1].reconstruction.location)
    assert "range rate: left out" in " ".join(found[1].reconstruction.diagnostics.left_out)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Range(0.0, 0.1), "range.metres"),
        (lambda: Range(5.0, 0.0), "range.sigma"),
        (lambda: Range(5.0, 0.1, np.zeros(2)), "range.origin"),
        (lambda: RangeRate(np.nan, 0.1), "range_rate.metres_per_second"),
        (lambda: RangeRate(500.0, 0.1), "range_rate.metres_per_second"),
        (lambda: RangeRate(5.0, -1.0), "range_rate.sigma"),
    ],
)
def test_what_is_no_range_is_refused(make: object, named: str) -> None:
    with pytest.raises(InvalidInputError, match=f"^{named}"):
        make()  # type: ignore[operator]
