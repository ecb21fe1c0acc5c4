"""A fleet with vans: which vehicle is one, its image says."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon import VehicleClass
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.fitted_class import with_fitted_classes
from fgrecon.solve.inputs import SolveSetup, as_ground
from tests.cars import CAMERA, observe, yaw_pose

VAN = np.array([5.0, 1.9, 2.2])
PLACES = (2.0, 1.65, 18.0), (-3.0, 1.65, 24.0)
SETUP = SolveSetup.of("car14", "kitti_traffic", None)


@pytest.fixture(scope="module")
def vehicles():
    """A car and a van."""
    prior = load_prior("car14")
    priors = prior.for_fleet(SIZE_PRIORS["kitti"]), prior.for_fleet(fgrecon.SizePrior("van", VAN, 0.05 * VAN))
    each = zip(priors, PLACES, strict=True)
    return [observe(one, yaw_pose(2.0, place), noise=0.3, seed=3) for one, place in each]


def off(result, place):
    return float(np.linalg.norm(result.location - place))


def test_a_van_is_distinguished_from_a_car(vehicles):
    car, van = (one.evidence[-1].probabilities["van"] for one in with_fitted_classes(vehicles, CAMERA, SETUP, None))
    assert car < 0.2 < 0.5 < van
    _, on_ground = with_fitted_classes(vehicles, CAMERA, SETUP, as_ground(1.65))
    assert on_ground.evidence[-1].probabilities["van"] > van, "where it stands says how large it is"


def test_whose_class_is_given_and_other_fleets_are_left_alone(vehicles):
    given = [replace(vehicles[1], evidence=(VehicleClass("car"),))]
    assert with_fitted_classes(given, CAMERA, SETUP, None) == given
    assert with_fitted_classes(vehicles, CAMERA, SolveSetup.of("car14", "kitti", None), None) == vehicles
    nothing = fgrecon.Observation.of(np.full((14, 2), np.nan))
    assert with_fitted_classes([nothing], CAMERA, SETUP, None) == [nothing]


def test_what_another_program_leaves_open_its_image_decides(vehicles):
    """Whatever the fleet; what is said of lorries stays."""
    for fleet in (None, "kitti", "kitti_traffic"):
        setup = SolveSetup.of("car14", fleet, None)
        for_either = {}
        for van in (0.0001, 0.05, 0.3):
            said = VehicleClass({"car": 0.9 - van, "van": van, "lorry": 0.1})
            given = [one.with_evidence([said]) for one in vehicles]
            found = with_fitted_classes(given, CAMERA, setup, as_ground(1.65))
            for_either[van] = [one.evidence[-1].probabilities["van"] for one in found]
            assert all(len(one.evidence) == len(other.evidence) for one, other in zip(found, given, strict=True))
            assert all(one.evidence[-1].probabilities["lorry"] == pytest.approx(0.1) for one in found)
        assert for_either[0.0001] == [0.0001, 0.0001], "too sure"
        car, van = np.transpose([for_either[0.05], for_either[0.3]])
        assert car[0] < car[1] < van[0] < van[1], "both count"
        assert van[0] > 0.5


def test_a_van_is_where_it_is(vehicles):
    found, mixed = (
        [fgrecon.reconstruct(one, CAMERA, size_prior=fleet, ground=1.65) for one in vehicles]
        for fleet in ("kitti", "kitti_traffic")
    )
    assert off(mixed[1], PLACES[1]) < 0.5 * off(found[1], PLACES[1])
    assert off(mixed[0], PLACES[0]) < off(found[0], PLACES[0]) + 0.3
    scene = fgrecon.reconstruct_scene(vehicles, CAMERA, size_prior="kitti_traffic", ground=1.65)
    assert off(scene.vehicles[1], PLACES[1]) < 0.5 * off(found[1], PLACES[1])


def test_over_time_all_frames_say_which_it_is(vehicles):
    tracker = fgrecon.Tracker(size_prior="kitti_traffic", shared_ground=True)
    for time in (0.0, 0.1, 0.2):
        estimates = tracker.update(time, dict(enumerate(vehicles)), camera=CAMERA, ground=1.65)
    assert off(estimates[1].reconstruction, PLACES[1]) < 1.5
    assert off(estimates[0].reconstruction, PLACES[0]) < 1.0


def test_images_of_one_vehicle_say_together_which_it_is(vehicles):
    found, mixed = (
        fgrecon.reconstruct_track([vehicles[1]] * 3, CAMERA, size_prior=fleet, ground=1.65)
        for fleet in ("kitti", "kitti_traffic")
    )
    assert off(mixed.frames[0], PLACES[1]) < 0.5 * off(found.frames[0], PLACES[1])
    given = [replace(one, evidence=(VehicleClass("car"),)) for one in vehicles]
    car = fgrecon.reconstruct_track([vehicles[1], given[1]], CAMERA, size_prior="kitti_traffic", ground=1.65)
    assert off(car.frames[0], PLACES[1]) > 2.0 * off(mixed.frames[0], PLACES[1]), "what somebody says counts alone"


def test_images_of_a_track_decide_what_is_left_open(vehicles):
    """As single images and a tracker do; what is said with one image holds in all."""
    said = VehicleClass({"car": 0.75, "van": 0.25})
    for vehicle, is_van in zip(vehicles, (False, True), strict=True):
        image = fgrecon.reconstruct(vehicle.with_evidence([said]), CAMERA, ground=1.65)
        track = fgrecon.reconstruct_track([vehicle.with_evidence([said]), vehicle], CAMERA, ground=1.65)
        names = {frame.shape.prior for frame in track.frames}
        assert names == {image.shape.prior}
        van = float(names.pop().rpartition(" ")[2])
        assert (van > 0.5) == is_van
        sure = fgrecon.reconstruct_track([vehicle.with_evidence([VehicleClass("car")]), vehicle], CAMERA, ground=1.65)
        assert "van" not in sure.frames[1].shape.prior
