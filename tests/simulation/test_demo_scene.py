"""The demo's scene: the same bits for the same seed, truth that fits the picture, and a wheel behind the planter."""

from __future__ import annotations

import numpy as np
import pytest

from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.sample import demo_scene

PRIOR = load_prior("car14")


@pytest.fixture(scope="module")
def scene():
    return demo_scene(PRIOR, seed=1)


def test_the_same_seed_gives_the_same_bits(scene):
    again = demo_scene(PRIOR, seed=1)
    np.testing.assert_array_equal(scene.picture.image, again.picture.image)
    np.testing.assert_array_equal(scene.observation.keypoints, again.observation.keypoints)
    assert not np.array_equal(scene.truth.camera_T_object, demo_scene(PRIOR, seed=2).truth.camera_T_object)


def test_the_picture_shows_the_truth(scene):
    truth, picture = scene.truth, scene.picture
    assert picture.image.shape == (540, 960, 3)
    rows, columns = np.nonzero(picture.body == 0)
    assert columns.min() == pytest.approx(truth.box[0], abs=1.5)
    assert columns.max() == pytest.approx(truth.box[2], abs=1.5)
    assert rows.min() == pytest.approx(truth.box[1], abs=1.5)
    height = truth.camera_T_object[1, 3]
    assert height == pytest.approx(scene.ground.distance)
    # what is visible is seen at its own depth, up to how far keypoints lie off the surface
    camera_keypoints = truth.vehicle.keypoints @ truth.camera_T_object[:3, :3].T + truth.camera_T_object[:3, 3]
    for k in np.flatnonzero(truth.visible):
        column, row = np.round(truth.projections[k]).astype(int)
        around = picture.body[row - 4 : row + 5, column - 4 : column + 5]
        assert (around == 0).any()
        depth = picture.depth[row - 4 : row + 5, column - 4 : column + 5]
        assert np.abs(depth[np.isfinite(depth)] - camera_keypoints[k, 2]).min() < 0.15


def test_the_planter_hides_the_nearest_wheel(scene):
    truth = scene.truth
    wheels = list(PRIOR.category.ground_keypoints)
    depth = (truth.vehicle.keypoints @ truth.camera_T_object[:3, :3].T + truth.camera_T_object[:3, 3])[wheels, 2]
    nearest = wheels[int(depth.argmin())]
    assert not truth.visible[nearest]
    column, row = np.round(truth.projections[nearest]).astype(int)
    assert scene.picture.body[row, column] == 1
    assert truth.visible.sum() >= 4
