"""A prior given a size: Gaussian conditioning against sampling and closed forms."""

import numpy as np
import pytest

from fgrecon.catalogue import load_prior
from fgrecon.priors.conditioning import given_size
from fgrecon.priors.size_prior import SizePrior


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def test_a_size_that_is_known_is_met(prior):
    wanted = prior.box_size([1.0, -0.5, 0.3, 0.2, 0.0])
    told = given_size(prior, SizePrior("measured", wanted, np.full(3, 1e-4)))
    assert told.box_size(np.zeros(5)) == pytest.approx(wanted, abs=1e-3)
    assert told.box_size(np.ones(5)) == pytest.approx(wanted, abs=1e-3)


def test_a_size_that_says_nothing_changes_nothing(prior):
    told = given_size(prior, SizePrior("unknown", np.array([4.0, 1.7, 1.5]), np.full(3, 1e4)))
    assert told.mean == pytest.approx(prior.mean, abs=1e-6)
    covariance = [np.einsum("nka,nlb->kalb", p.basis, p.basis) for p in (told, prior)]
    assert covariance[0] == pytest.approx(covariance[1], abs=1e-6)


def test_mean_and_spread_are_those_of_the_weighted_prior(prior):
    size = SizePrior("measured", np.array([4.6, 1.8, 1.7]), np.array([0.3, 0.1, 0.1]))
    told = given_size(prior, size)
    draws = np.random.default_rng(0).standard_normal((200_000, prior.dimension))
    jacobian = np.tensordot(prior.category.dimension_operator, prior.basis, axes=((1, 2), (1, 2)))
    boxes = prior.box_size(np.zeros(prior.dimension)) + draws @ jacobian.T
    weight = np.exp(-0.5 * np.square((boxes - size.mean) / size.sigma).sum(axis=1))
    weight /= weight.sum()
    columns = prior.basis.reshape(prior.dimension, -1)
    mean = prior.mean.ravel() + weight @ draws @ columns
    assert told.mean.ravel() == pytest.approx(mean, abs=5e-3)
    offset = draws @ columns + prior.mean.ravel() - mean
    variance = weight @ np.square(offset)
    assert np.square(told.basis).sum(axis=0).ravel() == pytest.approx(variance, abs=2e-3)


def test_surface_and_symmetry_follow(prior):
    told = given_size(prior, SizePrior("measured", np.array([4.6, 1.8, 1.7]), np.full(3, 0.05)))
    assert told.is_symmetric
    rows = prior.surface.basis.reshape(prior.dimension, -1)
    moved = np.linalg.lstsq(prior.basis.reshape(prior.dimension, -1).T, (told.mean - prior.mean).ravel(), rcond=None)[0]
    assert told.surface.mean.ravel() == pytest.approx(prior.surface.mean.ravel() + moved @ rows, abs=1e-9)
