"""Silhouettes: the Jacobian against the numeric one, and a mask that brings a vehicle to its place."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.utils.numerical_derivative import numericalDerivative11

from factors import L, X
from factors.distance_field import DistanceField
from factors.mixture import Form
from factors.native import native
from factors.silhouette import SilhouetteFactor, SilhouetteOdds, SilhouetteRows
from tests.factors.test_surface_points import cuboid

MATRIX = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 120.0], [0.0, 0.0, 1.0]])
POSE = gtsam.Pose3(gtsam.Rot3.Ry(-1.2), np.array([1.0, 1.6, 12.0]))
ODDS = SilhouetteOdds(right=0.9, span=100.0, hidden=3.0, border=1.0, independent=12.0)
ANGLES = 2.0 * np.pi * np.arange(32) / 32
DIRECTIONS = np.stack([np.cos(ANGLES), np.sin(ANGLES)])


def outline(pose: gtsam.Pose3) -> np.ndarray:
    """(M, 2) corners of the convex hull of the cuboid's projection."""
    from scipy.spatial import ConvexHull

    camera = cuboid()[0] @ pose.rotation().matrix().T + pose.translation()
    pixels = camera[:, :2] / camera[:, 2:] @ MATRIX[:2, :2].T + MATRIX[:2, 2]
    return pixels[ConvexHull(pixels).vertices]


def field_of(corners: np.ndarray) -> DistanceField:
    """Distance from a convex polygon, exact."""
    grid = np.stack(np.meshgrid(np.arange(640.0), np.arange(240.0)), axis=-1)
    distance, inside = np.full(grid.shape[:2], np.inf), np.ones(grid.shape[:2], dtype=bool)
    for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = other - one
        share = np.clip(((grid - one) @ along) / (along @ along), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(grid - one - share[..., None] * along, axis=-1))
        inside &= along[0] * (grid[..., 1] - one[1]) - along[1] * (grid[..., 0] - one[0]) > 0.0
    return DistanceField(np.zeros(2), np.where(inside, -distance, distance))


@pytest.fixture(name="rows", scope="module")
def _rows() -> SilhouetteRows:
    mean, basis, _ = cuboid()
    corners = outline(POSE)
    farthest = corners[(corners @ DIRECTIONS).argmax(axis=0)]
    return SilhouetteRows(field_of(corners), None, MATRIX, (640, 240), mean, basis, DIRECTIONS, farthest, 3.0, ODDS)


def at(change: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(X(0, 0), POSE.retract(change))
    values.insert(L(0), np.array([0.02, -0.05]))
    return values


CHANGE = np.array([0.01, 0.03, -0.02, 0.05, 0.02, -0.04])


def test_the_field_is_linear_between_pixels_and_goes_on_beyond() -> None:
    field = DistanceField(np.array([10.0, 20.0]), np.array([[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]]))
    distance, slope = field.at(np.array([[10.5, 20.25], [11.7, 20.9], [15.0, 20.5], [12.0, 25.0]]))
    assert distance == pytest.approx([0.75, 2.6, 2.5 + 3.0, 3.0 + 4.0])
    assert slope[0] == pytest.approx([1.0, 1.0])
    assert slope[2] == pytest.approx([1.0, 1.0])


def test_the_jacobian_is_the_numeric_one(rows: SilhouetteRows) -> None:
    factor, values = SilhouetteFactor(rows, X(0, 0), L(0)), at(CHANGE)
    factor.look(values)
    factor.tell(Form.WEIGHTED)
    _, jacobian = factor(values, want_jacobian=True)

    def residual(key: int, value: object) -> np.ndarray:
        other = gtsam.Values(values)
        other.update(key, value)
        return factor(other, want_jacobian=False)[0]

    by_pose = numericalDerivative11(lambda pose: residual(X(0, 0), pose), values.atPose3(X(0, 0)), 1e-6)
    by_shape = numericalDerivative11(lambda x: residual(L(0), x), values.atVector(L(0)), 1e-6)
    assert jacobian == pytest.approx(np.hstack([by_pose, by_shape]), abs=1e-3)


def test_a_mask_brings_a_vehicle_to_its_place(rows: SilhouetteRows) -> None:
    factor, values = SilhouetteFactor(rows, X(0, 0), L(0)), at(np.array([0.0, 0.06, 0.0, 0.2, 0.05, -0.3]))
    for _ in range(30):
        factor.look(values)
        factor.tell(Form.MAJORISED)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factor.factor())
        graph.add(gtsam.PriorFactorVector(L(0), np.zeros(2), gtsam.noiseModel.Isotropic.Sigma(2, 0.01)))
        graph.add(gtsam.PriorFactorPose3(X(0, 0), values.atPose3(X(0, 0)), gtsam.noiseModel.Isotropic.Sigma(6, 0.5)))
        values = values.retract(graph.linearize(values).optimize())
    off = POSE.localCoordinates(values.atPose3(X(0, 0)))
    assert np.abs(off[:3]).max() < 0.01
    assert np.abs(off[3:]).max() < 0.03
    assert factor.energy(values) < 0.1


def test_what_is_hidden_or_outside_says_nothing(rows: SilhouetteRows) -> None:
    state = POSE.rotation().matrix(), POSE.translation(), np.zeros(2)
    _, says = rows.match(*state)
    corners = outline(POSE)
    half = field_of(np.array([[0.0, 0.0], [corners[:, 0].mean(), 0.0], [corners[:, 0].mean(), 239.0], [0.0, 239.0]]))
    vertices, hidden = replace(rows, hides=half).match(*state)
    assert 0 < hidden.sum() < says.sum()
    assert rows.share(hidden) >= rows.share(says)
    _, cut = replace(rows, image_size=(int(corners[:, 0].mean()), 240)).match(*state)
    assert 0 < cut.sum() < says.sum()
    assert len(vertices) == 32


@pytest.fixture(name="hidden", params=[False, True])
def _hidden(request: pytest.FixtureRequest, rows: SilhouetteRows) -> SilhouetteRows:
    """The mask alone, and with something before a half of it."""
    middle = outline(POSE)[:, 0].mean()
    corners = np.array([[0.0, 0.0], [middle, 0.0], [middle, 239.0], [0.0, 239.0]])
    return replace(rows, hides=field_of(corners) if request.param else None)


def plain(rows: SilhouetteRows) -> SilhouetteRows:
    """The same by numpy."""
    other = replace(rows)
    other.__dict__["compiled"] = None
    return other


compiled = pytest.mark.skipif(native("factors._silhouette") is None, reason="no compiled kernel")


@compiled
def test_the_compiled_rows_are_those_of_numpy(hidden: SilhouetteRows) -> None:
    rng = np.random.default_rng(2)
    for size in (0.05, 0.2, 2.0):  # the last is behind the camera at times, and far off the field
        for _ in range(5):
            pose = POSE.retract(rng.normal(0.0, size, 6))
            state = pose.rotation().matrix(), pose.translation(), rng.normal(0.0, 1.0, 2)
            (vertices, says), (others, other_says) = hidden.match(*state), plain(hidden).match(*state)
            assert (vertices == others).all()
            assert (says == other_says).all()
            both = (rows.distances(vertices, *state, want=True) for rows in (hidden, plain(hidden)))
            for one, other in zip(*both, strict=True):
                assert one == pytest.approx(other, rel=1e-9, abs=1e-9)


@compiled
@pytest.mark.parametrize("form", [*Form])
@pytest.mark.parametrize("looked", [True, False])
def test_the_compiled_rows_of_a_graph_are_those_of_the_callback(
    hidden: SilhouetteRows, form: Form, looked: bool
) -> None:
    callback, numpy = (SilhouetteFactor(rows, X(0, 0), L(0), 0.5) for rows in (hidden, plain(hidden)))
    values = at(CHANGE)
    factor = callback.factor()
    assert callback.judges
    assert not numpy.judges
    for one in (callback, numpy):
        one.tell(form, 4.0)
        if looked:
            one.look(at(CHANGE / 2.0))
            one.look(values, hold=True)
    pose = values.atPose3(X(0, 0)).matrix()
    state = [np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]]), values.atVector(L(0))]
    residual, jacobian = np.empty(64), np.zeros((64, 8))
    energy = factor.compiled.source.evaluate(state, residual, jacobian)
    expected, by = numpy(values, want_jacobian=True)
    assert residual == pytest.approx(expected, abs=1e-9)
    if form is not Form.LOSS:  # which has no derivatives
        assert jacobian == pytest.approx(by, rel=1e-8, abs=1e-8)
    if form is not Form.WEIGHTED:
        assert energy == pytest.approx(numpy.error(values))
    assert callback(values, want_jacobian=False)[0] == pytest.approx(numpy(values, want_jacobian=False)[0], abs=1e-9)
    assert callback.weights == pytest.approx(numpy.weights, abs=1e-12)
    assert callback.energy(values) == pytest.approx(numpy.energy(values))
