"""A class that is given for a vehicle tells its size, and nothing of vehicles that have none."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon import VehicleClass
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.inputs import SolveSetup
from tests.cars import CAMERA, observe, yaw_pose

VAN = np.array([5.0, 1.9, 2.2])
PLACES = (2.0, 1.65, 18.0), (-3.0, 1.65, 24.0), (5.0, 1.65, 30.0)


@pytest.fixture(scope="module")
def van():
    """The prior of vehicles of a van's size."""
    return load_prior("car14").for_fleet(fgrecon.SizePrior("van", VAN, 0.05 * VAN))


def seen(prior, place=PLACES[0], **evidence):
    return replace(observe(prior, yaw_pose(2.0, place), noise=0.3), **evidence)


def off(result, place=PLACES[0]):
    return float(np.linalg.norm(result.location - place))


def test_a_van_is_where_it_is_by_its_class(van):
    without = fgrecon.reconstruct(seen(van), CAMERA, size_prior="kitti")
    told = fgrecon.reconstruct(seen(van), CAMERA, size_prior="kitti", evidence=[VehicleClass("van")])
    by_observation = fgrecon.reconstruct(
        seen(van, evidence=(VehicleClass("Van", "kitti"),)), CAMERA, size_prior="kitti"
    )
    assert off(told) < 0.3 * off(without)
    assert told.shape.prior == "car14 of van"
    np.testing.assert_array_equal(told.location, by_observation.location)


def test_no_fleet_and_another_fleet_leave_a_van_its_size(van):
    for fleet in (None, "apollo79"):
        told = fgrecon.reconstruct(seen(van), CAMERA, size_prior=fleet, evidence=[VehicleClass("van")])
        assert off(told) < 2.0, fleet


def test_a_car_that_is_sure_to_be_one_is_of_its_fleet():
    one = seen(load_prior("car14"))
    for fleet in (None, "apollo79"):
        plain = fgrecon.reconstruct(one, CAMERA, size_prior=fleet)
        told = fgrecon.reconstruct(one, CAMERA, size_prior=fleet, evidence=[VehicleClass("car")])
        np.testing.assert_array_equal(told.location, plain.location)


def test_each_vehicle_of_a_scene_has_its_own(van):
    cars = load_prior("car14").for_fleet(SIZE_PRIORS["kitti"])
    seen_by = [seen(cars, PLACES[0]), seen(van, PLACES[1], evidence=(VehicleClass("van"),)), seen(cars, PLACES[2])]
    scene = fgrecon.reconstruct_scene(seen_by, CAMERA, size_prior="kitti", ground=1.65)
    assert "van" in scene.vehicles[1].shape.prior
    assert "van" not in scene.vehicles[0].shape.prior
    assert off(scene.vehicles[1], PLACES[1]) < 1.5


def test_images_of_a_track_share_what_they_say(van):
    each = [seen(van, (2.0, 1.65, depth)) for depth in (16.0, 18.0)]
    said = {"evidence": (VehicleClass({"van": 0.9, "car": 0.1}),)}
    track = fgrecon.reconstruct_track([replace(each[0], **said), each[1]], CAMERA, size_prior="kitti")
    names = {frame.shape.prior for frame in track.frames}
    assert names == {"car14 of car 0.10, van 0.90"}


def test_a_tracked_vehicle_keeps_what_its_first_frame_said(van):
    tracker = fgrecon.Tracker(size_prior="kitti")
    for t, evidence in enumerate(((VehicleClass("van"),), (), (VehicleClass("car"),))):
        found = tracker.update(t / 10.0, {0: seen(van, evidence=evidence)}, camera=CAMERA)
        assert found[0].reconstruction.shape.prior == "car14 of van"


def test_a_lorry_says_that_its_shape_is_a_stretched_one():
    size = np.array([10.0, 2.5, 3.2])
    lorry = load_prior("car14").for_fleet(fgrecon.SizePrior("lorry", size, 0.05 * size))
    told = fgrecon.reconstruct(seen(lorry), CAMERA, evidence=[VehicleClass("Truck", "kitti")])
    assert told.status is Status.WEAK
    assert "the shape of a lorry is a stretched car14's" in told.reasons
    assert told.box_size[0] > 7.0


def test_a_class_that_there_is_not_is_refused():
    with pytest.raises(InvalidInputError, match=r"vehicle_class.*Names of fgrecon are car"):
        fgrecon.reconstruct(seen(load_prior("car14")), CAMERA, evidence=[VehicleClass("ship")])
    with pytest.raises(InvalidInputError, match="evidence"):
        Observation(np.zeros((14, 2)), np.ones(14), evidence=("van",))


def test_a_networks_kinds_do_not_move_sizes_by_themselves():
    setup = SolveSetup.of("car14", None, None)
    detection = fgrecon.Detection(seen(load_prior("car14")), kinds={"car": 0.1, "van": 0.9, "lorry": 0.0})
    assert setup.model_of([detection.evidence]).prior.name == "car14"
