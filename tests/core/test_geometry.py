"""Small geometry that several parts share."""

import numpy as np
import pytest

from fgrecon.core.geometry import box_around, exponential, transform, turn_between
from tests.cars import yaw_pose


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, np.pi])
def test_the_angle_between_rotations_and_between_poses(angle):
    first = yaw_pose(0.4, np.array([1.0, 2.0, 3.0]))
    second = first.copy()
    second[:3, :3] = first[:3, :3] @ exponential(np.array([angle * 0.6, 0.0, angle * 0.8]))
    second[:3, 3] = 9.0
    assert turn_between(first, second) == pytest.approx(angle, abs=1e-7)
    assert turn_between(first[:3, :3], second[:3, :3]) == pytest.approx(angle, abs=1e-7)


def test_the_box_around_points():
    points = np.array([[3.0, -1.0], [0.5, 7.0], [2.0, 2.0]])
    assert box_around(points).tolist() == [0.5, -1.0, 3.0, 7.0]
    assert box_around(points[:1]).tolist() == [3.0, -1.0, 3.0, -1.0]


def test_points_are_moved_by_a_pose():
    pose = yaw_pose(0.5 * np.pi, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(transform(pose, np.array([[2.0, 0.0, 0.0]])), [[1.0, 2.0, 1.0]], atol=1e-12)
