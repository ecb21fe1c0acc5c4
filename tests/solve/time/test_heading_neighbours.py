"""Vehicles of a video say which way one another face, with all that each knows of itself, and once."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.half_turn import flipped_directions
from fgrecon.solve.time.heading_filter import Belief
from fgrecon.solve.time.heading_neighbours import beliefs_with_neighbours, neighbour_evidence
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
    """Estimates online and in batch; car 2 comes last, its keypoints turned round by a network that is not sure."""
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
    assert 0.9 < smoothed[2][-1].facing_probability < 0.995 < smoothed[1][-1].facing_probability


def test_a_row_tells_a_car_in_its_first_frame():
    online, tracker, poses = followed({0, 1, 2, 3}, 2)
    assert online[2].frames == 1
    assert off(online[2], poses[2])[0] < 15.0
    assert online[2].facing_probability > 0.8
    assert off(tracker.smooth()[2][0], poses[2])[0] < 15.0


def test_without_directions_or_their_term_nobody_says_anything():
    options = replace(PLAIN, disabled_terms=frozenset({"direction"}))
    alone, together = (followed(names, options=options)[0][2] for names in ({2}, {0, 1, 2, 3}))
    assert np.array_equal(alone.reconstruction.camera_T_object, together.reconstruction.camera_T_object)


def test_what_neighbour_evidence_is_said_once():
    """Followed for longer they say no more, and a past is not changed by being smoothed."""
    said = []
    for frames in (4, 12):
        _, tracker, _ = followed({0, 1, 2, 3}, frames)
        pasts = {i: track.vehicle.past for i, track in tracker._tracks.items()}
        before = [frame.belief.probability.copy() for frame in pasts[2]]
        told = beliefs_with_neighbours(pasts)
        for frame, kept in zip(pasts[2], before, strict=True):
            assert np.array_equal(frame.belief.probability, kept)
        said.append(sum(np.ptp(one.evidence - own.evidence) for one, own in zip(told[2], pasts[2], strict=True)))
        assert np.ptp(pasts[2][-1].neighbours) == pytest.approx(said[-1], rel=0.2)
    assert said[0] > 2.0
    assert said[1] == pytest.approx(said[0], rel=0.2)


def test_the_order_does_not_matter_and_who_is_far_away_says_nothing():
    _, tracker, _ = followed({0, 1, 2, 3})
    frames = [track.vehicle.past[-1] for track in tracker._tracks.values()]
    own = [frame.belief for frame in frames]
    says = neighbour_evidence(frames, own)
    for one, other in zip(says, neighbour_evidence(frames[::-1], own[::-1])[::-1], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    assert not neighbour_evidence(frames[:1], own[:1])[0].any()
    assert not any(one.any() for one in neighbour_evidence(frames, [Belief.none()] * len(frames)))
