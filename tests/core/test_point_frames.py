"""Points in another frame or unit than the camera's metres are refused, and the reason is the mistake that was made."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.point_frames import check_points, in_image

CAMERA = Camera(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), image_size=(1200, 360))
BOXES = [np.array([700.0, 170.0, 800.0, 245.0]), np.array([330.0, 175.0, 400.0, 227.5])]  # 14 and 20 m away, 1.5 m high
LIDAR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def _scan(count: int = 4000) -> np.ndarray:
    """Points all around, between a road 1.65 m below and what stands on it."""
    rng = np.random.default_rng(0)
    way, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(3.0, 60.0, count)
    return np.stack([distance * np.sin(way), rng.uniform(-2.0, 1.65, count), distance * np.cos(way)], axis=1)


def test_a_scan_all_around_is_taken_though_most_of_it_is_outside_the_image() -> None:
    check_points(_scan(), CAMERA)
    assert 0.1 < in_image(_scan(), CAMERA).mean() < 0.4


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (_scan() @ LIDAR, "LiDAR's frame"),
        (_scan() * [1, -1, -1] + [0, 0, -70.0], "all of these lie behind|y up"),
        (1000.0 * _scan(), "millimetres"),
        (100.0 * _scan(), "centimetres"),
        (_scan() / 1000.0, "in metres: all of these are within 1 m"),
        (np.array([[0.0, 0.0, -5.0], [1.0, 0.5, -6.0]]), "OpenGL"),
        (np.array([[90.0, 90.0, 5.0]]), "another place"),
    ],
)
def test_the_likely_mistake_is_reported(points: np.ndarray, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_points(points, CAMERA)


def _street() -> np.ndarray:
    """A road 1.65 m below, a wall at 80 m, and the two cars of `BOXES`, behind which nothing is seen."""
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0.0, 100.0], [1200.0, 360.0], (20_000, 2))
    rays = CAMERA.rays(pixels)
    depth = np.minimum(1.65 / np.maximum(rays[:, 1], 1e-6), 80.0)
    for box, metres in zip(BOXES, (14.0, 20.0), strict=True):
        depth[np.all((pixels > box[:2]) & (pixels < box[2:]), axis=1)] = metres
    return np.asarray(rays * depth[:, None])


@pytest.mark.parametrize("boxes", [BOXES, BOXES[:1]])
@pytest.mark.parametrize("ground", [Ground.level(1.65), None])
def test_right_points_are_taken_with_vehicles_and_ground(boxes: list[np.ndarray], ground: Ground | None) -> None:
    check_points(_street(), CAMERA, "points", ground, boxes)
    hidden = _street()[:, 2] < 13.0  # both cars are hidden, or too far away
    check_points(_street()[hidden], CAMERA, "points", ground, boxes)


@pytest.mark.parametrize("seed", range(5))
def test_few_points_that_show_neither_ground_nor_vehicles_are_taken(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([0.0, 0.0], [1200.0, 160.0], (90, 2))  # a facade above the road and beside the cars
    points = CAMERA.rays(pixels) * rng.uniform(5.0, 40.0, (90, 1))
    check_points(points, CAMERA, "points", Ground.level(1.65), BOXES)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (_street() * [1, -1, 1], "Unity's frame .*x right, y up, z forward"),
        (_street() * [1, -1, -1], "OpenGL's frame"),
        (_street() @ LIDAR, "a LiDAR's frame"),
        (_street()[:, [2, 0, 1]] * [1, 1, -1], "CARLA's and Unreal's frame .*mirrored, x forward, y right, z up"),
        (_street() * [-1, 1, 1], "a frame with mirrored, x left, y down, z forward"),
        (_street() / 0.3048, "these look like feet"),
        (_street() @ LIDAR * 1000.0, "a LiDAR's frame .*in millimetres"),
        (_street()[:, [1, 0, 2]], "x down, y right, z forward"),
    ],
)
def test_vehicles_and_ground_tell_frame_and_unit(points: np.ndarray, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_points(points, CAMERA, "points", Ground.level(1.65), BOXES)
