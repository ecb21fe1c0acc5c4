"""Decoding of likelihood maps, and calibration of confidences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.detection import facing_probability
from fgrecon.perception.keypoints.decode import (
    ConfidenceCalibration,
    decode,
    left_probability,
    log_softmax,
    sigmoid,
    softmax,
)


def gaussian(point, sigma, side=48, stride=2.0):
    cells = (np.arange(side) + 0.5) * stride - 0.5
    column, row = (np.exp(-((cells - p) ** 2) / (2 * sigma**2)) for p in point)
    blob = row[:, None] * column
    return blob / blob.sum()


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.floats(12, 83), st.floats(12, 83), st.floats(1.2, 2.0))
def test_a_gaussian_is_found_to_a_tenth_of_a_cell(u, v, sigma):
    found = decode(gaussian((u, v), sigma)[None, None], 2.0, 8.0)
    np.testing.assert_allclose(found.points[0, 0], [u, v], atol=0.2)
    assert found.mass[0, 0] > 0.99
    np.testing.assert_allclose(found.covariance[0, 0], (sigma**2 + 4 / 12) * np.eye(2), rtol=0.15, atol=0.2)


def test_the_higher_of_two_peaks_counts_and_the_mass_says_how_much():
    maps = 0.7 * gaussian((20, 30), 2.0) + 0.3 * gaussian((80, 60), 2.0)
    found = decode(maps[None, None], 2.0, 8.0)
    np.testing.assert_allclose(found.points[0, 0], [20, 30], atol=0.3)
    assert found.mass[0, 0] == pytest.approx(0.7, abs=0.02)


def test_a_peak_in_a_corner_stays_finite():
    maps = np.zeros((1, 1, 8, 8))
    maps[0, 0, 0, 7] = 1.0
    found = decode(maps, 2.0, 4.0)
    np.testing.assert_allclose(found.points[0, 0], [14.5, 0.5])
    assert np.linalg.eigvalsh(found.covariance[0, 0]).min() > 0


def test_softmax_and_sigmoid_survive_large_numbers():
    np.testing.assert_allclose(softmax(np.array([1e4, 0.0, 1e4])), [0.5, 0.0, 0.5])
    np.testing.assert_allclose(log_softmax(np.array([0.0, -1e5])), [0.0, -1e5])
    np.testing.assert_allclose(sigmoid(np.array([-1e4, 0.0, 1e4])), [0.0, 0.5, 1.0])


def test_directions_of_an_uncalibrated_network_are_left_alone():
    azimuth = np.full((2, 36), 1.0 / 36.0)
    assert ConfidenceCalibration().direction(azimuth) is azimuth
    before = {name: value for name, value in ConfidenceCalibration(bias=0.5).to_dict().items() if name != "doubt"}
    assert ConfidenceCalibration.from_dict(before) == ConfidenceCalibration(bias=0.5)


def test_left_and_right_are_distinguished_near_straight_ahead():
    """Directions about 10 degrees left of ahead, smeared by 20, and a tenth of that flipped."""
    centres = 2.0 * np.pi * np.arange(36) / 36
    smeared = np.exp((np.cos(centres - np.radians(10.0)) - 1.0) / np.radians(20.0) ** 2)
    smeared /= smeared.sum()
    seen = 0.9 * smeared + 0.1 * np.roll(smeared, 18)
    plain = facing_probability(seen, np.pi / 2.0)
    probability = left_probability(seen)
    assert probability > plain + 0.1
    assert probability < 0.9  # a tenth is of a car that shows its right
    mirrored = np.concatenate([seen[:1], seen[:0:-1]])
    assert left_probability(mirrored) == pytest.approx(1.0 - probability)
    assert left_probability(np.full(36, 1 / 36)) == pytest.approx(0.5)
    beside = np.roll(smeared, 8)  # 90 degrees to the left
    assert left_probability(beside) == pytest.approx(1.0, abs=1e-3)
