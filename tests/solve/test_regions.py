"""Regions of a detector whose errors go together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import fgrecon
from fgrecon.calibration.labelled_boxes import normalised_squared_error
from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import position_covariance
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.options import KeypointOptions, Options, ShapeOptions
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.size_prior import SizePrior, other_fleets, size_prior
from fgrecon.io.catalogue import load_prior, shipped_class_sizes
from fgrecon.simulation.vehicles import Vehicle, simulate
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.vehicle.model import prepare
from tests.cars import CAMERA, observe, yaw_pose


def test_errors_that_go_together_widen_the_region_and_move_nothing():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    detected = replace(given, covariance=np.tile(4.0 * np.eye(2), (14, 1, 1)))
    narrow, wide = (
        fgrecon.reconstruct(detected, CAMERA, options=Options(keypoints=KeypointOptions(common_factor=factor)))
        for factor in (1.0, 4.0)
    )
    np.testing.assert_array_equal(narrow.camera_T_object, wide.camera_T_object)
    np.testing.assert_array_equal(narrow.diagnostics.weights, wide.diagnostics.weights)
    grown = np.diag(wide.uncertainty.pose_covariance) / np.diag(narrow.uncertainty.pose_covariance)
    assert ((grown > 1.0) & (grown <= 4.0 + 1e-6)).all()  # size and shape have a prior, which says as much as before
    assert grown[1] > 2.0  # yaw is by keypoints and box alone
    assert np.trace(wide.uncertainty.coefficients_covariance) > np.trace(narrow.uncertainty.coefficients_covariance)


def test_a_projected_3d_box_counts_whole():
    """It is no detector's: however little the keypoints say, it says where the car is."""
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    detected = replace(given, covariance=np.tile(4.0 * np.eye(2), (14, 1, 1)))

    def position(encloses, factor):
        options = Options(box=encloses, keypoints=KeypointOptions(common_factor=factor))
        found = fgrecon.reconstruct(detected, CAMERA, size_prior="3.9,1.6,1.5", options=options)
        return np.diag(found.uncertainty.pose_covariance)[3:]

    assert (position("cuboid", 100.0) < 20.0 * position("cuboid", 1.0)).all()
    for encloses in ("surface", "detected"):
        assert (position(encloses, 100.0) > 40.0 * position(encloses, 1.0)).all()


def test_the_default_is_for_detectors_that_give_covariances():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    apart = Options(keypoints=KeypointOptions(common_factor=1.0))
    plain, asked = fgrecon.reconstruct(given, CAMERA), fgrecon.reconstruct(given, CAMERA, options=apart)
    np.testing.assert_array_equal(plain.uncertainty.pose_covariance, asked.uncertainty.pose_covariance)
    scene = fgrecon.reconstruct_scene([given, given], CAMERA, ground=1.65, options=apart)
    np.testing.assert_array_equal(
        scene.vehicles[0].uncertainty.pose_covariance,
        fgrecon.reconstruct_scene([given, given], CAMERA, ground=1.65).vehicles[0].uncertainty.pose_covariance,
    )
    with pytest.raises(InvalidInputError, match="common_factor"):
        KeypointOptions(common_factor=0.5)


def test_frames_that_left_a_window_count_as_those_in_it():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    detected = replace(given, covariance=np.tile(4.0 * np.eye(2), (14, 1, 1)))
    tracker, spread = fgrecon.Tracker(size_prior="kitti", window=2), []  # of two frames one leaves at each step
    for time in range(12):
        (estimate,) = tracker.update(0.1 * time, {0: detected}, camera=CAMERA, ground=1.65).values()
        spread.append(np.sqrt(np.diag(estimate.reconstruction.uncertainty.size_covariance)))
    assert (np.array(spread) > 0.95 * spread[0]).all()  # the same image again says no more
    assert (np.array(spread) < 1.2 * spread[0]).all()


def test_sizes_are_as_uncertain_as_those_of_the_traffic():
    given, fleet = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5), size_prior("kitti")
    cars = SizePrior("cars", fleet.mean, fleet.sigma, allowed=fleet.allowed)
    np.testing.assert_array_equal(cars.spread, np.diag(cars.sigma**2))
    with_vans, alone = (fgrecon.reconstruct(given, CAMERA, size_prior=size) for size in (fleet, cars))
    np.testing.assert_array_equal(with_vans.camera_T_object, alone.camera_T_object)
    assert (np.diag(with_vans.uncertainty.size_covariance) > np.diag(alone.uncertainty.size_covariance)).all()
    assert np.trace(with_vans.uncertainty.pose_covariance[3:, 3:]) > np.trace(alone.uncertainty.pose_covariance[3:, 3:])


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")  # one car in a hundred
@pytest.mark.parametrize("name", ["car", "van"])
def test_regions_hold_for_vehicles_drawn_as_the_solve_has_them(name):
    """Shapes, noise and heights are those of the model: what regions hold is as often as they say, but for chance."""
    rng, count = np.random.default_rng(7), 120
    setup, ground = SolveSetup.of("car14", "kitti", None), Ground.level(1.65)
    model = setup.model_as(name)
    spread = model.spread_of(shipped_class_sizes().covariance[name])
    inside = {quantity: np.zeros(2) for quantity in ("position", "yaw", "size")}
    for _ in range(count):
        shape = rng.multivariate_normal(np.zeros(len(spread)), spread, method="cholesky")
        depth = rng.uniform(8.0, 40.0)
        height = 1.65 + ground.height_sigma_at_depth(depth) * rng.normal()
        pose = yaw_pose(rng.uniform(-np.pi, np.pi), np.array([rng.uniform(-0.4, 0.4) * depth, height, depth]))
        _, truth = simulate(Vehicle.of_prior(model.prior, shape), CAMERA, pose, rng)
        extent = max(truth.box[2] - truth.box[0], truth.box[3] - truth.box[1])
        seen = fgrecon.Observation(
            truth.projections + np.hypot(0.035 * extent, 1.0) * rng.normal(size=(14, 2)),
            np.full(14, 0.99),
            truth.box + np.hypot(0.02 * extent, 1.5) * rng.normal(size=4),
        ).with_evidence([fgrecon.VehicleClass(name)])
        found = fgrecon.reconstruct(seen, CAMERA, ground=ground, size_prior="kitti")
        known = found.uncertainty
        off = {
            "position": (
                found.location - pose[:3, 3],
                position_covariance(found.camera_T_object, known.pose_covariance),
            ),
            "yaw": (
                wrap_angle(rotation_y(found.camera_T_object) - rotation_y(pose))[None],
                known.pose_covariance[1:2, 1:2],
            ),
            "size": (found.box_size - model.prior.box_size(shape), known.size_covariance),
        }
        for quantity, (error, covariance) in off.items():
            inside[quantity] += normalised_squared_error(error, covariance) < chi2.ppf([0.68, 0.95], len(error))
    for quantity, hits in inside.items():
        assert (np.abs(hits / count - [0.68, 0.95]) < [0.165, 0.08]).all(), quantity  # 8 points, and chance


def test_where_no_fleet_is_given_it_may_be_another_one():
    """The prior and regions are wider by that; a size that is given is known."""
    given, prior = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5), load_prior("car14")
    model, mean = prepare(prior), prior.box_size(np.zeros(prior.dimension))
    basis = model.dimension_basis
    sizes = basis @ model.any_fleet_spread @ basis.T
    np.testing.assert_allclose(sizes, basis @ basis.T + other_fleets(mean), rtol=1e-9)
    known = SizePrior("known", mean, np.full(3, 0.01))
    assert prepare(prior, known).size_errors is None
    results = {}
    for name, size in (("assumed", None), ("its own", SizePrior("its own", mean, np.sqrt(np.diag(basis @ basis.T))))):
        results[name] = fgrecon.reconstruct(given, CAMERA, size_prior=size)
    spread = {name: np.trace(one.uncertainty.size_covariance) for name, one in results.items()}
    assert spread["assumed"] > 1.2 * spread["its own"]
    far = {name: np.trace(one.uncertainty.pose_covariance[3:, 3:]) for name, one in results.items()}
    assert far["assumed"] > 1.2 * far["its own"]


def test_who_knows_that_the_fleet_is_the_priors_own_says_so():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    own = Options(shape=ShapeOptions(own_fleet=True))
    spread = [
        np.trace(fgrecon.reconstruct(given, CAMERA, options=o).uncertainty.size_covariance) for o in (own, Options())
    ]
    assert spread[1] > 1.2 * spread[0]
    seen = [given, observe(load_prior("car14"), yaw_pose(-2.0), noise=0.5, seed=1)]
    scenes = [fgrecon.reconstruct_scene(seen, CAMERA, options=o) for o in (own, Options())]
    assert np.trace(scenes[1].vehicles[0].uncertainty.size_covariance) > 1.2 * np.trace(
        scenes[0].vehicles[0].uncertainty.size_covariance
    )


def test_fleets_differ_by_all_their_dimensions_alike():
    spread = other_fleets(np.array([4.0, 2.0, 1.5]))
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), [0.32, 0.18, 0.105])
    assert np.linalg.eigvalsh(spread)[0] > 0.0
    assert spread[0, 1] == pytest.approx(0.9 * 0.32 * 0.18)


@pytest.mark.parametrize("field", ["traffic", "own"])
@pytest.mark.parametrize("given", [np.eye(2), -np.eye(3), [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
def test_what_sizes_vary_by_is_a_covariance(field, given):
    with pytest.raises(InvalidInputError, match=rf"size_prior\.{field}"):
        SizePrior("some", np.ones(3), np.ones(3), **{field: given})


@pytest.mark.parametrize("allowed", [np.zeros(3), np.ones(2), [0.1, np.nan, 0.1]])
def test_what_a_solve_allows_is_a_spread(allowed):
    with pytest.raises(InvalidInputError, match=r"size_prior\.allowed"):
        SizePrior("some", np.ones(3), np.ones(3), allowed=allowed)


def test_a_solve_is_given_what_it_allows():
    given, fleet = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5), size_prior("kitti")
    loose, tight = (SizePrior("cars", fleet.mean, fleet.sigma, allowed=share * fleet.sigma) for share in (1.0, 0.1))
    away = [fgrecon.reconstruct(given, CAMERA, size_prior=size).box_size - fleet.mean for size in (loose, tight)]
    assert np.linalg.norm(away[1]) < 0.5 * np.linalg.norm(away[0])
