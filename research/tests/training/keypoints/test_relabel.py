"""The factor graph over all photographs of one shape."""

from dataclasses import replace

import gtsam
import numpy as np

from fgrecon_research.training.keypoints.labels import ShapeFit
from fgrecon_research.training.keypoints.relabel import Found, relabel_shape, without_bias
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior


def test_shape_and_poses_are_corrected_and_lies_outvoted():
    rng = np.random.default_rng(3)
    prior = unit_car_prior()
    truth, offsets = np.array([0.9, -0.7, 0.4, 0.3, 0.0]), np.zeros((14, 3))
    offsets[4:6, 1] = 0.02  # both headlights lower than any shape of the model has them
    points = prior.keypoints(truth, offsets)
    cars = made_up_cars(prior, truth, 30, rng)
    extent = np.array([max(car.size) for car in cars])[:, None, None]
    keypoints = np.array([car.project(points) for car in cars])
    keypoints += rng.normal(0, 0.01, keypoints.shape) * extent
    wrong = rng.random((30, 14)) < 0.15
    keypoints[wrong] += (rng.normal(0, 0.3, keypoints.shape) * extent)[wrong]
    covariance = np.broadcast_to(np.eye(2), (30, 14, 2, 2)).copy()
    measured = []
    for car in cars:
        pose = gtsam.Pose3(gtsam.Rot3(car.rotation), car.translation)
        pose = pose.retract(rng.normal(0, 1, 6) * [0.02, 0.05, 0.02, 0.005, 0.005, 0.01])
        measured.append(replace(car, rotation=pose.rotation().matrix(), translation=pose.translation()))
    start = ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((30, 4)))
    found = Found(keypoints, np.full((30, 14), 0.8), covariance)

    result = relabel_shape(prior, measured, start, found)

    shape = prior.keypoints(result.fit.coefficients, result.fit.offsets)

    def label_error(photographs, shape):
        projected = np.array([car.project(shape) for car in photographs])
        exact = np.array([car.project(points) for car in cars])
        return np.median(np.linalg.norm(projected - exact, axis=-1) / extent[..., 0])

    assert label_error(result.cars, shape) < 0.35 * label_error(measured, prior.mean)
    assert label_error(result.cars, shape) < 0.01
    assert result.trusted.mean() > 0.9
    assert np.abs(shape * [1, 1, -1] - shape[prior.category.mirror]).max() < 0.01


def test_a_photograph_that_contradicts_the_shape_is_not_trusted():
    rng = np.random.default_rng(4)
    prior = unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 15, rng)
    keypoints = np.array([car.project(prior.mean) for car in cars])
    keypoints[7] = rng.uniform(0, 200, (14, 2))
    found = Found(keypoints, np.full((15, 14), 0.8), np.broadcast_to(np.eye(2), (15, 14, 2, 2)).copy())
    result = relabel_shape(prior, cars, ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((15, 4))), found)
    assert not result.trusted[7]
    assert result.trusted.sum() >= 13


def test_a_photograph_of_a_slightly_other_car_gets_labels_of_its_own():
    rng = np.random.default_rng(5)
    prior = unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 15, rng)
    keypoints = np.array([car.project(prior.mean) for car in cars])
    other = prior.keypoints(np.array([0.6, -0.6, 0.4, 0.0, 0.0]))
    keypoints[4] = cars[4].project(other)
    found = Found(keypoints, np.full((15, 14), 0.9), np.broadcast_to(np.eye(2), (15, 14, 2, 2)).copy())
    result = relabel_shape(prior, cars, ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((15, 4))), found)
    shared = result.cars[4].project(prior.keypoints(result.fit.coefficients, result.fit.offsets))
    error, before = (np.linalg.norm(points - keypoints[4], axis=1).mean() for points in (result.keypoints[4], shared))
    assert error < 0.6 * before


def test_what_is_off_in_all_shapes_is_taken_off():
    rng = np.random.default_rng(6)
    prior = unit_car_prior()
    bias = np.zeros((14, 3))
    bias[0], bias[1] = [0.02, -0.015, 0.01], [0.02, -0.015, -0.01]
    cars, fits, keypoints = [], [], []
    for _ in range(8):
        coefficients = rng.normal(0, 0.7, 5)
        some = made_up_cars(prior, coefficients, 6, rng)
        cars += some
        fits += [ShapeFit(coefficients, np.zeros((14, 3)), np.zeros((6, 4)))] * 6
        keypoints += [car.project(prior.keypoints(coefficients) + bias) for car in some]
    exact = np.array([car.project(prior.keypoints(f.coefficients)) for car, f in zip(cars, fits, strict=True)])
    keypoints = np.array(keypoints)
    wrong = rng.random(keypoints.shape[:2]) < 0.1
    spoilt = np.where(wrong[..., None], rng.uniform(0, 200, keypoints.shape), keypoints)
    covariance = np.broadcast_to(np.eye(2), (48, 14, 2, 2)).copy()
    sure = np.broadcast_to(np.arange(48)[:, None] < 40, (48, 14))
    found = without_bias(prior, cars, fits, sure, Found(spoilt, np.full((48, 14), 0.8), covariance))
    left, before = (np.abs((k - exact)[~wrong]).mean() for k in (found.keypoints, keypoints))
    assert left < 0.4 * before


def test_silhouettes_hold_shape_and_pose_more_tightly():
    rng = np.random.default_rng(7)
    prior = unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 10, rng)
    other = prior.keypoints(np.array([1.5, 0.0, 0.0, 0.0, 0.0]))
    keypoints = np.array([car.project(other) for car in cars])
    found = Found(keypoints, np.full((10, 14), 0.8), np.broadcast_to(np.eye(2), (10, 14, 2, 2)).copy())
    begin = ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((10, 4)))
    free, held = (relabel_shape(prior, cars, begin, found, np.full(10, sure)) for sure in (False, True))
    assert np.abs(held.fit.coefficients).max() < np.abs(free.fit.coefficients).max()


def test_a_keypoint_of_unknown_place_may_move_along_the_car():
    rng = np.random.default_rng(8)
    prior = unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 12, rng)
    offsets = np.zeros((14, 3))
    offsets[12:, 0] = 0.12  # the cab of a pickup
    keypoints = np.array([car.project(prior.keypoints(np.zeros(5), offsets)) for car in cars])
    found = Found(keypoints, np.full((12, 14), 0.8), np.broadcast_to(np.eye(2), (12, 14, 2, 2)).copy())
    begin, known = ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((12, 4))), np.arange(14) < 12
    sure = np.ones(12, dtype=bool)
    held, free = (relabel_shape(prior, cars, begin, found, sure, given) for given in (None, known))
    far, near = (np.abs(r.fit.offsets - offsets)[12:, 0].max() for r in (held, free))
    assert near < 0.5 * far
    np.testing.assert_allclose(free.fit.offsets[:12], 0.0, atol=0.02)


def test_marks_in_a_few_photographs_say_where_a_keypoint_is():
    rng = np.random.default_rng(9)
    prior = unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 12, rng)
    offsets = np.zeros((14, 3))
    offsets[12:, 0] = 0.12  # a coupe's rear window
    exact = np.array([car.project(prior.keypoints(np.zeros(5), offsets)) for car in cars])
    believed = np.array([car.project(prior.mean) for car in cars])  # what a network found that knows sedans alone
    found = Found(believed, np.full((12, 14), 0.8), np.broadcast_to(np.eye(2), (12, 14, 2, 2)).copy())
    begin = ShapeFit(np.zeros(5), np.zeros((14, 3)), np.zeros((12, 4)))
    marks = np.full((12, 14, 2), np.nan)
    marks[2, 12], marks[7, 12] = exact[2, 12], exact[7, 12]  # of the left corner alone
    result = relabel_shape(prior, cars, begin, found, np.ones(12, dtype=bool), None, marks)
    assert np.flatnonzero(result.marked).tolist() == [12, 13]
    assert result.trusted.all()
    extent = np.array([max(car.size) for car in cars])[:, None]
    error, before = (np.linalg.norm(points - exact, axis=-1) / extent for points in (result.keypoints, believed))
    assert error[:, 12:].max() < 0.25 * before[:, 12:].max()
    assert error[:, :12].max() < 0.01
