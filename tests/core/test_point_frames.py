"""Points in another frame or unit than the camera's metres are refused, and the reason is the mistake that was made."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.point_frames import check_points, in_image

CAMERA = Camera(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), image_size=(1200, 360))
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
