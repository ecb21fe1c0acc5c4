"""IRLS weights and robust losses as noise models."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.noise import Loss, RobustLoss, as_noise, keypoint_noise, stacked_noise


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


def test_zero_weight_has_no_noise_model():
    assert keypoint_noise(0.0, 1.0) is None


@pytest.mark.parametrize("loss", Loss)
def test_robust_weights(loss):
    robust = RobustLoss.of(loss.label)
    assert robust.weight(0.0) == pytest.approx(1.0)
    assert robust.weight(50.0) < 0.05
    noise = keypoint_noise(0.25, 2.0, robust=robust)
    assert isinstance(noise, gtsam.noiseModel.Robust)
    assert noise.robust().weight(3.0) == robust.weight(3.0)
    expected = {
        Loss.HUBER: 1.345 / 3,
        Loss.CAUCHY: 1 / (1 + 9 / 2.3849**2),
        Loss.GEMAN_MCCLURE: 1 / (1 + 9) ** 2,
        Loss.TUKEY: (1 - 9 / 4.6851**2) ** 2,
    }
    assert robust.weight(3.0) == pytest.approx(expected[loss])


def test_stacked():
    noise = stacked_noise([1.0, 4.0], 2.0)
    np.testing.assert_allclose(noise.sigmas(), [2, 2, 1, 1])


@pytest.mark.parametrize(
    "call",
    [
        lambda: keypoint_noise(-1.0, 1.0),
        lambda: keypoint_noise(np.nan, 1.0),
        lambda: keypoint_noise(1.0, 0.0),
        lambda: keypoint_noise(1.0, 1.0, covariance=np.zeros((2, 2))),
        lambda: keypoint_noise(1.0, 1.0, covariance=[[1, 2], [2, 1]]),
        lambda: keypoint_noise(1.0, 1.0, covariance=np.eye(3)),
        lambda: stacked_noise([1.0, 0.0], 1.0),
        lambda: stacked_noise([], 1.0),
        lambda: RobustLoss.of("welsh"),
        lambda: RobustLoss.of("huber", -1.0),
        lambda: as_noise("f", gtsam.noiseModel.Unit.Create(2), 3),
    ],
)
def test_bad_input(call):
    with pytest.raises(InvalidInputError):
        call()
