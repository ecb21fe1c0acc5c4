"""Covariances and robust losses as noise models."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.losses import Loss, RobustLoss
from factors.noise import as_noise, full_noise


def test_one_covariance_for_all_rows():
    root = np.random.default_rng(0).normal(size=(6, 6))
    r = np.arange(6.0)
    noise = full_noise("motion", root @ root.T)
    assert np.sum(noise.whiten(r) ** 2) == pytest.approx(r @ np.linalg.inv(root @ root.T) @ r)


@pytest.mark.parametrize("loss", Loss)
def test_robust_weights(loss):
    robust = RobustLoss.of(loss.label)
    assert robust.weights(0.0) == pytest.approx(1.0)
    assert robust.weights(50.0) < 0.05
    noise = robust.wrap(gtsam.noiseModel.Isotropic.Sigma(2, 4.0))
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


@pytest.mark.parametrize(
    "call",
    [
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
