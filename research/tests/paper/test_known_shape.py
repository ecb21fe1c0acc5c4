"""Marked cars of known shape: conventions of the file against a projection by hand, and errors by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon_research.paper.apollocar3d import marking_offsets, read_apollocar3d
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_ROWS, _score_car, car_errors, score_known_shapes
from fgrecon_research.training.priors.apollo79 import Apollo79, load_apollo79

K = np.array([[2304.5, 0.0, 1686.2], [0.0, 2305.9, 1355.0], [0.0, 0.0, 1.0]])
POINTS = {0: [7], 1: [50], 2: [20], 3: [37], 4: [0, 1, 2, 3], 6: [22, 23, 25, 26], 10: [8], 12: [24]}
HEIGHT = 0.85


@pytest.fixture(scope="module")
def models(scene):
    """Two made-up models; the second is stored at 0.9 of the size that poses were labelled with."""
    prior = scene.prior
    keypoints = np.array([prior.keypoints(row) for row in (np.zeros(5), [1.0, 0.5, 0, 0, 0])])
    vertices = np.zeros((2, 3, 3))
    size = np.array([prior.box_size(np.zeros(5)), [4.8, 1.9, 1.7]])
    return Apollo79(
        ("a", "b"), keypoints, keypoints, vertices, vertices, np.zeros((1, 3), np.int32), size, np.array([1.0, 0.9])
    )


def annotations(models, cad, pose, marked, shift=0.0):
    """The file's content for one car whose marks lie exactly on its keypoints (moved by some pixels)."""
    shape = models.keypoints[cad] / models.scale[cad]
    rotation = Rotation.from_euler("xyz", pose[:3]).as_matrix()  # Rz Ry Rx
    left_up_forward = np.stack([shape[:, 2], -(shape[:, 1] + HEIGHT), shape[:, 0]], axis=1)
    camera = left_up_forward @ rotation.T + pose[3:]
    pixels = (camera / camera[:, 2:]) @ K.T[:, :2] + shift
    marks = np.zeros((66, 3))
    for keypoint in marked:
        for n, point in enumerate(POINTS[keypoint]):
            spread = [[-6, -4], [6, -4], [6, 4], [-6, 4]][n] if len(POINTS[keypoint]) > 1 else [0, 0]
            marks[point] = [*(pixels[keypoint] + spread), 2]
    low, high = pixels.min(0), pixels.max(0)
    car = {"cad_id": cad, "pose": list(pose), "box": [*low, *(high - low)], "keypoints66": marks.tolist()}
    return {"camera_intrinsic": K.tolist(), "images": [{"image_id": 5, "cars": [car]}]}


POSE = (0.15, -2.6, -3.05, 2.0, 1.1, 14.0)


def read(tmp_path, models, content):
    path = tmp_path / "annotations.json"
    path.write_text(json.dumps(content))
    return read_apollocar3d(path, models)


@pytest.mark.parametrize("cad", [0, 1])
def test_conventions_of_pose_height_size_and_lamps(tmp_path, models, cad):
    found = read(tmp_path, models, annotations(models, cad, POSE, POINTS))
    (car,) = found.cars
    assert (car.name, car.model, car.marks) == ("5:0", "ab"[cad], 8)
    assert car.inconsistency < 1e-3
    assert car.size == pytest.approx(models.size[cad] / models.scale[cad])
    np.testing.assert_allclose(found.camera.project(car.in_camera)[list(POINTS)], car.keypoints[list(POINTS)], atol=0.6)
    # The origin is on the ground: below the labelled one, along the car's own vertical.
    assert np.linalg.norm(car.camera_T_object[:3, 3] - POSE[3:]) == pytest.approx(HEIGHT, abs=1e-6)
    assert np.linalg.det(car.camera_T_object[:3, :3]) == pytest.approx(1.0)


def test_cars_that_cannot_be_scored_are_counted(tmp_path, models):
    few = annotations(models, 0, POSE, [0, 1, 2, 4])
    found = read(tmp_path, models, few)
    assert (found.total, found.too_few, found.inconsistent, len(found.cars)) == (1, 1, (), 0)
    partial = annotations(models, 0, POSE, [0, 1, 2, 3, 4])
    partial["images"][0]["cars"][0]["keypoints66"][3][2] = 0  # one of the lamp's four points
    assert read(tmp_path, models, partial).too_few == 1
    moved = read(tmp_path, models, annotations(models, 0, POSE, POINTS, shift=80.0))
    assert moved.inconsistent == ("5:0",)
    unknown = annotations(models, 0, POSE, POINTS)
    unknown["images"][0]["cars"][0]["cad_id"] = 2
    with pytest.raises(InvalidInputError, match="cad_id"):
        read(tmp_path, models, unknown)


def test_errors_by_hand(tmp_path, models):
    (car,) = read(tmp_path, models, annotations(models, 0, POSE, POINTS)).cars
    assert car_errors(car, car.camera_T_object, car.shape) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    moved = car.camera_T_object.copy()
    moved[:3, 3] *= 1.1
    centroid = car.in_camera.mean(axis=0)
    expected = 0.1 * np.linalg.norm(car.camera_T_object[:3, 3]) / np.linalg.norm(centroid)
    assert car_errors(car, moved, car.shape) == pytest.approx((0.0, expected, 0.0), abs=1e-9)
    turned = car.camera_T_object.copy()
    turned[:3, :3] = turned[:3, :3] @ Rotation.from_euler("y", 10, degrees=True).as_matrix()
    rotation, _, keypoint = car_errors(car, turned, car.shape)
    arms = (car.shape - car.shape.mean(0))[:, [0, 2]]
    assert rotation == pytest.approx(10.0)
    assert keypoint == pytest.approx(2 * np.sin(np.radians(5)) * np.linalg.norm(arms, axis=1).mean())
    larger = car_errors(car, car.camera_T_object, 1.05 * car.shape)
    assert larger[2] == pytest.approx(0.05 * np.linalg.norm(car.shape - car.shape.mean(0), axis=1).mean())


def test_exact_marks_of_the_mean_car_give_its_pose(tmp_path, models, scene):
    (car,) = read(tmp_path, models, annotations(models, 0, POSE, POINTS)).cars
    scores, failures = _score_car(car, Camera(K), 4 * [(scene.prior, np.zeros((14, 3)))])
    assert failures == []
    assert scores.shape == (len(KNOWN_SHAPE_ROWS), 3)
    assert scores[:, 0].max() < 1.0
    assert scores[:, 1].max() < 0.02


def test_where_people_put_their_marks_is_found_and_taken_off(tmp_path, models, scene):
    (car,) = read(tmp_path, models, annotations(models, 0, POSE, POINTS)).cars
    camera, category = Camera(K), scene.prior.category
    true = np.zeros((14, 3))
    true[[10, 11]] = [[0.05, -0.02, -0.04], [0.05, -0.02, 0.04]]
    cars = []
    for turn in np.linspace(0, 6, 40):
        pose = car.camera_T_object.copy()
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("y", turn).as_matrix()
        points = (car.shape + true) @ pose[:3, :3].T + pose[:3, 3]
        cars.append(replace(car, camera_T_object=pose, keypoints=camera.project(points)))
    found = marking_offsets(cars, camera, category)
    assert found == pytest.approx(true, abs=2e-3)
    assert marking_offsets(cars[:5], camera, category) == pytest.approx(np.zeros((14, 3)))
    variants = [(scene.prior, np.zeros((14, 3))), (scene.prior, true)]
    scores = np.array([_score_car(one, camera, variants)[0] for one in cars[3::8]])
    wrong, right = np.split(scores, 2, axis=1)  # what is between start and end may stop short of a minimum
    assert (np.median(right[..., 0], axis=0) < 0.5 * np.median(wrong[..., 0], axis=0)).all()
    assert right[:, -1, 0].max() < 0.5 * wrong[:, -1, 0].min()
    assert right[:, -1, 2].max() < 0.005


def test_a_crash_is_wrong_and_named(tmp_path, models):
    (car,) = read(tmp_path, models, annotations(models, 0, POSE, POINTS)).cars
    scores, failures = _score_car(car, Camera(K), 4 * [(None, None)])
    assert scores[:, 0].tolist() == [180.0] * len(KNOWN_SHAPE_ROWS)
    assert len(failures) == 8
    assert all(reason.startswith("5:0 ") for reason in failures)


@pytest.mark.data
def test_the_real_annotations_and_a_few_held_out_cars(data):
    models = load_apollo79(data)
    cars = read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)
    assert cars.total == 1489
    assert len(cars.cars) + cars.too_few + len(cars.inconsistent) == cars.total
    assert len(cars.cars) > 400
    assert cars.noise < 0.02
    rare = [car for car in cars.cars if car.model == "dazhong-SUV"]
    scores = score_known_shapes(type(cars)(cars.camera, tuple(rare), len(rare), 0, (), 0.0), models)
    assert scores.rotation.shape == (len(rare), len(KNOWN_SHAPE_ROWS))
    assert np.median(scores.rotation) < 6.0
    assert np.median(scores.keypoint) < 0.16
    # A large car: knowing its size settles the distance.
    assert np.median(scores.translation[:, 8:]) < np.median(scores.translation[:, :8])
