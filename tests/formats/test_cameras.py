"""Cameras of COLMAP: pixels as pycolmap has them, half a pixel apart, of files that it wrote itself."""

import json

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.io.cameras import read_camera


@pytest.mark.formats
@pytest.mark.parametrize("name", ["cameras.txt", "cameras.bin"])
def test_colmap_cameras_project_alike(tmp_path, devkit, name):
    said = devkit("colmap", "colmap_writes", tmp_path)
    points = np.array(said["points"])
    for number, pixels in said["pixels"].items():
        camera = read_camera(f"{tmp_path / name}#{number}").camera
        ours = camera.distort(camera.project(points))
        assert np.abs(ours - (np.array(pixels) - 0.5)).max() < 1e-3, number


@pytest.mark.formats
def test_a_lens_behind_a_sphere_is_opencvs_omnidir(devkit):
    camera = Camera(
        np.array([[1336.3, 0.0, 716.9], [0.0, 1335.8, 705.8], [0.0, 0.0, 1.0]]),
        np.array([2.2134, 0.0169, 1.6549, 0.0004, -0.0003]),
        distortion_model="mei",
    )
    points = np.array([[x, y, 2.0] for x in (-9.0, -2.0, 0.1, 0.7) for y in (-3.0, 0.3)])
    given = {"points": points.tolist(), "K": camera.matrix.tolist(), "lens": camera.distortion.tolist()}
    pixels = np.array(devkit("lens", "lens_projects", given=json.dumps(given)))
    assert np.abs(camera.distort(camera.project(points)) - pixels).max() < 1e-6
    assert np.abs(camera.undistort(pixels) - camera.project(points)).max() < 1e-3
