"""Geometry behind the drawings: projections, crops, ellipsoids, boxes, normals, the ground, the truth."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.viz import Truth
from fgrecon.viz.geometry import (
    BOX_EDGES,
    crop_around,
    ellipsoids,
    ground_grid,
    image_points,
    outline_corners,
    resolution,
    vertex_normals,
)

CAMERA = Camera(np.array([[700.0, 0, 600], [0, 710, 180], [0, 0, 1]]))
POSE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.7, 0.05), np.array([1.0, 1.5, 12.0])).matrix()
numbers = st.floats(-50, 50)


def test_image_points_are_the_cameras_projections() -> None:
    points = np.random.default_rng(0).uniform(-2, 2, size=(20, 3))
    expected = CAMERA.project(transform(POSE, points))
    assert np.allclose(image_points(CAMERA, POSE, points), expected)
    bent = Camera(CAMERA.matrix, np.array([-0.3, 0.1, 0.001, 0.002]))
    assert np.allclose(image_points(bent, POSE, points), bent.distort(expected))
    assert not np.allclose(image_points(bent, POSE, points), expected, atol=0.1)


def test_points_behind_the_camera_have_no_pixel() -> None:
    points = np.array([(0.0, 0, 5), (0, 0, -5), (np.nan, 0, 5), (5e3, 0, 0.2)])
    pixels = image_points(CAMERA, np.eye(4), points)
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, False, False]


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    arrays(np.float64, (5, 2), elements=st.floats(0, 1000)),
    arrays(np.float64, (3, 2), elements=st.floats(-1e5, 1e5)),
    st.floats(0.5, 3.0),
)
def test_a_crop_holds_what_was_observed_at_its_aspect(
    keypoints: np.ndarray, projections: np.ndarray, aspect: float
) -> None:
    observation = Observation(keypoints, np.ones(5))
    x1, y1, x2, y2 = crop_around(observation, projections, aspect=aspect)
    assert (keypoints > (x1, y1)).all()
    assert (keypoints < (x2, y2)).all()
    assert (x2 - x1) / (y2 - y1) == pytest.approx(aspect)
    # Far projections cannot blow it up.
    assert max(x2 - x1, y2 - y1) < 10 * max(np.ptp(keypoints, axis=0).max(), 8.0) * max(aspect, 1 / aspect)


def test_a_crop_without_keypoints_takes_box_or_projections() -> None:
    nothing = np.full((4, 2), np.nan)
    boxed = Observation(nothing, np.zeros(4), box=np.array([10.0, 20, 110, 70]))
    x1, y1, x2, y2 = crop_around(boxed, nothing, aspect=2.0)
    assert (x1 + x2) / 2 == pytest.approx(60)
    assert (y1 + y2) / 2 == pytest.approx(45)
    x1, y1, x2, y2 = crop_around(Observation(nothing, np.zeros(4)), np.array([[5.0, 5], [105, 55]]), aspect=2.0)
    assert x1 < 5 < 105 < x2
    assert np.isfinite(crop_around(Observation(nothing, np.zeros(4)), nothing, aspect=2.0)).all()


@settings(deadline=None, max_examples=50, derandomize=True)
@given(arrays(np.float64, (4, 3, 3), elements=st.floats(-1, 1)))
def test_ellipsoids_are_the_covariances(roots: np.ndarray) -> None:
    covariances = roots @ np.swapaxes(roots, 1, 2)
    axes, rotations = ellipsoids(covariances)
    rebuilt = rotations @ (axes[:, :, None] ** 2 * np.swapaxes(rotations, 1, 2))
    assert np.allclose(rebuilt, covariances, atol=1e-9)
    assert np.allclose(np.linalg.det(rotations), 1.0)


def test_box_stands_on_its_origin() -> None:
    corners = outline_corners(np.array([4.0, 1.8, 1.5]))
    assert corners.min(axis=0).tolist() == [-2.0, -1.5, -0.9]  # y points down
    assert corners.max(axis=0).tolist() == [2.0, 0.0, 0.9]
    around = [[2.0, 0.9], [2.0, -0.9], [-2.0, -0.9], [-2.0, 0.9]]  # front left, front right, rear right, rear left
    assert corners[:, [0, 2]].tolist() == 2 * around
    lengths = np.linalg.norm(corners[BOX_EDGES[:, 0]] - corners[BOX_EDGES[:, 1]], axis=1)
    assert sorted(lengths.round(9)) == [1.5] * 4 + [1.8] * 4 + [4.0] * 4
    assert (corners[np.unique(BOX_EDGES[:4])][:, 1] == 0).all()


def test_normals_point_out_of_a_closed_mesh() -> None:
    vertices = np.array([(1.0, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (9, 9, 9)])
    faces = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])
    normals = vertex_normals(vertices, faces)
    assert np.allclose(normals[:6], vertices[:6])
    assert (normals[6] == 0).all()  # no face meets there


def test_ground_grid_lies_in_the_ground() -> None:
    normal = np.array([0.02, 1.0, -0.05]) / np.linalg.norm([0.02, 1.0, -0.05])
    grid = ground_grid(POSE, Ground(normal, 1.6))
    assert np.allclose(grid @ normal, 1.6)
    below = ground_grid(POSE, None)
    assert np.allclose((below - POSE[:3, 3]) @ POSE[:3, 1], 0.0)
    assert np.allclose(below.reshape(-1, 3).mean(axis=0), POSE[:3, 3])


def test_resolution_prefers_the_image() -> None:
    sized = Camera(CAMERA.matrix, image_size=(1242, 375))
    assert resolution(sized, np.zeros((30, 40, 3), np.uint8)) == (40.0, 30.0)
    assert resolution(sized, None) == (1242.0, 375.0)
    assert resolution(CAMERA, None) == (1200.0, 360.0)


@settings(deadline=None, max_examples=50, derandomize=True)
@given(st.floats(-20, 20), arrays(np.float64, (3,), elements=numbers))
def test_errors_are_those_that_were_made(turn: float, shift: np.ndarray) -> None:
    shape = np.random.default_rng(1).uniform(-1, 1, size=(6, 3))
    truth = Truth(POSE, keypoints=shape)
    moved = POSE.copy()
    moved[:3, :3] = gtsam.Rot3.Ry(turn).matrix() @ gtsam.Rot3.Ry(0.3).matrix()
    level = Truth(np.block([[gtsam.Rot3.Ry(0.3).matrix(), POSE[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    moved[:3, 3] += shift
    errors = level.errors(moved, shape)
    wrapped = abs((np.degrees(turn) + 180) % 360 - 180)
    assert errors["orientation_deg"] == pytest.approx(wrapped, abs=1e-6)
    assert errors["translation_m"] == pytest.approx(np.linalg.norm(shift), abs=1e-9)
    assert "keypoints_m" not in errors
    assert truth.errors(POSE, shape + np.array([0.3, 0.0, 0.4]))["keypoints_m"] == pytest.approx(0.5)


def test_unknown_true_keypoints_do_not_count() -> None:
    shape = np.zeros((4, 3))
    shape[2] = np.nan
    errors = Truth(POSE, keypoints=shape).errors(POSE, np.ones((4, 3)) * (0.0, 0.2, 0.0))
    assert errors["keypoints_m"] == pytest.approx(0.2)
    assert "keypoints_m" not in Truth(POSE, keypoints=np.full((4, 3), np.nan)).errors(POSE, np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("camera_T_object", {"camera_T_object": np.eye(3)}),
        ("camera_T_object", {"camera_T_object": np.diag([1.0, 1, -1, 1])}),
        ("camera_T_object", {"camera_T_object": np.diag([2.0, 2, 2, 1])}),
        ("box_size", {"camera_T_object": np.eye(4), "box_size": np.array([4.0, 0.0, 1.5])}),
        ("keypoints", {"camera_T_object": np.eye(4), "keypoints": np.zeros((4, 2))}),
    ],
)
def test_a_truth_that_cannot_be_is_refused(field: str, arguments: dict) -> None:
    with pytest.raises(InvalidInputError, match=f"truth.{field}"):
        Truth(**arguments)
