"""Observations in traffic: turned round where the detector is unsure and the traffic is against it."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.choices import TrafficSide
from fgrecon.core.detection import facing_probability
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.turned import turned_round
from fgrecon.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation import HOURGLASS
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate
from fgrecon.solve.traffic import in_traffic

PRIOR = load_prior("car14")
QUIET = replace(HOURGLASS, found_visible=1.0, confusion=0.0, covered=0.0, missing=0.0, sigma_visible=0.01)
BINS = 2 * np.pi * np.arange(36) / 36


def directions(azimuth, sure):
    """Directions of a network that thinks one probable, and the opposite one with what is left."""
    bump = np.exp(20.0 * (np.cos(BINS - azimuth) - 1.0))
    bump /= bump.sum()
    return sure * bump + (1.0 - sure) * np.roll(bump, 18)


def car(x, sure, *, turned, z=18.0):
    """A car that faces as the camera looks, in a lane at x; its detector is right about it, or turned round."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # forward is the camera's z
    pose[:3, 3] = x, 1.65, z
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    seen, _ = simulate(vehicle, KITTI_CAMERA, pose, np.random.default_rng(4), QUIET)
    azimuth = float(view_azimuth(pose[:3, :3], pose[:3, 3]))
    seen = replace(seen, azimuth=directions(azimuth, sure))
    return (turned_round(seen, PRIOR) if turned else seen), pose


def faces(result, pose):
    return float(np.vdot(result.camera_T_object[:3, :3], pose[:3, :3])) > 1.0


def solve(seen, traffic=None):
    options = fgrecon.Options(traffic=traffic, keep_history=False)
    return fgrecon.reconstruct(seen, KITTI_CAMERA, ground=1.65, options=options)


@pytest.mark.parametrize("x", [0.5, 3.5])
def test_an_unsure_network_that_is_turned_round_is_put_right(x):
    seen, pose = car(x, 0.6, turned=True)
    assert not faces(solve(seen), pose)
    told = solve(seen, "right")
    assert faces(told, pose)
    assert told.facing_probability > 0.5


def test_a_sure_network_is_believed_against_the_traffic():
    seen, pose = car(-6.0, 0.999, turned=False)  # stands on the wrong side of the road
    assert faces(solve(seen, "right"), pose)
    assert solve(seen, "right").facing_probability < solve(seen, "left").facing_probability


def test_the_other_side_of_the_road_says_the_opposite():
    seen, pose = car(-6.0, 0.6, turned=False)
    assert faces(solve(seen, "left"), pose)
    assert not faces(solve(seen, "right"), pose)


def test_what_the_directions_say_beside_the_facing_stays():
    seen, _ = car(3.5, 0.9, turned=False)
    told = in_traffic(seen, KITTI_CAMERA, PRIOR, TrafficSide.RIGHT)
    assert told.azimuth.sum() == pytest.approx(1.0)
    assert told.azimuth.argmax() == seen.azimuth.argmax()
    top = float(BINS[seen.azimuth.argmax()])
    assert facing_probability(told.azimuth, top) > facing_probability(seen.azimuth, top)
    np.testing.assert_array_equal(told.keypoints, seen.keypoints)


def test_without_directions_or_anything_measured_nothing_changes():
    seen, _ = car(3.5, 0.6, turned=True)
    silent = replace(seen, azimuth=None)
    assert in_traffic(silent, KITTI_CAMERA, PRIOR, TrafficSide.RIGHT) is silent
    nothing = replace(seen, keypoints=np.full((14, 2), np.nan), box=None)
    assert in_traffic(nothing, KITTI_CAMERA, PRIOR, TrafficSide.RIGHT) is nothing


def test_a_guess_of_the_yaw_comes_before_the_traffic():
    seen, pose = car(-6.0, 0.6, turned=False)  # stands on the wrong side of the road
    options = fgrecon.Options(traffic="right", keep_history=False)
    told = fgrecon.reconstruct(seen, KITTI_CAMERA, ground=1.65, initial=-np.pi / 2, options=options)
    assert faces(told, pose)


def test_a_video_and_images_of_one_car_know_the_traffic():
    seen, pose = car(3.5, 0.6, turned=True)
    options = fgrecon.Options(traffic="right", keep_history=False)
    tracker = fgrecon.Tracker(options=options)
    for frame in range(3):
        found = tracker.update(0.1 * frame, {1: seen}, camera=KITTI_CAMERA, ground=1.65)[1]
    assert faces(found.reconstruction, pose)
    track = fgrecon.reconstruct_track([seen, seen], KITTI_CAMERA, ground=1.65, options=options)
    assert all(faces(one, pose) for one in track.frames)


def test_a_side_that_there_is_not_is_refused():
    with pytest.raises(InvalidInputError, match=r"options\.traffic.*right, left"):
        fgrecon.Options(traffic="middle")
