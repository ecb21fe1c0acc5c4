"""Vehicles of a video say which way one another face, as those of a single image do."""

from dataclasses import replace

import numpy as np

import fgrecon
from fgrecon.core.half_turn import flipped_directions
from tests.solve.time.streets import CAMERA, off, seen, upright

AHEAD = -np.pi / 2.0  # of a vehicle that faces as the camera looks
PLAIN = fgrecon.Options(keep_history=False)


def parked(count=4, gap=7.0):
    """Poses of cars one behind the other beside the road."""
    return [upright(AHEAD, [4.0, 1.65, 14.0 + gap * i]) for i in range(count)]


def shown(pose, rng, *, turned=False, unsure=False):
    found = seen(pose, rng, turned=turned)
    return replace(found, azimuth=0.5 * (found.azimuth + flipped_directions(found.azimuth))) if unsure else found


def followed(names, frames=4, options=PLAIN):
    """Estimates online and in batch; car 2 comes last, its keypoints flipped by a network that is not sure."""
    tracker, poses, online = fgrecon.Tracker(options=options), parked(), {}
    for t in range(frames):
        given = {}
        for i in names - ({2} if t == 0 else set()):
            given[i] = shown(poses[i], np.random.default_rng([i, t]), turned=i == 2, unsure=i == 2)
        online |= tracker.update(0.1 * t, given, camera=CAMERA, ground=1.65)
    return online, tracker, poses


def test_a_row_tells_a_car_that_its_network_takes_the_wrong_way_round():
    alone, tracker, poses = followed({2})
    assert off(alone[2], poses[2])[0] > 150.0
    assert off(tracker.smooth()[2][-1], poses[2])[0] > 150.0
    together, tracker, _ = followed({0, 1, 2, 3})
    assert all(off(together[i], pose)[0] < 15.0 for i, pose in enumerate(poses))
    smoothed = tracker.smooth()
    assert all(off(one, pose)[0] < 15.0 for i, pose in enumerate(poses) for one in smoothed[i])
    assert 0.7 < smoothed[2][-1].facing_probability < 0.95 < smoothed[1][-1].facing_probability


def test_a_row_tells_a_car_in_its_first_frame():
    online, tracker, poses = followed({0, 1, 2, 3}, 2)
    assert online[2].frames == 1
    assert off(online[2], poses[2])[0] < 15.0
    assert online[2].facing_probability > 0.7
    assert off(tracker.smooth()[2][0], poses[2])[0] < 15.0


def test_without_directions_or_their_term_nobody_says_anything():
    options = replace(PLAIN, disabled_terms=frozenset({"direction"}))
    alone, together = (followed(names, options=options)[0][2] for names in ({2}, {0, 2}))  # apart in the image
    assert np.array_equal(alone.reconstruction.camera_T_object, together.reconstruction.camera_T_object)
