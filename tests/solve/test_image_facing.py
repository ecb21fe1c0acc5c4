"""Which way vehicles face by one another and by the traffic: it decides where the detector is unsure."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.detection import facing_probability
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.half_turn import flipped_directions, flipped_observation, partners
from fgrecon.core.heading_coupling import mean_field
from fgrecon.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation import HOURGLASS
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate
from fgrecon.solve.image_facing import couple_facings, estimate_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import prepare

PRIOR = load_prior("car14")
PLAIN, RIGHT = fgrecon.Options(), fgrecon.Options(traffic="right")
QUIET = replace(HOURGLASS, found_visible=1.0, confusion=0.0, covered=0.0, missing=0.0, sigma_visible=0.01)
BINS = 2 * np.pi * np.arange(36) / 36


def directions(azimuth, sure):
    """Directions of a network that thinks one probable, and the opposite one with what is left."""
    bump = np.exp(20.0 * (np.cos(BINS - azimuth) - 1.0))
    bump /= bump.sum()
    return sure * bump + (1.0 - sure) * np.roll(bump, 18)


def car(x, sure, *, turned, z=18.0):
    """A car that faces as the camera looks, in a lane at x; its detector is right about it, or flipped."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # forward is the camera's z
    pose[:3, 3] = x, 1.65, z
    vehicle = Vehicle.of_prior(PRIOR, np.zeros(PRIOR.dimension))
    seen, _ = simulate(vehicle, KITTI_CAMERA, pose, np.random.default_rng(4), QUIET)
    azimuth = float(view_azimuth(pose[:3, :3], pose[:3, 3]))
    seen = replace(seen, azimuth=directions(azimuth, sure))
    return (flipped_observation(seen, PRIOR) if turned else seen), pose


def faces(result, pose):
    return float(np.vdot(result.camera_T_object[:3, :3], pose[:3, :3])) > 1.0


def solve(seen, traffic=None):
    options = fgrecon.Options(traffic=traffic, keep_history=False)
    return fgrecon.reconstruct(seen, KITTI_CAMERA, ground=1.65, options=options)


@pytest.mark.parametrize("x", [0.5, 3.5])
def test_an_unsure_network_that_is_flipped_is_put_right(x):
    seen, pose = car(x, 0.6, turned=True)
    assert not faces(solve(seen), pose)
    coupled = solve(seen, "right")
    assert faces(coupled, pose)
    assert coupled.facing_probability > 0.5


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
    (coupled,) = couple_facings([seen], KITTI_CAMERA, PRIOR, RIGHT)
    assert coupled.azimuth.sum() == pytest.approx(1.0)
    assert coupled.azimuth.argmax() == seen.azimuth.argmax()
    top = float(BINS[seen.azimuth.argmax()])
    assert facing_probability(coupled.azimuth, top) > facing_probability(seen.azimuth, top)
    np.testing.assert_array_equal(coupled.keypoints, seen.keypoints)


def test_without_directions_or_anything_measured_nothing_changes():
    seen, _ = car(3.5, 0.6, turned=True)
    silent = replace(seen, azimuth=None)
    nothing = replace(seen, keypoints=np.full((14, 2), np.nan), box=None)
    found = couple_facings([silent, nothing], KITTI_CAMERA, PRIOR, RIGHT)
    assert found[0] is silent
    assert found[1] is nothing
    off = fgrecon.Options(traffic="right", disabled_terms=["direction"], keep_history=False)
    first, second = (fgrecon.reconstruct(one, KITTI_CAMERA, ground=1.65, options=off) for one in (seen, silent))
    np.testing.assert_array_equal(first.camera_T_object, second.camera_T_object)
    assert (first.status, first.message) == (second.status, second.message)


def in_a_row(*sure, x=3.5, turned=(), gap=8.0):
    """Cars one behind the other, all facing as the camera looks."""
    return [car(x, p, turned=i in turned, z=12.0 + gap * i) for i, p in enumerate(sure)]


def test_an_unsure_car_faces_as_its_row_does():
    row = in_a_row(0.97, 0.6, 0.97, turned=[1])
    seen, poses = [one for one, _ in row], [pose for _, pose in row]
    apart = [solve(one) for one in seen]
    assert [faces(*pair) for pair in zip(apart, poses, strict=True)] == [True, False, True]
    found = fgrecon.reconstruct_scene(seen, KITTI_CAMERA, ground=1.65).vehicles
    assert all(faces(*pair) for pair in zip(found, poses, strict=True))


def test_a_car_alone_or_far_from_all_others_stays_as_it_is():
    seen, _ = car(3.5, 0.6, turned=True)
    assert couple_facings([seen], KITTI_CAMERA, PRIOR, PLAIN)[0] is seen
    far, _ = car(3.5, 0.9, turned=False, z=60.0)
    found = couple_facings([seen, far], KITTI_CAMERA, PRIOR, PLAIN)
    assert found[0] is seen
    assert found[1] is far


@pytest.mark.parametrize(("x", "alike"), [(3.5, True), (-3.5, False)])
def test_a_row_faces_alike_and_the_other_side_of_a_street_does_not(x, alike):
    sure, unsure = car(3.5, 0.99, turned=False)[0], car(x, 0.6, turned=False, z=24.0)[0]
    _, coupled = couple_facings([sure, unsure], KITTI_CAMERA, PRIOR, PLAIN)
    top = float(BINS[unsure.azimuth.argmax()])
    more = facing_probability(coupled.azimuth, top) > facing_probability(unsure.azimuth, top)
    assert more == alike


def test_the_order_of_the_vehicles_does_not_matter():
    seen = [one for one, _ in in_a_row(0.97, 0.6, 0.9, 0.7, turned=[1])]
    found = couple_facings(seen, KITTI_CAMERA, PRIOR, PLAIN)
    other = couple_facings(seen[::-1], KITTI_CAMERA, PRIOR, PLAIN)[::-1]
    for one, two in zip(found, other, strict=True):
        np.testing.assert_allclose(one.azimuth, two.azimuth, atol=1e-9)


def test_probabilities_are_those_of_all_sides_together():
    own, between = np.array([1.5, -0.3, 0.4]), np.array([[0, 0.3, 0.2], [0.3, 0, -0.25], [0.2, -0.25, 0]])
    states = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    weight = np.exp(states @ own / 2 + 0.5 * np.einsum("ki,ij,kj->k", states, between, states))
    exact = weight @ (states > 0) / weight.sum()
    np.testing.assert_allclose((1.0 + mean_field(own, between)) / 2.0, exact, atol=0.02)


def test_a_guess_of_the_yaw_comes_before_the_traffic():
    seen, pose = car(-6.0, 0.6, turned=False)  # stands on the wrong side of the road
    options = fgrecon.Options(traffic="right", keep_history=False)
    result = fgrecon.reconstruct(seen, KITTI_CAMERA, ground=1.65, initial=-np.pi / 2, options=options)
    assert faces(result, pose)


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


def test_keypoints_that_have_no_partners_are_not_turned():
    """Of two mirrors and two wheels only the wheels could change places, too few for a pose."""
    names = list(PRIOR.category.keypoints)
    few = [name for name, partner in zip(names, partners(PRIOR), strict=True) if partner < 0]
    few += [name for name in names if name not in few][: 4 - len(few)]
    given, _ = car(2.0, 0.9, turned=False)
    keypoints = np.where(np.isin(names, few)[:, None], given.keypoints, np.nan)
    given = replace(given, keypoints=keypoints)
    flipped = replace(given, azimuth=flipped_directions(given.azimuth))
    problem = Problem.of(flipped, KITTI_CAMERA, prepare(PRIOR), None, PLAIN)
    found, start = estimate_pose(problem, given)
    assert found is problem
    assert np.isfinite(start.camera_T_object).all()
