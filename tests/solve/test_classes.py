"""A class that is given for a vehicle tells its size, and nothing of vehicles that have none."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon import VehicleClass
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import coarse_prior, load_prior, shipped_class_sizes
from fgrecon.solve.class_filter import ClassBelief
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
    classed = fgrecon.reconstruct(seen(van), CAMERA, size_prior="kitti", evidence=[VehicleClass("van")])
    by_observation = fgrecon.reconstruct(
        seen(van, evidence=(VehicleClass("Van", "kitti"),)), CAMERA, size_prior="kitti"
    )
    assert off(classed) < 0.3 * off(without)
    assert classed.shape.prior == "car14 of van"
    np.testing.assert_array_equal(classed.location, by_observation.location)


def test_no_fleet_and_another_fleet_leave_a_van_its_size(van):
    for fleet in (None, "apollo79"):
        classed = fgrecon.reconstruct(seen(van), CAMERA, size_prior=fleet, evidence=[VehicleClass("van")])
        assert off(classed) < 2.0, fleet


def test_a_car_that_is_sure_to_be_one_is_of_its_fleet():
    one = seen(load_prior("car14"))
    for fleet in (None, "apollo79"):
        plain = fgrecon.reconstruct(one, CAMERA, size_prior=fleet)
        classed = fgrecon.reconstruct(one, CAMERA, size_prior=fleet, evidence=[VehicleClass("car")])
        np.testing.assert_array_equal(classed.location, plain.location)


def test_sizes_of_either_class_are_those_of_each_and_what_is_between():
    sizes, probabilities = shipped_class_sizes(), {"car": 0.7, "van": 0.3}
    mixed = sizes.size(probabilities, None, any_fleet=False)
    between = sizes.mean["van"] - sizes.mean["car"]
    np.testing.assert_allclose(mixed.spread, mixed.own_spread + 0.21 * np.outer(between, between), atol=1e-12)


def test_each_vehicle_of_a_scene_has_its_own(van):
    cars = load_prior("car14").for_fleet(SIZE_PRIORS["kitti"])
    seen_by = [seen(cars, PLACES[0]), seen(van, PLACES[1], evidence=(VehicleClass("van"),)), seen(cars, PLACES[2])]
    scene = fgrecon.reconstruct_scene(seen_by, CAMERA, size_prior="kitti", ground=1.65)
    assert "van" in scene.vehicles[1].shape.prior
    assert "van" not in scene.vehicles[0].shape.prior
    assert off(scene.vehicles[1], PLACES[1]) < 1.5


def test_images_of_a_track_share_what_they_say(van, monkeypatch):
    monkeypatch.setattr("fgrecon.solve.track.with_fitted_classes", lambda seen, *_: seen)  # what is said counts alone
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


def followed(frames):
    """The prior that each frame of a tracked vehicle was solved with, and where it was, by its class in each."""
    tracker = fgrecon.Tracker(size_prior="kitti")
    found = []
    for t, (vehicle, evidence) in enumerate(frames):
        estimate = tracker.update(t / 3.0, {0: seen(vehicle, evidence=evidence)}, camera=CAMERA, ground=1.65)[0]
        found.append(estimate.reconstruction)
    smoothed = tracker.smooth()[0]
    assert {one.reconstruction.shape.prior for one in smoothed} == {found[-1].shape.prior}
    return found


def test_frames_decide_together_of_which_class_a_vehicle_is(van, monkeypatch):
    monkeypatch.setattr("fgrecon.solve.tracker.with_fitted_classes", lambda seen, *_: seen)  # what is said counts alone
    unsure, sure = (VehicleClass({"car": 0.6, "van": 0.4}),), (VehicleClass({"van": 0.8, "car": 0.2}),)
    found = followed([(van, unsure), (van, unsure), (van, sure), (van, sure), (van, ())])
    names = [one.shape.prior for one in found]
    assert "car 0.60" in names[0]
    shares = [float(re.search(r"van (\d\.\d+)|$", name)[1] or 0.0) for name in names]
    assert shares[2] == 0.4  # not enough to make all frames anew
    assert shares[3] > 0.8
    assert shares[4] == shares[3]
    truth = van.box_size(np.zeros(van.dimension))
    assert np.abs(found[-1].box_size - truth).mean() < 0.6 * np.abs(found[0].box_size - truth).mean()
    assert np.linalg.norm(found[-1].location - PLACES[0]) < np.linalg.norm(found[0].location - PLACES[0])


def test_what_every_frame_is_sure_of_before_its_image_counts_once():
    """Frames whose images say nothing leave the class as it is; one that says something moves it by that alone."""
    odds = -1.0
    before = {"car": 0.9 / (1.0 + np.exp(odds)), "van": 0.9 / (1.0 + np.exp(-odds)), "lorry": 0.1}
    belief = ClassBelief.first(before)
    for _ in range(20):
        belief = belief.updated({**before, "lorry": 0.02}, 10.0, 1e3, {"car": 0.0, "van": odds})
    assert belief.probability["van"] / belief.probability["car"] == pytest.approx(np.exp(odds))
    towards = {"car": 0.9 / (1.0 + np.exp(odds + 0.5)), "van": 0.9 / (1.0 + np.exp(-odds - 0.5)), "lorry": 0.1}
    belief = belief.updated(towards, 10.0, 1e3, {"car": 0.0, "van": odds})
    assert belief.probability["van"] / belief.probability["car"] == pytest.approx(np.exp(odds + 0.5))


def test_a_class_may_come_later(van):
    said = (VehicleClass("van"),)
    names = [one.shape.prior for one in followed([(van, ()), (van, ()), (van, said)])]
    assert names == ["car14 of kitti", "car14 of kitti", "car14 of van"]


def test_sizes_are_free_once_points_say_how_far_it_is(van):
    rotation, surface = yaw_pose(2.0)[:3, :3], van.surface.mean
    side = surface[surface @ rotation.T @ [0.0, 0.0, 1.0] < -0.5]
    points = fgrecon.Points(side @ rotation.T + PLACES[0], 0.05)
    tracker = fgrecon.Tracker(size_prior="kitti")
    allowed = []
    for t, evidence in enumerate(((), (points,), (points, VehicleClass("van")), (VehicleClass("van"),))):
        tracker.update(t / 3.0, {0: seen(van, evidence=evidence)}, camera=CAMERA, ground=1.65)
        frames = tracker._tracks[0].vehicle.frames
        allowed.append({float(one.problem.model.size.assumed_sigma[2]) for one in frames})
    free = [
        float(np.sqrt(SIZE_PRIORS["kitti"].spread[2, 2])),
        *2 * [shipped_class_sizes().covariance["van"][2, 2] ** 0.5],
    ]
    assert [len(one) for one in allowed] == [1, 1, 1, 1]
    assert [one.pop() for one in allowed] == pytest.approx([SIZE_PRIORS["kitti"].assumed_sigma[2], *free])


LORRY = np.array([9.0, 2.5, 3.4])


@pytest.fixture(scope="module")
def lorry():
    """The coarse prior, of a lorry's size."""
    cuboid = coarse_prior("cuboid14", load_prior("car14").category.keypoints)
    return cuboid.for_fleet(fgrecon.SizePrior("lorry", LORRY, 0.05 * LORRY))


def test_a_lorry_is_a_cuboid_and_says_so(lorry):
    one = seen(lorry, (2.0, 1.65, 25.0))
    alone = fgrecon.reconstruct(one, CAMERA, ground=1.65, size_prior="kitti")
    classed = fgrecon.reconstruct(
        one, CAMERA, ground=1.65, size_prior="kitti", evidence=[VehicleClass("Truck", "kitti")]
    )
    assert classed.status is Status.WEAK
    assert "the shape of a lorry is a cuboid" in classed.reasons
    assert classed.shape.category == "cuboid14"
    assert classed.shape.keypoint_names == load_prior("car14").category.keypoints
    assert np.abs(classed.box_size - LORRY).max() < 1.0  # lorries are 10 m long on average
    assert off(classed, (2.0, 1.65, 25.0)) < 1.0 < off(alone, (2.0, 1.65, 25.0))
    vertices = classed.shape.surface_vertices
    corners = np.abs(vertices / classed.box_size[[0, 2, 1]])  # x, y and z
    assert corners.max(axis=0) == pytest.approx([0.5, 1.0, 0.5], abs=0.02)
    assert json.loads(json.dumps(classed.to_dict()))["category"] == "cuboid14"


def test_a_lorry_has_points_on_its_sides(lorry):
    place = np.array([2.0, 1.65, 25.0])
    one = seen(lorry, tuple(place))
    rotation = yaw_pose(2.0)[:3, :3]
    vertices = lorry.surface.mean
    sensor = rotation.T @ -place
    shown = [(0, np.sign(sensor[0]) * 0.5 * LORRY[0]), (2, np.sign(sensor[2]) * 0.5 * LORRY[1])]
    sides = np.concatenate([vertices[np.isclose(vertices[:, axis], value, atol=1e-6)] for axis, value in shown])
    points = fgrecon.Points(sides @ rotation.T + place, 0.05)
    given = VehicleClass("lorry"), points
    found = fgrecon.reconstruct(one, CAMERA, ground=1.65, evidence=given)
    assert off(found, place) < 0.4
    assert found.diagnostics.point_weights.mean() > 0.5


def test_a_tracked_car_becomes_a_lorry(lorry):
    said = (), (VehicleClass("lorry"),), (VehicleClass("lorry"),)
    found = followed([(lorry, one) for one in said])
    assert found[0].shape.category == "car14"
    assert found[-1].shape.category == "cuboid14"
    assert np.abs(found[-1].box_size - LORRY).max() < np.abs(found[0].box_size - LORRY).max()


def test_a_class_that_there_is_not_is_refused():
    with pytest.raises(InvalidInputError, match=r"vehicle_class.*Names of fgrecon are car"):
        fgrecon.reconstruct(seen(load_prior("car14")), CAMERA, evidence=[VehicleClass("ship")])
    with pytest.raises(InvalidInputError, match="evidence"):
        Observation(np.zeros((14, 2)), np.ones(14), evidence=("van",))


def test_a_networks_kinds_do_not_move_sizes_by_themselves():
    setup = SolveSetup.of("car14", None, None)
    detection = fgrecon.Detection(seen(load_prior("car14")), kinds={"car": 0.1, "van": 0.9, "lorry": 0.0})
    assert setup.model_of([detection.evidence], [CAMERA]).prior.name == "car14"
