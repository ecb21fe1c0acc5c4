"""A vehicle that may be a car or a van is as unsure as that; where it is does not change."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon import VehicleClass
from fgrecon.calibration.labelled_boxes import normalised_squared_error
from fgrecon.core.geometry import position_covariance
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.either_class import either_class, mean_weights
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.problem import Problem
from tests.cars import CAMERA, observe, yaw_pose

VAN = np.array([5.0, 1.9, 2.2])
PLACES = np.array([[2.0, 1.65, 18.0], [-3.0, 1.65, 24.0]])
OWN = replace(SIZE_PRIORS["kitti"], traffic=None)
"""The cars of the fleet, and nothing else."""


@pytest.fixture(scope="module")
def vehicles():
    """A car and a van."""
    prior = load_prior("car14")
    priors = prior.for_fleet(SIZE_PRIORS["kitti"]), prior.for_fleet(fgrecon.SizePrior("van", VAN, 0.05 * VAN))
    return [observe(one, yaw_pose(2.0, place), noise=0.3, seed=3) for one, place in zip(priors, PLACES, strict=True)]


def sigma(result):
    """Of the position, metres."""
    return float(np.sqrt(np.trace(result.uncertainty.pose_covariance[3:, 3:])))


def inside(result, place):
    covariance = position_covariance(result.camera_T_object, result.uncertainty.pose_covariance)
    return normalised_squared_error(result.location - place, covariance) < 8.0


def test_a_van_among_cars_is_in_its_region(vehicles):
    for one, place in zip(vehicles, PLACES, strict=True):
        found = fgrecon.reconstruct(one, CAMERA, size_prior="kitti", ground=1.65)
        assert inside(found, place)
        sizes = found.uncertainty.size_covariance
        assert normalised_squared_error(found.shape.box_size - (VAN if place[2] > 20.0 else OWN.mean), sizes) < 8.0
        for covariance in (found.uncertainty.coefficients_covariance, *found.uncertainty.keypoint_covariance):
            assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_the_result_stays_where_it_is(vehicles):
    found, own = (fgrecon.reconstruct(vehicles[1], CAMERA, size_prior=one, ground=1.65) for one in ("kitti", OWN))
    np.testing.assert_array_equal(found.camera_T_object, own.camera_T_object)
    assert found.status is own.status
    assert not inside(own, PLACES[1]), "whose fleet has cars alone is no van"
    assert sigma(found) > 1.5 * sigma(own)


def test_it_is_as_unsure_as_its_class(vehicles):
    def as_said(**said):
        one = vehicles[0].with_evidence([VehicleClass(said)])
        return sigma(fgrecon.reconstruct(one, CAMERA, size_prior="kitti", ground=1.65))

    assert as_said(car=0.9, van=0.1) > as_said(car=0.99, van=0.01) > as_said(car=1.0)
    apollo = vehicles[0].with_evidence([VehicleClass({"car": 0.7, "van": 0.3})])
    open_class = fgrecon.reconstruct(apollo, CAMERA, size_prior="apollo79", ground=1.65)
    assert sigma(open_class) > sigma(fgrecon.reconstruct(vehicles[0], CAMERA, size_prior="apollo79", ground=1.65))


def test_in_a_scene_and_a_track_too(vehicles):
    scene = fgrecon.reconstruct_scene(vehicles, CAMERA, size_prior="kitti", ground=1.65)
    assert inside(scene.vehicles[1], PLACES[1])
    track = fgrecon.reconstruct_track([vehicles[1]] * 2, CAMERA, size_prior="kitti", ground=1.65)
    assert all(inside(frame, PLACES[1]) for frame in track.frames)
    of_known_class = [vehicles[1].with_evidence([VehicleClass("car")]), vehicles[1]]
    as_car = fgrecon.reconstruct_track(of_known_class, CAMERA, size_prior="kitti", ground=1.65)
    assert not any(inside(frame, PLACES[1]) for frame in as_car.frames), "what one image says holds for all"


def test_many_frames_leave_the_class_as_open_as_one(vehicles):
    tracker = fgrecon.Tracker(size_prior="kitti")
    sigmas = []
    for time in (0.0, 0.1, 0.2, 0.3):
        estimate = tracker.update(time, {0: vehicles[1]}, camera=CAMERA, ground=1.65)[0]
        assert inside(estimate.reconstruction, PLACES[1])
        sigmas.append(sigma(estimate.reconstruction))
    assert sigmas[-1] > 0.9 * sigmas[1]
    assert all(inside(one.reconstruction, PLACES[1]) for one in tracker.smooth()[0])


def test_what_an_earlier_frame_says_is_along_the_ray_of_the_later_one(vehicles):
    setup = SolveSetup.of("car14", "kitti", None, 1.65)
    before, after = (fgrecon.reconstruct(one, CAMERA, size_prior=OWN, ground=1.65) for one in reversed(vehicles))
    problem = Problem.of(vehicles[1], CAMERA, setup.model, setup.ground, setup.options)
    either = either_class(problem, before.camera_T_object, before.shape.coefficients, setup, None)
    added = (
        either.added_to(after, {"car": 0.0, "van": 0.0}).uncertainty.pose_covariance - after.uncertainty.pose_covariance
    )
    across = after.camera_T_object[:3, :3] @ np.linalg.eigh(added[3:, 3:])[1][:, -1]
    assert abs(across @ after.location) > 0.99 * np.linalg.norm(after.location)
    assert not abs(across @ before.location) > 0.99 * np.linalg.norm(before.location)


@pytest.mark.parametrize("taken_for", [0.0, 0.3, 1.0], ids=["a car", "between", "a van"])
@pytest.mark.parametrize("van", [0.001, 0.2, 0.999])
def test_it_stands_as_low_as_both_do_on_average(vehicles, taken_for, van):
    setup = SolveSetup.of("car14", "kitti", None, 1.65)
    result = fgrecon.reconstruct(vehicles[1], CAMERA, size_prior=OWN, ground=1.65)
    problem = Problem.of(vehicles[1], CAMERA, setup.model, setup.ground, setup.options)
    either = either_class(problem, result.camera_T_object, result.shape.coefficients, setup, None)
    size = either.first_size + taken_for * either.sizes[0]
    mean, sigma = either.lower(either.place, size, np.array([0.0, 1.0, 0.0]), {"van": np.log(van / (1.0 - van))})
    heights, shares = np.array([0.0, either.moves[0, 1]]), np.array([1.0 - van, van])
    assert either.moves[0, 1] > 0.2, "a van is farther away, and so is lower"
    assert mean + taken_for * either.moves[0, 1] == pytest.approx(shares @ heights, abs=1e-3)
    assert sigma**2 == pytest.approx(shares @ (heights - shares @ heights) ** 2, abs=1e-3)


def test_vans_do_not_draw_the_ground_of_cars_along():
    """Those of a fleet without vans are cars for sure, and lift the road for all.

    Where no ground is given, the sizes that they are taken for say where it is.
    """
    prior = load_prior("car14")
    car, van = prior.for_fleet(SIZE_PRIORS["kitti"]), prior.for_fleet(fgrecon.SizePrior("van", VAN, 0.05 * VAN))
    places = [np.array([x, 1.65, z]) for x, z in ((-3.0, 24.0), (3.0, 34.0), (-2.0, 16.0), (3.5, 21.0), (-4.0, 30.0))]
    kinds = [car, car, van, van, van]

    def errors(fleet, ground):
        tracker = fgrecon.Tracker(size_prior=fleet, shared_ground=True)
        for frame in range(8):
            shown = {
                i: observe(kind, yaw_pose(2.0, place), noise=0.3, seed=10 * frame + i)
                for i, (kind, place) in enumerate(zip(kinds, places, strict=True))
            }
            found = tracker.update(0.1 * frame, shown, camera=CAMERA, ground=ground)
        return [float(np.linalg.norm(found[i].reconstruction.location - places[i])) for i in (0, 1)]

    assert max(errors("kitti", 1.65)) < 0.75 * max(errors(OWN, 1.65))
    assert errors("kitti", None) == errors(OWN, None)


def test_a_class_that_the_first_frame_tells_stays(vehicles):
    tracker = fgrecon.Tracker(size_prior="kitti")
    for time, one in enumerate([vehicles[1].with_evidence([VehicleClass("car")]), vehicles[1]]):
        estimate = tracker.update(0.1 * time, {0: one}, camera=CAMERA, ground=1.65)[0]
        assert not inside(estimate.reconstruction, PLACES[1])


def test_frames_that_say_nothing_leave_both_alike():
    assert mean_weights([None]) == {}


def test_a_van_is_as_unsure_as_vans_are(vehicles):
    """Among cars the covariances are those of cars: for a van the spread of vans takes the place of theirs."""
    setup = SolveSetup.of("car14", "kitti", None, 1.65)
    found = fgrecon.reconstruct(vehicles[0], CAMERA, size_prior=OWN, ground=1.65)
    problem = Problem.of(vehicles[0], CAMERA, setup.model, setup.ground, setup.options)
    either = either_class(problem, found.camera_T_object, found.shape.coefficients, setup, None)
    way = either.sizes[0] / np.linalg.norm(either.sizes[0])
    there = replace(found, shape=replace(found.shape, box_size=either.first_size + either.sizes[0]))
    before, after = (
        way @ one.uncertainty.size_covariance @ way for one in (there, either.added_to(there, {"van": 30.0}))
    )
    van, car = (setup.model_as(name).size.own_spread for name in ("van", "car"))
    assert after - before == pytest.approx(way @ (van - np.diag(OWN.sigma**2)) @ way, rel=1e-6)
    assert way @ car @ way < way @ van @ way
