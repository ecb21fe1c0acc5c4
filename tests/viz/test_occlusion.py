"""What hides what: depth images of vehicles, and lines cut where something is before them."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.viz.occlusion import depth_image, pieces_of, runs_of
from tests.results import changed

CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]]), image_size=(640, 480))
SIZE = (640.0, 480.0)


def wall(example, depth, half=1.0):
    """A square that faces the camera."""
    corners = np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])
    pose = np.eye(4)
    pose[2, 3] = depth
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return changed(example.reconstruction, camera_T_object=pose, surface_vertices=corners, surface_faces=faces)


def test_the_nearest_counts(example):
    for order in (1, -1):
        both = [wall(example, 5.0, 0.5), wall(example, 10.0)][::order]
        depth = depth_image(both, CAMERA, SIZE)
        assert depth.depth[240, 320] == pytest.approx(5.0)
        assert depth.depth[240, 320 + 45] == pytest.approx(5.0)
        assert np.isinf(depth.depth[240, 500])


def test_a_line_behind_a_wall_is_cut_at_its_border(example):
    depth = depth_image([wall(example, 5.0)], CAMERA, SIZE)  # from 220 to 420 in the image
    line = np.array([[(-6.0, 0, 10.0), (6.0, 0, 10.0)]])
    seen, hidden = runs_of(pieces_of(line, 100), CAMERA, depth)
    assert len(hidden) == 1
    assert hidden[0][[0, -1], 0] == pytest.approx([220, 420], abs=7)
    assert np.concatenate([part[[0, -1], 0] for part in seen]) == pytest.approx([20, 220, 420, 620], abs=7)
    seen, hidden = runs_of(pieces_of(line - (0, 0, 6.0)), CAMERA, depth)  # before it
    assert (len(seen), len(hidden)) == (1, 0)


def test_a_surface_does_not_hide_the_lines_on_it(example):
    depth = depth_image([wall(example, 5.0)], CAMERA, SIZE)
    on_it = np.array([[(-0.9, 0.2, 5.1), (0.9, 0.2, 5.1)]])
    assert not runs_of(pieces_of(on_it), CAMERA, depth)[1]


def test_short_gaps_are_none(example):
    depth = depth_image([wall(example, 5.0, 0.1)], CAMERA, SIZE)  # a post of 20 pixels
    line = np.array([[(-3.0, 0, 10.0), (3.0, 0, 10.0)]])
    seen, hidden = runs_of(pieces_of(line), CAMERA, depth)
    assert (len(seen), len(hidden)) == (1, 0)


def test_what_lies_behind_the_camera_is_in_neither(example):
    depth = depth_image([], CAMERA, SIZE)
    line = np.array([[(0.0, 1.0, -5.0), (0.0, 1.0, 5.0)]])
    seen, hidden = runs_of(pieces_of(line), CAMERA, depth)
    assert not hidden
    assert len(seen) == 1
    assert len(seen[0]) < 10


def test_wireframes_hide_where_there_is_no_surface(example):
    result = changed(example.reconstruction, surface_vertices=None, surface_faces=None)
    depth = depth_image([result], example.camera, (1242.0, 375.0))
    covered = np.isfinite(depth.depth)
    x1, y1, x2, y2 = example.observation.box.astype(int)
    assert 0.1 * (x2 - x1) * (y2 - y1) < covered.sum()
    nearest, farthest = (float(np.asarray(f(depth.depth[covered]))) for f in (np.min, np.max))
    assert result.location[2] - 3 < nearest < farthest < result.location[2] + 3
