"""The ground by measured points: what takes its place, and where nothing does."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthCalibration, DepthMap
from fgrecon.core.evidence import Points
from fgrecon.solve.road_plane import ground_by_points
from fgrecon.solve.solve_settings import ROAD

CAMERA = Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), image_size=(1242, 375))
NORMAL = np.array([0.03, 1.0, -0.02]) / np.linalg.norm([0.03, 1.0, -0.02])
HEIGHT = 1.72


def scan(seed=0, count=6000):
    """(N, 3) points of a tilted road, of a hedge beside it and of boxes on it, with some far below."""
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-8.0, 8.0, count), rng.uniform(4.0, 45.0, count)
    y = (HEIGHT - NORMAL[0] * x - NORMAL[2] * z) / NORMAL[1] + rng.normal(0.0, 0.02, count)
    hedge = x > 6.0
    y[hedge] -= rng.uniform(0.2, 1.5, hedge.sum())
    box = (np.abs(x) < 1.0) & (z > 15.0) & (z < 19.0)
    y[box] -= 1.5
    y[rng.choice(count, 30, replace=False)] += 1.0
    return np.stack([x, y, z], axis=1)


def on_plane(depth):
    """A point of the road straight ahead."""
    return np.array([0.0, (HEIGHT - NORMAL[2] * depth) / NORMAL[1], depth])


@pytest.mark.parametrize("given", [None, Ground.level(1.65), Ground.of_height(1.65)])
def test_points_say_where_the_ground_is(given):
    found = ground_by_points([Points(scan())], given, CAMERA, ())
    assert found is not given
    assert abs(found.distance - HEIGHT) < 0.04
    assert np.degrees(np.arccos(found.normal @ NORMAL)) < 0.3
    for depth in (8.0, 20.0, 35.0):
        off = found.normal @ on_plane(depth) - found.distance
        assert abs(off) < 2.0 * found.height_sigma_at_depth(depth)
    assert found.height_sigma >= ROAD.height_sigma


def test_a_depth_map_in_metres_does_so_too():
    rows, columns = np.mgrid[:375, :1242]
    rays = CAMERA.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    down = rays @ NORMAL
    metres = np.where(down > HEIGHT / 60.0, HEIGHT / np.maximum(down, 1e-6), 60.0).reshape(375, 1242)
    for depth in (DepthMap(metres), DepthMap(1.0 / metres, inverse=True)):
        found = ground_by_points([depth], None, CAMERA, ())
        assert found.distance == pytest.approx(HEIGHT, abs=0.03)
        assert np.degrees(np.arccos(found.normal @ NORMAL)) < 0.3
    few = np.where(np.random.default_rng(0).random(metres.shape) < 0.003, metres, np.nan)  # a scan's, say
    assert ground_by_points([DepthMap(few)], None, CAMERA, ()).distance == pytest.approx(HEIGHT, abs=0.03)
    assert ground_by_points([DepthMap(metres, scale=DepthScale.SCALE)], None, CAMERA, ()) is None
    calibrated = DepthMap(metres / 2.0, calibration=DepthCalibration(2.0, 0.0))
    assert ground_by_points([calibrated], None, CAMERA, ()) is None


def test_what_is_given_stays_where_points_do_not_show_more():
    given, points = Ground.level(1.65), Points(scan())
    surer = Ground(NORMAL, HEIGHT, height_sigma=0.02, slope_sigma=0.002)
    wall = scan()[:, [0, 2, 1]] * [1.0, 0.1, 1.0] + [0.0, -1.0, 10.0]
    assert ground_by_points([points], surer, CAMERA, ()) is surer
    assert ground_by_points([points], given, CAMERA, {"points"}) is given
    assert ground_by_points([Points(scan()[:30])], given, CAMERA, ()) is given
    assert ground_by_points([Points(wall)], None, CAMERA, ()) is None
    assert ground_by_points([points], Ground.level(3.5), CAMERA, ()).distance == 3.5, "no road is that far off"
    assert ground_by_points([], None, CAMERA, ()) is None


def test_a_wall_is_no_ground():
    wall = DepthMap(np.full((375, 1242), 12.6))
    assert ground_by_points([wall], None, CAMERA, ()) is None


def test_the_plane_of_a_scan_is_that_of_the_ground_that_is_given():
    """Though it is made once for all vehicles."""
    points, level, other = Points(scan()), Ground.level(1.65), Ground.of_height(1.5)
    every = level, None, other, level
    each = [ground_by_points([points], given, CAMERA, ()) for given in every]
    anew = [ground_by_points([Points(scan())], given, CAMERA, ()) for given in every]
    assert [repr(one) for one in each] == [repr(one) for one in anew]
    assert each[0] is not each[2]
