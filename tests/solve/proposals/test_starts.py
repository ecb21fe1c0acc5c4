"""Where the search starts: boxes filled, grounds stood on, guesses taken."""

import numpy as np
import pytest

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import MIN_DEPTH, Camera, Ground
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.starts import at_azimuths, from_box3d, view_box
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.vehicle.model import prepare
from tests.cars import CAMERA, MATRIX, observe, project, yaw_pose


@pytest.fixture(scope="module")
def model():
    return prepare(load_prior("car14"))


def outline_box(model, pose):
    pixels = project(model.outline.mean, pose)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


@pytest.mark.parametrize("depth", [8.0, 20.0, 60.0])
@pytest.mark.parametrize("lateral", [-0.5, 0.0, 0.6])
def test_starts_fill_the_box(model, depth, lateral):
    """The right azimuth among the starts lies close to the truth: 10 % of the depth."""
    for yaw in np.radians([-170, -80, 0, 35, 110]):
        truth = yaw_pose(yaw, (lateral * depth, 1.65, depth))
        box = outline_box(model, truth)
        start = at_azimuths(box, CAMERA, model, None, [yaw], relative=False)
        assert rotation_y(start.matrices()[0]) == pytest.approx(yaw)
        assert np.linalg.norm(start.translation[0] - truth[:3, 3]) < 0.1 * depth
        size = box[2:] - box[:2]
        np.testing.assert_allclose(outline_box(model, start.matrices()[0]), box, atol=0.25 * size.max())
        assert (start.coefficients == 0).all()


def test_relative_azimuths_turn_with_the_viewing_ray(model):
    """alpha = rotation_y - atan2(x, z): the same alpha shows the same side wherever the car is."""
    box = np.array([900.0, 150.0, 1000.0, 220.0])
    ray = CAMERA.rays((box[:2] + box[2:]) / 2)
    clock = np.arange(8) * np.pi / 4
    starts = at_azimuths(box, CAMERA, model, None, clock, relative=True)
    yaws = np.array([rotation_y(pose) for pose in starts.matrices()])
    turned = (yaws - np.arctan2(ray[0], ray[2]) - clock + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)


def test_starts_stand_upright_on_a_tilted_ground(model):
    ground = Ground(np.array([0.1, 1.0, -0.15]), 1.6)
    starts = at_azimuths(np.array([500.0, 150, 620, 240]), CAMERA, model, ground, np.arange(6.0), relative=True)
    np.testing.assert_allclose(starts.rotation[:, :, 1], np.tile(ground.normal, (6, 1)), atol=1e-12)
    np.testing.assert_allclose(
        starts.rotation @ starts.rotation.transpose(0, 2, 1), np.tile(np.eye(3), (6, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(starts.rotation), 1.0)


def test_a_box_that_fills_the_image_still_starts_in_front(model):
    tiny = Camera(MATRIX * [[0.05, 1, 1], [1, 0.05, 1], [1, 1, 1]])
    starts = at_azimuths(np.array([-5e3, -5e3, 9e3, 9e3]), tiny, model, None, np.arange(12.0), relative=True)
    for pose in starts.matrices():
        depths = (model.outline.mean @ pose[:3, :3].T + pose[:3, 3])[:, 2]
        assert depths.min() > MIN_DEPTH


def test_a_3d_box_gives_pose_and_size(model):
    box = Box3D(np.array([1.0, 1.7, 15.0]), 0.8, np.array([4.3, 1.75, 1.5]))
    start = from_box3d(box, model, None)
    np.testing.assert_allclose(start.matrices()[0], yaw_pose(0.8, (1.0, 1.7, 15.0)), atol=1e-12)
    size = model.prior.box_size(start.coefficients[0])
    np.testing.assert_allclose(size, box.size, atol=0.05)
    without = from_box3d(Box3D(box.location, 0.8), model, None)
    assert (without.coefficients == 0).all()
    upright = from_box3d(box, model, Ground(np.array([0.0, 1.0, -0.1]), 1.6))
    np.testing.assert_allclose(upright.rotation[0, :, 1] * np.hypot(1, 0.1), [0, 1, -0.1])


def test_without_vectors_a_3d_box_gives_its_pose():
    start = from_box3d(Box3D(np.array([0.0, 1.7, 9.0]), 0.1, np.ones(3)), prepare(load_prior("car14"), None, 0), None)
    assert start.coefficients.shape == (1, 0)


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("box3d.location", (np.ones(2), 0.0)),
        ("box3d.location", (np.array([0.0, 1.0, -3.0]), 0.0)),
        ("box3d.location[1]", (np.array([0.0, np.nan, 3.0]), 0.0)),
        ("box3d.rotation_y", (np.array([0.0, 1.0, 5.0]), np.inf)),
        ("box3d.size", (np.array([0.0, 1.0, 5.0]), 0.0, np.array([4.0, 0.0, 1.5]))),
    ],
)
def test_unusable_3d_boxes_are_named(field, arguments):
    with pytest.raises(InvalidInputError) as caught:
        Box3D(*arguments)
    assert caught.value.field == field


def test_known_poses_are_copied():
    poses = np.array([yaw_pose(0.1), yaw_pose(0.2)])
    starts = Hypotheses.at_poses(poses, 3)
    np.testing.assert_array_equal(starts.matrices(), poses)
    starts.rotation[:] = 0
    assert poses[0, 0, 0] != 0
    assert Hypotheses.at_poses(np.zeros((0, 4, 4)), 3).coefficients.shape == (0, 3)


def test_the_view_box(model):
    observation = observe(model.prior, yaw_pose(0.5))
    np.testing.assert_array_equal(view_box(observation), observation.box)
    # Without a box: around the points that the detector believes in, a tenth wider.
    points = np.array([[10.0, 20.0], [110.0, 40.0], [60.0, 70.0], [900.0, 900.0]])
    unsure = Observation(points, [0.9, 0.8, 0.7, 0.1])
    np.testing.assert_allclose(view_box(unsure), [0, 10, 120, 80])
    few = Observation(points, [0.9, 0.8, 0.1, 0.1])  # two believed points are too few: all of them
    np.testing.assert_allclose(view_box(few), [10 - 89, 20 - 89, 900 + 89, 900 + 89])
    with pytest.raises(DegenerateProblemError) as caught:
        view_box(Observation(np.full((4, 2), 3.0), np.ones(4)))
    assert caught.value.field == "keypoints"
