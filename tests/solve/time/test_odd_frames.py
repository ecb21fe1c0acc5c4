"""Frames that contradict those before, of another vehicle under the same id; how soon a vehicle drives."""

import numpy as np
import pytest

from tests.solve.time.streets import off, seen, upright
from tests.solve.time.test_tracker import GROUND, follow


def test_where_an_id_passes_to_another_vehicle_that_begins_anew():
    """What the first one left behind no longer weighs on the second's shape and place, whichever way it faces."""
    rng, shape = np.random.default_rng(0), np.array([2.0, 0.0, 0.0, 0.0, 0.0])
    for first, second, place in (
        (upright(1.6, [-3.0, GROUND, 14.0]), upright(-1.5, [3.0, GROUND, 14.0]), None),
        (upright(-1.6, [-3.0, GROUND, 14.0]), upright(-1.6, [3.0, GROUND, 20.0]), np.eye(4)),
    ):
        frames = [(0.1 * t, seen(first, rng) if t < 25 else seen(second, rng, shape=shape), place) for t in range(45)]
        (*_, fresh), smoothed_fresh = follow(frames[25:])
        online, smoothed = follow(frames)
        assert online[25].velocity is None
        assert max(off(one, second)[1] for one in online[25:]) < off(fresh, second)[1] + 3.0
        for one in (*online[26:], *smoothed[25:]):  # from its second frame on, online
            assert off(one, second)[0] < 10.0
            assert one.facing_probability > 0.8
        assert np.linalg.norm(online[-1].reconstruction.location - fresh.reconstruction.location) < 0.1
        coefficients = fresh.reconstruction.shape.coefficients
        np.testing.assert_allclose(online[-1].reconstruction.shape.coefficients, coefficients, atol=0.2)
        coefficients = smoothed_fresh[-1].reconstruction.shape.coefficients
        np.testing.assert_allclose(smoothed[-1].reconstruction.shape.coefficients, coefficients, atol=0.2)


def test_one_frame_of_another_vehicle_changes_nothing_afterwards():
    rng, frames, poses = np.random.default_rng(1), [], []
    for t in range(40):
        place = upright(0.0, [0.0, 0.0, 0.8 * t])
        poses.append(np.linalg.inv(place) @ upright(-np.pi / 2.0, [2.5, GROUND, 20.0 + 0.8 * t]))
        frames.append((0.1 * t, seen(poses[-1], rng), place))
    beside = poses[25].copy()
    beside[0, 3] -= 4.0
    disturbed = list(frames)
    disturbed[25] = (2.5, seen(beside, rng), frames[25][2])
    online, _ = follow(frames)
    found, _ = follow(disturbed)
    assert found[25].velocity is None
    for one, expected, pose in list(zip(found, online, poses, strict=True))[26:]:
        assert off(one, pose)[0] < 5.0
        assert np.linalg.norm(one.reconstruction.location - expected.reconstruction.location) < 0.5
        np.testing.assert_allclose(one.velocity, expected.velocity, atol=1.0)


@pytest.mark.parametrize("window", [2, 3, 5])
def test_a_vehicle_that_drives_does_so_from_the_beginning(window):
    """Frames of a short time do not say whether it stands: it is not taken to, however few a window has."""
    rng, frames = np.random.default_rng(2), []
    for t in range(30):
        place = upright(0.0, [0.0, 0.0, 0.8 * t])
        pose = np.linalg.inv(place) @ upright(-np.pi / 2.0, [2.5, GROUND, 12.0 + 0.8 * t])
        frames.append((0.1 * t, seen(pose, rng, noise=0.01), place))
    online, _ = follow(frames, window=window)
    assert np.median([one.velocity[2] for one in online[3:]]) == pytest.approx(8.0, abs=4.5 if window == 2 else 1.0)
