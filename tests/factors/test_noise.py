"""IRLS weights and robust losses as noise models."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.losses import Loss, RobustLoss
from factors.noise import as_noise, full_noise, keypoint_noise, keypoint_whiteners


def test_weight_scales_the_energy():
    r = np.array([3.0, -1.0])
    unweighted = keypoint_noise(1.0, 2.0)
    weighted = keypoint_noise(0.25, 2.0)
    assert weighted.sigma() == pytest.approx(4.0)
    assert np.sum(weighted.whiten(r) ** 2) == pytest.approx(0.25 * np.sum(unweighted.whiten(r) ** 2))


def test_covariance():
    S = np.array([[4.0, 1.0], [1.0, 2.0]])
    r = np.array([3.0, -1.0])
    noise = keypoint_noise(0.5, 1.0, covariance=S)
    assert np.sum(noise.whiten(r) ** 2) == pytest.approx(0.5 * r @ np.linalg.inv(S) @ r)


def test_a_covariance_that_is_off_symmetry_by_rounding():
    S = np.array([[4.0, 1.0], [1.0 + 2e-16, 2.0]])
    r = np.array([3.0, -1.0])
    assert S[0, 1] != S[1, 0]
    assert np.sum(keypoint_noise(0.5, 1.0, covariance=S).whiten(r) ** 2) == pytest.approx(
        0.5 * r @ np.linalg.inv(S) @ r
    )
    assert keypoint_whiteners([1.0], 1.0, S[None]).shape == (1, 3)


def test_one_covariance_for_all_rows():
    root = np.random.default_rng(0).normal(size=(6, 6))
    r = np.arange(6.0)
    noise = full_noise("motion", root @ root.T)
    assert np.sum(noise.whiten(r) ** 2) == pytest.approx(r @ np.linalg.inv(root @ root.T) @ r)


def test_zero_weight_has_no_noise_model():
    assert keypoint_noise(0.0, 1.0) is None


@pytest.mark.parametrize("loss", Loss)
def test_robust_weights(loss):
    robust = RobustLoss.of(loss.label)
    assert robust.weights(0.0) == pytest.approx(1.0)
    assert robust.weights(50.0) < 0.05
    noise = keypoint_noise(0.25, 2.0, robust=robust)
    assert isinstance(noise, gtsam.noiseModel.Robust)
    estimator, distances = noise.robust(), np.linspace(0, 20, 81)
    np.testing.assert_allclose(robust.weights(distances), [estimator.weight(s) for s in distances], atol=1e-14)
    np.testing.assert_allclose(robust.losses(distances), [estimator.loss(s) for s in distances], atol=1e-12)
    expected = {
        Loss.HUBER: 1.345 / 3,
        Loss.CAUCHY: 1 / (1 + 9 / 2.3849**2),
        Loss.GEMAN_MCCLURE: 1 / (1 + 9 / 4) ** 2,
        Loss.TUKEY: (1 - 9 / 4.6851**2) ** 2,
    }
    assert robust.weights(3.0) == pytest.approx(expected[loss])


def test_whiteners():
    weights = np.array([0.0, 1.0, 0.3])
    covariances = np.array([np.eye(2), [[4.0, 1.0], [1.0, 2.0]], [[1.0, -0.5], [-0.5, 3.0]]])
    for S, result in (
        (covariances, keypoint_whiteners(weights, 1.0, covariances)),
        (np.tile(4 * np.eye(2), (3, 1, 1)), keypoint_whiteners(weights, 2.0)),
    ):
        for i, (a, b, c) in enumerate(result):
            W = np.array([[a, 0], [b, c]])
            np.testing.assert_allclose(W.T @ W, weights[i] * np.linalg.inv(S[i]), atol=1e-14)


@pytest.mark.parametrize(
    "call",
    [
        lambda: keypoint_noise(-1.0, 1.0),
        lambda: keypoint_noise(np.nan, 1.0),
        lambda: keypoint_noise(1.0, 0.0),
        lambda: keypoint_noise(1.0, 1.0, covariance=np.zeros((2, 2))),
        lambda: keypoint_noise(1.0, 1.0, covariance=[[1, 2], [2, 1]]),
        lambda: keypoint_noise(1.0, 1.0, covariance=np.eye(3)),
        lambda: keypoint_whiteners([1.0, -1.0], 1.0),
        lambda: keypoint_whiteners([1.0, np.nan], 1.0),
        lambda: keypoint_whiteners([1.0], 0.0),
        lambda: keypoint_whiteners([1.0], 1.0, [np.zeros((2, 2))]),
        lambda: keypoint_whiteners([1.0], 1.0, [[[1, 2], [2, 1]]]),
        lambda: keypoint_whiteners([1.0], 1.0, np.eye(2)),
        lambda: full_noise("motion", -np.eye(6)),
        lambda: full_noise("motion", [[1.0, 0.5], [0.4, 1.0]]),
        lambda: full_noise("motion", np.zeros((6, 6))),
        lambda: full_noise("motion", np.ones((2, 3))),
        lambda: full_noise("motion", np.zeros((0, 0))),
        lambda: full_noise("motion", np.full((6, 6), np.nan)),
        lambda: RobustLoss.of("welsh"),
        lambda: RobustLoss.of("huber", -1.0),
        lambda: as_noise("f", gtsam.noiseModel.Unit.Create(2), 3),
    ],
)
def test_bad_input(call):
    with pytest.raises(InvalidInputError):
        call()
