"""The 2D box as evidence."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.box import BoxRows, crease_rows, kink, soft_extents
from factors.keypoint_rows import KeypointRows
from factors.keys import L, X
from factors.mixture import Form
from factors.observation_rows import ObservationRows, term_factor
from factors.projection_kernel import ProjectionKernel
from factors.shape import LinearShape
from factors.shape_prior import coefficients_prior
from tests.factors.support import (
    CAMERA,
    assert_jacobian,
    bound_shape,
    car_like,
    graph_of,
    optimize,
    project,
    random_pose,
)

BOX = [100.0, 100.0, 300.0, 200.0]
ALL = [True, True, True, True]


def box_factor(kernel, box, sigma, *, softness, edges=ALL):
    """The box's rows alone, of points of the keypoints' own kernel."""
    rows = BoxRows(np.array(box), np.array(edges), sigma, 0.01, softness)
    size = kernel.shape.size
    keypoints = KeypointRows(np.zeros((size, 2)), np.ones((size, 3)))
    return term_factor(ObservationRows(kernel, keypoints, box=rows, outline=kernel, form=Form.WEIGHTED), "box")


@settings(deadline=None, derandomize=True, max_examples=10)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.booleans(), min_size=4, max_size=4).filter(any),
    st.floats(0.5, 20.0),
)
def test_value_and_jacobian(seed, edges, softness):
    rng = np.random.default_rng(seed)
    shape, values = bound_shape(rng, keypoints=100)
    pose = random_pose(rng)
    values.insert(X(), pose)
    pixels = project(shape.points(values), pose)
    extent = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    for p in (X(), pose):
        kernel = ProjectionKernel(shape, CAMERA, p)
        hard = box_factor(kernel, BOX, 1.0, softness=1e-4, edges=edges)
        np.testing.assert_allclose(hard.unwhitenedError(values)[edges], (extent - BOX)[edges], atol=1e-4)
        soft = box_factor(kernel, BOX, 1.0, softness=softness, edges=edges)
        shrunk = (hard.unwhitenedError(values) - soft.unwhitenedError(values)) * np.array([-1, -1, 1, 1])
        assert not soft.unwhitenedError(values)[~np.array(edges)].any()
        assert (shrunk > -1e-9).all()
        assert_jacobian(soft, values, step=1e-6, relative=1e-6)


@settings(deadline=None, derandomize=True, max_examples=10)
@given(st.floats(0.0, 10.0), st.floats(0.1, 5.0))
def test_bias_between_two_points(gap, softness):
    """Two points `gap` pixels apart: the soft extreme lies at most 0.28 softness inside the hard one."""
    depth = 10.0
    mean = np.array([[0.0, 0.0, 0.0], [gap * depth / CAMERA[0, 0], 0.0, 0.0]])
    kernel = ProjectionKernel(LinearShape(mean, np.zeros((0, 2, 3)), np.zeros(0)), CAMERA, X())
    values = gtsam.Values()
    values.insert(X(), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, depth])))
    edges = [False, False, True, False]
    factor = box_factor(kernel, [0.0, 0.0, CAMERA[0, 2] + gap, 1.0], 1.0, softness=softness, edges=edges)
    assert -0.28 * softness <= factor.unwhitenedError(values)[2] <= 1e-9


@given(st.floats(0.0, 30.0), st.floats(-30.0, 30.0), st.floats(0.1, 5.0))
def test_the_parabola_of_a_kink_lies_nowhere_below_the_soft_maximum(behind, other, softness):
    """In the difference of two pixels, whose mean stays."""

    def of(difference):
        pixels = np.array([[0.5 * difference, 0.0], [-0.5 * difference, 0.0]])
        extents, share = soft_extents(pixels, softness)
        return extents[2], 0.5 * (share[2, 0] - share[2, 1])

    (here, slope), away = of(behind), other - behind
    curvature = float(kink(np.array(behind), softness))
    assert of(other)[0] <= here + slope * away + 0.5 * curvature * away**2 + 1e-7 * (1.0 + away**2)


def test_a_crease_bends_the_energy_as_its_row_says():
    """A cuboid whose right side lies along the line of sight: it is seen wider whichever way it turns."""
    corners = np.array([[x, y, z] for x in (-2.0, 2.0) for y in (-1.5, 0.0) for z in (-0.8, 0.8)])
    kernel = ProjectionKernel(LinearShape(corners, np.zeros((0, 8, 3)), np.zeros(0)), CAMERA, X())
    values, softness, beyond = gtsam.Values(), 0.5, 3.0
    values.insert(X(), gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([-0.8, 1.6, 15.0])))
    edges = [0.0, 0.0, CAMERA[0, 2] - 10.0, 1.0]
    factor = box_factor(kernel, edges, 1.0, softness=softness, edges=[False, False, True, False])

    def extent(turn):
        moved = gtsam.Values(values)
        moved.update(X(), values.atPose3(X()).retract(np.array([0.0, turn, 0.0, 0.0, 0.0, 0.0])))
        return factor.unwhitenedError(moved)[2]

    bends = beyond * (extent(1e-4) - 2.0 * extent(0.0) + extent(-1e-4)) / 1e-8
    rows = crease_rows(kernel, values, softness, np.array([-1.0, 0.0, beyond, -beyond]))
    assert np.square(rows[2, 1]) == pytest.approx(bends, rel=0.05)  # the projection itself bends it a little
    assert not rows[[0, 1, 3]].any()


def test_moves_the_vehicle_into_the_box():
    mean, basis = car_like(np.random.default_rng(0), keypoints=100)
    truth = gtsam.Pose3(gtsam.Rot3.Ry(0.4), np.array([1.0, 1.6, 15.0]))
    pixels = project(mean, truth)
    box = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    start = gtsam.Pose3(truth.rotation(), truth.translation() + np.array([0.6, -0.3, 2.0]))
    values = gtsam.Values()
    values.insert(X(), start)
    values.insert(L(), np.zeros(5))
    upright = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-4] * 3 + [1e3] * 3))
    graph = graph_of(
        box_factor(ProjectionKernel(LinearShape(mean, basis, L()), CAMERA, X()), box, 0.1, softness=1e-3),
        gtsam.PriorFactorPose3(X(), start, upright),
        coefficients_prior(L(), 5, 1e-4),
    )
    result = optimize(graph, values)
    np.testing.assert_allclose(result.atPose3(X()).translation(), truth.translation(), atol=1e-3)
