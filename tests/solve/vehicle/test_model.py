"""A prior made ready: sizes, boxes and outlines against the prior itself."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel
from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.model import LinearPoints, prepare
from tests.cars import project, yaw_pose


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def test_linear_points():
    rng = np.random.default_rng(0)
    points = LinearPoints(rng.normal(size=(4, 3)), rng.normal(size=(2, 4, 3)))
    expected = points.mean + 0.3 * points.basis[0] - 2.0 * points.basis[1]
    np.testing.assert_allclose(points.at(np.array([0.3, -2.0])), expected)


@pytest.mark.parametrize("fleet", [None, "kitti"])
def test_dimensions_are_the_priors(prior, fleet):
    size = None if fleet is None else SIZE_PRIORS[fleet]
    model = prepare(prior, size)
    coefficients = np.array([0.5, -1.0, 0.3, 1.2, -0.4])
    box_size = model.prior.box_size(coefficients)
    np.testing.assert_allclose(model.dimension_mean + model.dimension_basis @ coefficients, box_size)
    corners = model.corners.at(coefficients)
    np.testing.assert_allclose(np.ptp(corners, axis=0), box_size[[0, 2, 1]])
    assert corners[:, 1].max() == pytest.approx(0.0, abs=1e-12)  # it stands on the ground
    np.testing.assert_allclose(corners[:, [0, 2]].mean(axis=0), 0.0, atol=1e-12)
    if size is not None:
        np.testing.assert_allclose(model.dimension_mean, size.mean)


@pytest.mark.parametrize("yaw", np.radians([0, 30, 75, 120, -60, 180]))
@pytest.mark.parametrize("shape", [0, 1])
def test_the_outline_gives_the_surfaces_box(prior, yaw, shape):
    """Few points, chosen on the mean shape, span the box of the whole surface to 2 % of its longer side."""
    coefficients = np.random.default_rng(1).normal(size=prior.dimension) * shape
    model = prepare(prior)
    pose = yaw_pose(yaw)

    def box(points):
        pixels = project(points, pose)
        return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])

    whole = box(prior.surface.vertices(coefficients))
    tight = box(model.outline.at(coefficients))
    assert len(model.outline.mean) < 0.2 * len(prior.surface.mean)
    np.testing.assert_allclose(tight, whole, atol=0.02 * (whole[2:] - whole[:2]).max())


def test_box_models(prior):
    model = prepare(prior)
    assert model.box_points(BoxModel.SURFACE) is model.outline
    assert model.box_points(BoxModel.CUBOID) is model.corners
    bare = prepare(replace(prior, surface=None))
    assert bare.outline is bare.corners


def test_the_same_request_is_answered_once(prior):
    assert prepare(prior, SIZE_PRIORS["kitti"], 3) is prepare(prior, SIZE_PRIORS["kitti"], 3)


def test_basis_vectors(prior):
    model = prepare(prior, None, 2)
    np.testing.assert_array_equal(model.prior.basis, prior.basis[:2])
    assert model.dimension_basis.shape == (3, 2)
    nothing = prepare(prior, None, 0)
    assert nothing.dimension_basis.shape == (3, 0)
    assert nothing.corners.basis.shape == (0, 8, 3)
    with pytest.raises(InvalidInputError) as caught:
        prepare(prior, None, 6)
    assert caught.value.field == "options.shape.basis_vectors"


def test_the_size_of_one_car_moves_the_shape_and_that_of_a_fleet_stretches_it(prior):
    wanted = prior.box_size([1.0, -0.5, 0.3, 0.2, 0.0])
    one = prepare(prior, SizePrior("papers", wanted, 0.02 * wanted))
    np.testing.assert_allclose(one.dimension_mean, wanted, rtol=0.02)
    assert one.size is None  # the prior holds it: as a term of its own it would count twice
    assert one.prior.name == "car14 given papers"
    spread = np.sqrt(np.square(one.dimension_basis).sum(axis=1))
    assert (spread <= 0.02 * wanted).all()
    fleet = SIZE_PRIORS["kitti"]
    assert prepare(prior, fleet).size is fleet
