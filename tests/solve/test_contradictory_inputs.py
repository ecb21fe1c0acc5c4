"""Inputs that contradict themselves: what cannot be of a vehicle is left out and named, the rest is warned of."""

import contextlib
import warnings
from dataclasses import replace

import numpy as np
import pytest

from fgrecon import Ground, reconstruct, reconstruct_scene
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform, yaw_rotation
from fgrecon.core.input_warnings import InputWarning, camera_warning_of, input_warning_of, summed_up
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.errors import ContradictoryInputWarning, DegenerateProblemError, InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.visibility import clearance, occluder, probability
from tests import cars

PRIOR = load_prior("car14")
NAMES = PRIOR.category.keypoints
MIRROR = np.array(PRIOR.category.mirror)
CAMERA = replace(Camera.of((720.0, 720.0, 610.0, 173.0)), image_size=(1242, 375))


def car(yaw=-1.1, location=(3.0, 1.6, 12.0), camera=CAMERA):
    """The visible keypoints of a car, and which these are."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = yaw_rotation(yaw), location
    surface = occluder(PRIOR)
    coefficients = np.zeros(PRIOR.dimension)
    centre = -pose[:3, :3].T @ pose[:3, 3]
    visible = probability(clearance(surface.vertices(coefficients), surface.faces, PRIOR.mean, centre)) > 0.5
    pixels = camera.distort(camera.project(transform(pose, PRIOR.mean)))
    return np.where(visible[:, None], pixels, np.nan), visible


def with_hidden(pixels, visible, at):
    hidden = int(np.flatnonzero(~visible)[0])
    keypoints, confidence = pixels.copy(), np.where(visible, 0.9, 0.0)
    keypoints[hidden], confidence[hidden] = at, 0.3
    return keypoints, confidence, NAMES[hidden]


@pytest.mark.parametrize("at", [(1900.0, 240.0), (9999.0, 9999.0), (-1000.0, -1000.0), (20000.0, 240.0)])
@pytest.mark.parametrize("size", [None, (1242, 375)])
def test_a_keypoint_far_away_adds_nothing(at, size):
    pixels, visible = car()
    camera = replace(CAMERA, image_size=size)
    alone = reconstruct(pixels, camera, confidence=np.where(visible, 0.9, 0.0))
    keypoints, confidence, name = with_hidden(pixels, visible, at)
    result = reconstruct(keypoints, camera, confidence=confidence)
    (line,) = result.diagnostics.left_out
    assert line.startswith(f"{name}: left out, ")
    np.testing.assert_array_equal(result.camera_T_object, alone.camera_T_object)
    np.testing.assert_array_equal(result.uncertainty.pose_covariance, alone.uncertainty.pose_covariance)
    assert not alone.diagnostics.left_out
    assert Reconstruction.from_dict(result.to_dict(compact=True)).diagnostics.left_out == (line,)


def test_confidence_zero_does_not_count_for_the_extent():
    pixels, visible = car()
    keypoints, _, _ = with_hidden(pixels, visible, (1100.0, 20.0))
    known = Observation.of(pixels, np.where(visible, 0.9, 0.0))
    assert Observation.of(keypoints, np.where(visible, 0.9, 0.0)).extent == known.extent


def test_a_box_beyond_the_lens_is_left_out():
    lens = replace(Camera.of((900.0, 900.0, 640.0, 400.0), [0.05, 0.0, 0.0, 0.0, -1.6]), image_size=(1280, 800))
    pixels, visible = car(-1.2, (1.5, 1.6, 9.0), lens)
    box = [*np.nanmin(pixels, axis=0), 1279.0, 799.0]
    confidence = np.where(visible, 0.9, 0.0)
    result = reconstruct(pixels, lens, confidence=confidence, box=box)
    assert result.diagnostics.left_out == ("2D box: left out, the lens distortion cannot be undone at its sides.",)
    alone = reconstruct(pixels, lens, confidence=confidence)
    np.testing.assert_array_equal(result.camera_T_object, alone.camera_T_object)


CAMERAS = {
    "cx and cy exchanged": ((720.0, 720.0, 173.0, 610.0), InputWarning.PRINCIPAL_POINT),
    "ten times": ((7200.0, 7200.0, 6100.0, 1730.0), InputWarning.PRINCIPAL_POINT),
    "fx, cx, fy, cy": ((720.0, 610.0, 720.0, 173.0), InputWarning.SQUARE),
    "halved": ((360.0, 360.0, 305.0, 86.5), InputWarning.OTHER_SIZE),
    "focal length alone ten times": ((7200.0, 7200.0, 610.0, 173.0), InputWarning.FIELD_OF_VIEW),
    "fx, cx, fy, cy alike": ((660.0, 610.0, 660.0, 173.0), InputWarning.SQUARE),
    "fx and cx alike by chance": ((610.0, 612.0, 610.0, 173.0), None),
    "focal length a hundredth": ((72.0, 72.0, 610.0, 173.0), InputWarning.FIELD_OF_VIEW),
    "right": ((720.0, 720.0, 610.0, 173.0), None),
}


@pytest.mark.parametrize(("intrinsics", "kind"), CAMERAS.values(), ids=CAMERAS)
def test_intrinsics_against_the_image(intrinsics, kind):
    assert camera_warning_of(replace(Camera.of(intrinsics), image_size=(1242, 375))) is kind


def test_a_halved_matrix_without_a_size_is_noticed_on_the_right():
    pixels, _ = car(location=(5.0, 1.6, 12.0))
    right, half = Camera.of((720.0, 720.0, 610.0, 173.0)), Camera.of((360.0, 360.0, 305.0, 86.5))
    assert input_warning_of(Observation.of(pixels), right) is None
    assert input_warning_of(Observation.of(pixels), half) is InputWarning.BEYOND


def test_a_network_states_the_size_of_its_image():
    pixels, _ = car()
    seen = replace(Observation.of(pixels), image_size=(640, 640))
    with pytest.raises(InvalidInputError, match=r"640 x 640 pixels.*1242 x 375 pixels"):
        reconstruct(seen, CAMERA)
    assert reconstruct(replace(seen, image_size=(1242, 375)), CAMERA).status.determined


def test_a_part_of_an_image_has_its_principal_point_anywhere():
    assert camera_warning_of(CAMERA.cropped(700, 100, 300, 200)) is None


def test_intrinsics_in_parts_of_the_image_are_refused():
    pixels, _ = car()
    with pytest.raises(InvalidInputError, match="Give K in pixels"):
        reconstruct(pixels, (0.58, 1.92, 0.49, 0.46))


def test_results_in_the_air_name_the_camera():
    pixels, _ = car()
    with pytest.warns(ContradictoryInputWarning, match="principal point"):
        result = reconstruct(pixels, replace(Camera.of((720.0, 720.0, 173.0, 610.0)), image_size=(1242, 375)))
    assert result.status is Status.WEAK
    assert "the principal point of its camera is outside of the image" in result.reasons
    with pytest.warns(ContradictoryInputWarning, match="high up in the air"):
        result = reconstruct(pixels, (720.0, 720.0, 610.0, 700.0))
    assert result.status is Status.WEAK
    assert "high up in the air" in result.message


def test_results_farther_than_a_camera_shows_keypoints_name_the_focal_length():
    pixels, _ = car()
    with pytest.warns(ContradictoryInputWarning, match=r"2000 m away\. Is the camera.s focal"):
        result = reconstruct(pixels, (7.2e5, 7.2e5, 610.0, 173.0))
    assert result.status is Status.WEAK
    assert "it is more than 2000 m away" in result.reasons


def test_python_warns_as_commands_do():
    pixels, _ = car()
    said = pytest.warns(ContradictoryInputWarning, match="All keypoints of the vehicle are between 0 and 1")
    with said, contextlib.suppress(DegenerateProblemError):
        reconstruct(pixels / [1242.0, 375.0], CAMERA)
    box = np.array([*np.nanmin(pixels, axis=0), *np.nanmax(pixels, axis=0)])
    exchanged = Observation.of(pixels[:, ::-1], box=box)
    assert input_warning_of(exchanged, CAMERA) is InputWarning.BESIDE
    with pytest.warns(ContradictoryInputWarning, match="vehicle 1 are beside the 2D box") as caught:
        reconstruct_scene([Observation.of(pixels, box=box), exchanged], CAMERA)
    assert caught[0].filename == __file__
    with warnings.catch_warnings(), summed_up():
        warnings.simplefilter("error")
        reconstruct_scene([exchanged], CAMERA)


CARS = [(-1.1, (3.0, 1.6, 12.0)), (0.5, (-3.0, 1.6, 10.0)), (2.4, (0.0, 1.6, 14.0)), (-2.7, (-4.0, 1.6, 16.0))]


@pytest.mark.parametrize(("yaw", "location"), CARS)
def test_left_and_right_exchanged(yaw, location):
    pixels, visible = car(yaw, location)
    confidence = np.where(visible, 0.9, 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert reconstruct(pixels, CAMERA, confidence=confidence).status.value == "converged"
    mirrored = pixels * [-1.0, 1.0] + [1241.0, 0.0]
    for points, sure in ((pixels[MIRROR], confidence[MIRROR]), (mirrored, confidence)):
        with pytest.warns(ContradictoryInputWarning, match="fit better with left and right exchanged"):
            result = reconstruct(points, CAMERA, confidence=sure)
        assert result.status.value != "converged"
        assert result.diagnostics.mirrored_gain > 8.0


def test_a_camera_that_looks_down_on_a_given_ground_is_right():
    tilt = np.radians(50.0)
    camera_R_level = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = cars.yaw_pose(0.5)
    pose[:3, :3] = camera_R_level @ pose[:3, :3]
    pose[:3, 3] = 0.5, 0.3, 12.0
    ground = Ground(pose[:3, 1], float(pose[:3, 1] @ pose[:3, 3]))
    seen = cars.observe(PRIOR, pose)
    assert reconstruct(seen, cars.CAMERA, size_prior="kitti", ground=ground).status.determined  # without a warning
    with pytest.warns(ContradictoryInputWarning, match="Of a camera that looks down give the ground"):
        reconstruct(seen, cars.CAMERA, size_prior="kitti")
