"""Fisheye lenses: OpenCV's own numbers, the way back, and rays to the side."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon.core.camera import Camera, lens_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation

K = np.array([[301.5, 0.0, 640.2], [0.0, 299.8, 481.7], [0.0, 0.0, 1.0]])
FISHEYE = Camera(K, np.array([-0.02, 0.004, -0.003, 0.0004]), (1280, 960), distortion_model="fisheye")
EQUIDISTANT = replace(FISHEYE, distortion=np.zeros(4))
MEI = Camera(
    np.array([[1336.3, 0.0, 716.9], [0.0, 1335.8, 705.8], [0.0, 0.0, 1.0]]),
    np.array([2.2134, 0.0169, 1.6549, 0.0004, -0.0003]),  # as KITTI-360's
    (1400, 1400),
    distortion_model="mei",
)
LENSES = {"fisheye": FISHEYE, "equidistant": EQUIDISTANT, "mei": MEI}


def directions(widest):
    angle, around = np.meshgrid(np.radians(np.linspace(0.0, widest, 40)), np.linspace(0.0, 6.0, 15))
    flat = np.tan(angle.ravel())[:, None] * np.stack([np.cos(around.ravel()), np.sin(around.ravel())], axis=1)
    return np.column_stack([flat, np.ones(len(flat))])


@pytest.mark.parametrize("camera", [FISHEYE, EQUIDISTANT])
def test_a_fisheye_is_opencvs(camera):
    points = 7.5 * directions(84.0)
    zero = np.zeros(3)
    theirs = cv2.fisheye.projectPoints(points[None], zero, zero, K, camera.distortion)[0][0]
    assert np.abs(camera.distort(camera.project(points)) - theirs).max() < 1e-9


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
def test_the_way_back(camera):
    ideal = camera.project(directions(84.0))
    pixels = camera.distort(ideal)
    back = camera.undistort(pixels)
    assert np.abs(camera.distort(back) - pixels).max() < 1e-6
    near = np.abs(directions(84.0)[:, :2]).max(axis=1) < 2.0
    assert np.abs(back - ideal)[near].max() < 1e-6
    assert camera.ideal_pixels(pixels)[1].all()


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
def test_what_is_not_ahead_has_no_pixel_of_a_pinhole(camera):
    edge = camera.distort(camera.project(directions(84.9)[-1:]))
    centre = camera.matrix[:2, 2]
    beyond = centre + (edge - centre) * [[1.1], [1.3]]
    assert np.isnan(camera.undistort(beyond)).all()
    assert not camera.ideal_pixels(beyond)[1].any()
    given = np.concatenate([beyond, camera.distort(camera.project(directions(40.0)[-4:]))])
    seen = Observation.of(given).undistorted(camera, ["a", "b", "c", "d", "e", "f"])
    assert seen.measured.tolist() == [False, False, True, True, True, True]
    assert seen.left_out == ("a, b: left out, the lens distortion cannot be undone there.",)


def test_a_polynomial_that_turns_back_has_no_rays_beyond():
    camera = replace(FISHEYE, distortion=np.array([-0.3, 0.0, 0.0, 0.0]))  # at 60 degrees
    ideal = camera.undistort(camera.matrix[:2, 2] + [[200.0, 0.0], [212.0, 0.0]])
    assert np.isfinite(ideal[0]).all()
    assert np.isnan(ideal[1]).all()


def test_covariances_are_stretched_with_the_pixels():
    points = directions(60.0)[[-1, 5, 20]]
    pixels = FISHEYE.distort(FISHEYE.project(points))
    rng = np.random.default_rng(5)
    noisy = FISHEYE.undistort(np.repeat(pixels, 20000, axis=0) + rng.normal(0.0, 0.3, (60000, 2))).reshape(3, -1, 2)
    seen = Observation.of(pixels, covariance=np.tile(0.09 * np.eye(2), (3, 1, 1))).undistorted(FISHEYE, "abc")
    for values, covariance in zip(noisy, seen.covariance, strict=True):
        assert np.abs(np.cov(values.T) - covariance).max() < 0.05 * np.abs(covariance).max()
    assert seen.covariance[0].max() > 10 * 0.09


def test_a_box_goes_where_the_middles_of_its_sides_go():
    box = np.array([900.0, 500.0, 1000.0, 560.0])
    seen = Observation.of(box.reshape(2, 2), box=box).undistorted(FISHEYE, ["a", "b"])
    left, lower = FISHEYE.undistort(np.array([[900.0, 530.0], [950.0, 560.0]]))
    assert seen.box[0] == left[0]
    assert seen.box[3] == lower[1]


def test_fields_of_a_lens_come_back():
    for camera in (*LENSES.values(), Camera(K), Camera(K, np.array([0.1, 0.0, 0.0, 0.0]))):
        again = Camera(camera.matrix, **lens_of(camera.lens_fields))
        assert again.lens_fields == camera.lens_fields
    assert Camera(K).lens_fields == {}
    assert FISHEYE.with_distortion(None).lens_fields == {}
    assert Camera.of(FISHEYE, [0.1, 0.0, 0.0, 0.0]).distortion_model == "opencv"


@pytest.mark.parametrize(
    ("lens", "model", "message"),
    [
        ([0.1, 0.0, 0.0, 0.0], "ds", r"distortion_model: got ds\. Give one of: opencv, fisheye, mei"),
        ([0.1, 0.0], "fisheye", "2 coefficients. Give 4 of fisheye"),
        (None, "mei", "0 coefficients. Give 5 of mei"),
    ],
)
def test_other_lenses_are_refused(lens, model, message):
    with pytest.raises(InvalidInputError, match=message):
        Camera(K, lens, distortion_model=model)


def test_stereo_of_fisheyes_is_refused():
    from fgrecon.core.evidence import StereoPair
    from fgrecon.perception.stereo import stereo_depth

    image, motion = np.zeros((20, 30, 3), np.uint8), np.eye(4)
    motion[0, 3] = -0.5
    with pytest.raises(InvalidInputError, match="right: got a fisheye"):
        stereo_depth(image, FISHEYE, StereoPair(image + 1, FISHEYE, motion))
