"""A prior given a size: Gaussian conditioning against sampling and closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.conditioning import given_size, is_one_vehicle, learn_size_relation, of_fleet
from fgrecon_research.training.priors.apollo79 import apollo79_prior, load_apollo79


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def test_a_size_that_is_known_is_met(prior):
    wanted = prior.box_size([1.0, -0.5, 0.3, 0.2, 0.0])
    sized = given_size(prior, SizePrior("measured", wanted, np.full(3, 1e-4)))
    assert sized.box_size(np.zeros(5)) == pytest.approx(wanted, abs=1e-3)
    assert sized.box_size(np.ones(5)) == pytest.approx(wanted, abs=1e-3)


def test_a_size_that_says_nothing_changes_nothing(prior):
    sized = given_size(prior, SizePrior("unknown", np.array([4.0, 1.7, 1.5]), np.full(3, 1e4)))
    assert sized.mean == pytest.approx(prior.mean, abs=1e-6)
    covariance = [np.einsum("nka,nlb->kalb", p.basis, p.basis) for p in (sized, prior)]
    assert covariance[0] == pytest.approx(covariance[1], abs=1e-6)


def test_mean_and_spread_are_those_of_the_weighted_prior(prior):
    size = SizePrior("measured", np.array([4.6, 1.8, 1.7]), np.array([0.3, 0.1, 0.1]))
    sized = given_size(prior, size)
    draws = np.random.default_rng(0).standard_normal((200_000, prior.dimension))
    jacobian = np.tensordot(prior.category.dimension_operator, prior.basis, axes=((1, 2), (1, 2)))
    boxes = prior.box_size(np.zeros(prior.dimension)) + draws @ jacobian.T
    weight = np.exp(-0.5 * np.square((boxes - size.mean) / size.sigma).sum(axis=1))
    weight /= weight.sum()
    columns = prior.basis.reshape(prior.dimension, -1)
    mean = prior.mean.ravel() + weight @ draws @ columns
    assert sized.mean.ravel() == pytest.approx(mean, abs=5e-3)
    offset = draws @ columns + prior.mean.ravel() - mean
    variance = weight @ np.square(offset)
    assert np.square(sized.basis).sum(axis=0).ravel() == pytest.approx(variance, abs=2e-3)


def test_surface_and_symmetry_follow(prior):
    sized = given_size(prior, SizePrior("measured", np.array([4.6, 1.8, 1.7]), np.full(3, 0.05)))
    assert sized.is_symmetric
    rows = prior.surface.basis.reshape(prior.dimension, -1)
    moved = np.linalg.lstsq(prior.basis.reshape(prior.dimension, -1).T, (sized.mean - prior.mean).ravel(), rcond=None)[
        0
    ]
    assert sized.surface.mean.ravel() == pytest.approx(prior.surface.mean.ravel() + moved @ rows, abs=1e-9)


def test_a_relation_that_keypoints_do_not_settle_is_learnt_and_counts(prior):
    """Sizes that follow the coefficients with known noise: the relation is found, and its noise weakens a size."""
    rng = np.random.default_rng(0)
    coefficients = rng.standard_normal((4000, prior.dimension))
    shapes = np.array([prior.keypoints(row) for row in coefficients])
    jacobian, noise = 0.1 * rng.standard_normal((3, prior.dimension)), np.array([0.05, 0.02, 0.08])
    sizes = [4.5, 1.8, 1.6] + coefficients @ jacobian.T + noise * rng.standard_normal((4000, 3))
    relation = learn_size_relation(prior, shapes, sizes)
    assert relation.mean == pytest.approx([4.5, 1.8, 1.6], abs=5e-3)
    assert relation.jacobian == pytest.approx(jacobian, abs=5e-3)
    assert np.sqrt(np.diag(relation.covariance)) == pytest.approx(noise, rel=0.05)
    exact = SizePrior("measured", np.array([4.8, 1.9, 1.5]), np.full(3, 1e-3))
    as_noisy = SizePrior("measured", exact.mean, np.hypot(1e-3, np.sqrt(np.diag(relation.covariance))))
    diagonal = replace(relation, covariance=np.diag(np.diag(relation.covariance)))
    certain = replace(relation, covariance=np.zeros((3, 3)))
    sized, same = given_size(prior, exact, diagonal), given_size(prior, as_noisy, certain)
    assert sized.mean == pytest.approx(same.mean, abs=1e-9)
    with pytest.raises(InvalidInputError, match="shapes"):
        learn_size_relation(prior, shapes[:6], sizes[:6])


@pytest.mark.parametrize(
    ("mean", "sigma", "one"),
    [
        ([4.6, 1.8, 1.7], [0.09, 0.03, 0.03], True),  # a car's papers
        ([4.57, 1.80, 1.59], [0.39, 0.09, 0.15], False),  # a fleet
        ([4.6, 1.8, 1.7], [0.09, 0.03, 0.15], False),  # of one height or another
        ([9.0, 2.5, 3.2], [0.09, 0.03, 0.03], False),  # a lorry
    ],
)
def test_a_size_is_one_cars_or_a_fleets(prior, mean, sigma, one):
    assert is_one_vehicle(prior, SizePrior("some", np.array(mean), np.array(sigma))) is one
    assert not is_one_vehicle(prior.truncated(0), SizePrior("some", np.array(mean), np.array(sigma)))


@pytest.mark.data
def test_a_known_size_is_worth_more_than_a_stretch(data):
    """Models left out of the prior: their mean keypoint error about the centroid, stretched against conditioned."""
    models = load_apollo79(data)
    errors = []
    for i in range(0, len(models.names), 5):
        prior = apollo79_prior(models, exclude=[models.names[i]])
        size = SizePrior("true", models.size[i], 0.02 * models.size[i])
        shapes = [prior.for_fleet(size).mean, given_size(prior, size).mean]
        away = [(s - s.mean(axis=0)) - (models.keypoints[i] - models.keypoints[i].mean(axis=0)) for s in shapes]
        errors.append([np.linalg.norm(a, axis=1).mean() for a in away])
    stretched, conditioned = np.median(errors, axis=0)
    assert conditioned < 0.85 * stretched


def test_a_fleet_has_its_mean_size_and_the_shape_that_goes_with_it(prior):
    small = SizePrior("small", np.array([3.89, 1.62, 1.53]), np.array([0.44, 0.11, 0.14]))
    found, stretched = of_fleet(prior, small), prior.for_fleet(small)
    np.testing.assert_allclose(found.box_size(np.zeros(5)), small.mean, atol=1e-9)
    surface = found.surface.mean
    np.testing.assert_allclose(np.ptp(surface, axis=0), np.ptp(stretched.surface.mean, axis=0), rtol=0.03)
    wheels = [abs(np.diff(one.mean[[0, 2], 0]).item()) for one in (found, stretched)]
    assert wheels[0] > wheels[1] + 0.02  # small cars have short overhangs
    unknown = replace(small, sigma=np.full(3, 1e6))
    np.testing.assert_allclose(of_fleet(prior, unknown).mean, stretched.mean, atol=1e-6)
    lorry = SizePrior("lorry", np.array([10.0, 2.6, 3.2]), np.array([1.0, 0.2, 0.3]))
    np.testing.assert_allclose(of_fleet(prior, lorry).box_size(np.zeros(5)), lorry.mean, atol=1e-9)
    rigid = prior.truncated(0)
    np.testing.assert_array_equal(of_fleet(rigid, small).mean, rigid.for_fleet(small).mean)
