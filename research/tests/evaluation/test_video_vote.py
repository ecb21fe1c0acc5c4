"""The vote: facings by the sum of the network's log odds over a track."""

import numpy as np
import pytest

import fgrecon
from fgrecon.core.geometry import position_covariance
from fgrecon_research.evaluation import video_tracks
from fgrecon_research.evaluation.video_tracks import VOTE, VOTE_BATCH
from tests.made_up_track import K, pose_of
from tests.results import changed

BINS = 36


@pytest.fixture(scope="module")
def result():
    """A car that faces to the camera's right, its left side seen."""
    pose = pose_of(0.0, (0.0, 1.65, 15.0))
    points = fgrecon.load_prior("car14").mean @ pose[:3, :3].T + pose[:3, 3]
    return fgrecon.reconstruct((points @ K.T)[:, :2] / points[:, 2:], fgrecon.Camera(K))


def at(result, yaw):
    return changed(result, camera_T_object=pose_of(yaw, result.location))


def directions(probability, result):
    """The network's, with a probability of the half that the camera is in by a result's pose."""
    x, _, z = -result.camera_T_object[:3, :3].T @ result.location
    ahead = int(np.round(np.arctan2(z, x) / (2.0 * np.pi) * BINS))
    found = np.zeros(BINS)
    found[ahead % BINS], found[(ahead + BINS // 2) % BINS] = probability, 1.0 - probability
    return found


def vote(track):
    """The results by the frames so far, and by all."""
    voted = video_tracks.vote(track, [0.1 * number for number in range(len(track))])
    return [(one[VOTE], one[VOTE_BATCH]) for one in voted]


def facings(voted, way):
    return [bool(np.cos(one[way].rotation_y) > 0.0) for one in voted]


def test_log_odds_add_up_over_the_frames_so_far_and_over_all(result):
    """Right, flipped and surer of it, then right twice; the sums are 1.4, -1.6, 0.1 and 2.1 nats."""
    sure = [0.8, 0.95, 0.84, 0.88]
    way = [0.0, np.pi, 0.1, -0.1]
    results = [at(result, yaw) for yaw in way]
    voted = vote([(one, directions(p, one)) for one, p in zip(results, sure, strict=True)])
    assert facings(voted, 0) == [True, False, True, True]
    assert facings(voted, 1) == [True] * 4
    assert voted[0][0] is results[0]
    assert voted[1][1].rotation_y == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(voted[1][1].location, results[1].location)


def test_a_vehicle_that_passes_is_seen_from_ahead_and_then_from_behind(result):
    """Its yaw turns half round in the camera, little by little; results of the second half are the wrong way round."""
    yaws = np.linspace(0.0, np.pi, 8)
    results = [at(result, yaw + np.pi * (number >= 5)) for number, yaw in enumerate(yaws)]
    voted = vote([(one, directions(0.8, one)) for one in results])
    for one, yaw, last in zip(voted, yaws, [*[False] * 5, *[True] * 3], strict=True):
        assert np.cos(one[0].rotation_y - yaw) == pytest.approx(1.0)
        assert np.cos(one[1].rotation_y - yaw) == pytest.approx(1.0)
        assert (one[1].camera_T_object is not one[0].camera_T_object) == last


def test_frames_without_directions_count_nothing_and_take_the_others(result):
    results = [at(result, yaw) for yaw in (0.0, np.pi, np.pi)]
    voted = vote([(results[0], None), (results[1], None), (results[2], directions(0.7, results[2]))])
    assert facings(voted, 0) == [True, False, False]
    assert facings(voted, 1) == [False] * 3
    silent = vote([(one, None) for one in results])
    assert all(one is now is at_last for one, (now, at_last) in zip(results, silent, strict=True))


def test_a_result_that_is_turned_claims_the_same_region(result):
    ((_, first), _) = vote([(result, directions(0.4, result)), (result, None)])
    assert abs(np.cos(first.rotation_y) + 1.0) < 1e-6
    regions = [position_covariance(one.camera_T_object, one.uncertainty.pose_covariance) for one in (result, first)]
    np.testing.assert_allclose(*regions, atol=1e-12)
    assert changed(first, pose_covariance=None).uncertainty.pose_covariance is None
