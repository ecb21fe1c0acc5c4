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


def test_calibration_recovers_the_probabilities_that_made_the_examples():
    rng = np.random.default_rng(0)
    visible, mass = rng.normal(0, 2, 40000), rng.beta(1.5, 1, 40000)
    truth = ConfidenceCalibration(-0.5, 0.8, 0.6, 0.3)
    right = rng.random(40000) < truth.confidence(visible, mass)
    fitted = ConfidenceCalibration.fit(visible, mass, right, ridge=0.0)
    np.testing.assert_allclose(fitted.confidence(visible, mass), truth.confidence(visible, mass), atol=0.05)
    assert ConfidenceCalibration.from_dict(fitted.to_dict()) == fitted


def test_softmax_and_sigmoid_survive_large_numbers():
    np.testing.assert_allclose(softmax(np.array([1e4, 0.0, 1e4])), [0.5, 0.0, 0.5])
    np.testing.assert_allclose(log_softmax(np.array([0.0, -1e5])), [0.0, -1e5])
    np.testing.assert_allclose(sigmoid(np.array([-1e4, 0.0, 1e4])), [0.0, 0.5, 1.0])


def test_the_spread_of_errors_is_found():
    rng = np.random.default_rng(0)
    likelihood = np.broadcast_to(0.01**2 * np.eye(2), (4000, 2, 2))
    error = rng.normal(0, np.hypot(0.01, 0.02), (4000, 2))
    fitted = ConfidenceCalibration().with_spread(likelihood, error)
    found = fitted.covariance(likelihood[0], 1.0)[0, 0]
    assert found == pytest.approx(0.01**2 + 0.02**2, rel=0.3)
    assert fitted.covariance(likelihood[0] * 100**2, 100.0)[0, 0] == pytest.approx(found * 100**2)


def test_directions_are_made_as_sure_as_they_are_right():
    """Oracle: front and rear mixed up in a known share of the views, told too surely; the fit undoes it."""
    rng, bins = np.random.default_rng(0), 36
    centres = 2.0 * np.pi * np.arange(bins) / bins
    truth = rng.uniform(-np.pi, np.pi, 6000)
    behind = rng.beta(0.5, 4.0, len(truth))  # how probable the network thinks the other end
    told = np.where(rng.random(len(truth)) < behind, truth + np.pi, truth)
    ends = [np.exp((np.cos(told[:, None] + turn - centres) - 1.0) / 0.3**2) for turn in (0.0, np.pi)]
    honest = (1.0 - behind[:, None]) * ends[0] + behind[:, None] * ends[1]
    honest /= honest.sum(axis=1, keepdims=True)
    sharp = honest**2 / (honest**2).sum(axis=1, keepdims=True)
    fitted = ConfidenceCalibration().with_direction(sharp, truth)
    assert fitted.sharpness == pytest.approx(0.5, abs=0.11)
    assert fitted.doubt <= 0.02
    lost = rng.random(len(truth)) < 0.16
    doubting = ConfidenceCalibration().with_direction(honest, np.where(lost, rng.uniform(-np.pi, np.pi, 6000), truth))
    assert doubting.doubt >= 0.04
    np.testing.assert_allclose(doubting.direction(honest).sum(axis=1), 1.0)
    assert fitted.with_direction(sharp[:0], truth[:0]) is fitted


def test_directions_of_an_uncalibrated_network_are_left_alone():
    azimuth = np.full((2, 36), 1.0 / 36.0)
    assert ConfidenceCalibration().direction(azimuth) is azimuth
    before = {name: value for name, value in ConfidenceCalibration(bias=0.5).to_dict().items() if name != "doubt"}
    assert ConfidenceCalibration.from_dict(before) == ConfidenceCalibration(bias=0.5)


def test_left_and_right_are_told_apart_near_straight_ahead():
    """Directions about 10 degrees left of ahead, smeared by 20, and a tenth of that turned round."""
    centres = 2.0 * np.pi * np.arange(36) / 36
    smeared = np.exp((np.cos(centres - np.radians(10.0)) - 1.0) / np.radians(20.0) ** 2)
    smeared /= smeared.sum()
    seen = 0.9 * smeared + 0.1 * np.roll(smeared, 18)
    plain = facing_probability(seen, np.pi / 2.0)
    told = left_probability(seen)
    assert told > plain + 0.1
    assert told < 0.9  # a tenth is of a car that shows its right
    mirrored = np.concatenate([seen[:1], seen[:0:-1]])
    assert left_probability(mirrored) == pytest.approx(1.0 - told)
    assert left_probability(np.full(36, 1 / 36)) == pytest.approx(0.5)
    beside = np.roll(smeared, 8)  # 90 degrees to the left
    assert left_probability(beside) == pytest.approx(1.0, abs=1e-3)
