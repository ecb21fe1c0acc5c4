"""Calibrations are found again from examples that were made with known ones."""

import numpy as np
import pytest

from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon_research.training.keypoints.calibrate import fit_confidence, fit_direction, fit_kinds, fit_spread


def test_calibration_recovers_the_probabilities_that_made_the_examples():
    rng = np.random.default_rng(0)
    visible, mass = rng.normal(0, 2, 40000), rng.beta(1.5, 1, 40000)
    truth = ConfidenceCalibration(-0.5, 0.8, 0.6, 0.3)
    right = rng.random(40000) < truth.confidence(visible, mass)
    fitted = fit_confidence(visible, mass, right, ridge=0.0)
    np.testing.assert_allclose(fitted.confidence(visible, mass), truth.confidence(visible, mass), atol=0.05)
    assert ConfidenceCalibration.from_dict(fitted.to_dict()) == fitted


def test_the_spread_of_errors_is_found():
    rng = np.random.default_rng(0)
    likelihood = np.broadcast_to(0.01**2 * np.eye(2), (4000, 2, 2))
    error = rng.normal(0, np.hypot(0.01, 0.02), (4000, 2))
    fitted = fit_spread(ConfidenceCalibration(), likelihood, error)
    found = fitted.covariance(likelihood[0], 1.0)[0, 0]
    assert found == pytest.approx(0.01**2 + 0.02**2, rel=0.3)
    assert fitted.covariance(likelihood[0] * 100**2, 100.0)[0, 0] == pytest.approx(found * 100**2)


def test_directions_are_made_as_sure_as_they_are_right():
    """Oracle: front and rear mixed up in a known share of the views, too sure; the fit undoes it."""
    rng, bins = np.random.default_rng(0), 36
    centres = 2.0 * np.pi * np.arange(bins) / bins
    truth = rng.uniform(-np.pi, np.pi, 6000)
    behind = rng.beta(0.5, 4.0, len(truth))  # how probable the network thinks the other end
    said = np.where(rng.random(len(truth)) < behind, truth + np.pi, truth)
    ends = [np.exp((np.cos(said[:, None] + turn - centres) - 1.0) / 0.3**2) for turn in (0.0, np.pi)]
    honest = (1.0 - behind[:, None]) * ends[0] + behind[:, None] * ends[1]
    honest /= honest.sum(axis=1, keepdims=True)
    sharp = honest**2 / (honest**2).sum(axis=1, keepdims=True)
    fitted = fit_direction(ConfidenceCalibration(), sharp, truth)
    assert fitted.sharpness == pytest.approx(0.5, abs=0.11)
    assert fitted.doubt <= 0.02
    lost = rng.random(len(truth)) < 0.16
    doubting = fit_direction(ConfidenceCalibration(), honest, np.where(lost, rng.uniform(-np.pi, np.pi, 6000), truth))
    assert doubting.doubt >= 0.04
    np.testing.assert_allclose(doubting.direction(honest).sum(axis=1), 1.0)
    assert fit_direction(fitted, sharp[:0], truth[:0]) is fitted


def test_kinds_are_made_as_sure_as_they_are_right():
    rng = np.random.default_rng(4)
    honest = rng.dirichlet([1.0, 0.5, 0.3], 6000)
    truth = np.array([rng.choice(3, p=p) for p in honest])
    sharp = honest**2 / (honest**2).sum(axis=1, keepdims=True)
    fitted = fit_kinds(ConfidenceCalibration(), sharp, truth)
    assert fitted.kind_sharpness == pytest.approx(0.5, abs=0.11)
    assert fitted.kind_doubt <= 0.02
    np.testing.assert_allclose(fitted.kinds(sharp).sum(axis=1), 1.0)
    assert fit_kinds(fitted, sharp[:0], truth[:0]) is fitted
