"""Shapes from boxes, and the labels that they give."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon_research.training.keypoints.labels import fit_shape, project_labels, unit_prior, unmodelled
from fgrecon_research.training.priors.apollo79 import load_apollo79
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior


@pytest.fixture(scope="module")
def prior():
    return unit_car_prior()


def test_the_shape_that_made_the_boxes_is_found(prior):
    rng = np.random.default_rng(0)
    truth = np.array([1.2, -0.8, 0.5, 0.0, -0.4])
    cars = made_up_cars(prior, truth, 60, rng)
    fit = fit_shape(prior, cars)
    assert np.median(np.abs(fit.edge_error)) < 0.004
    mean = fit_shape(prior, cars[:1])
    error = np.linalg.norm(prior.keypoints(fit.coefficients) - prior.keypoints(truth), axis=1).mean()
    before = np.linalg.norm(prior.mean - prior.keypoints(truth), axis=1).mean()
    assert error < 0.4 * before
    assert np.isfinite(mean.coefficients).all()


def test_a_few_bad_boxes_change_little(prior):
    rng = np.random.default_rng(1)
    cars = made_up_cars(prior, np.zeros(5), 40, rng)
    clean = fit_shape(prior, cars).coefficients
    spoilt = [replace(car, size=(car.size[0] + 120, car.size[1])) if i % 10 == 0 else car for i, car in enumerate(cars)]
    assert np.abs(fit_shape(prior, spoilt).coefficients - clean).max() < 0.8


def test_labels_are_projections_and_hidden_sides_are_hidden(prior):
    cars = made_up_cars(prior, np.zeros(5), 12, np.random.default_rng(2))
    fit = fit_shape(prior, cars)
    labels = project_labels(prior, fit, cars)
    assert labels.keypoints.shape == (12, 14, 2)
    for row, car in enumerate(cars):
        np.testing.assert_allclose(labels.keypoints[row], car.project(prior.keypoints(fit.coefficients)))
        if np.radians(50) < car.azimuth < np.radians(130):  # seen from its left
            assert labels.visible[row, 0] > 0.5 > labels.visible[row, 1]
        if abs(car.azimuth) < np.radians(30):  # from ahead
            assert labels.visible[row, 6] < 0.5


@pytest.mark.data
def test_the_model_in_unit_boxes(data):
    prior = unit_prior(load_apollo79(data))
    low, high = prior.surface.mean.min(axis=0), prior.surface.mean.max(axis=0)
    assert np.linalg.norm(high - low) == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose((low + high)[1:], 0.0, atol=0.01)
    assert prior.is_symmetric
    assert prior.explained.sum() > 0.9


def test_rear_windows_of_coupes_and_convertibles_are_unknown(prior):
    names = ["BMW M3 Coupe 2012", "BMW M3 Sedan 2012", "", "smart fortwo Convertible 2012"]
    cars = made_up_cars(prior, np.zeros(5), 4, np.random.default_rng(0))
    cars = [replace(car, name=name) for car, name in zip(cars, names, strict=True)]
    unknown = unmodelled(cars, prior.category)
    assert [sorted(np.flatnonzero(row)) for row in unknown] == [[12, 13], [], [], [12, 13]]
    assert prior.category.keypoints[12:] == ("left_back_roof", "right_back_roof")
