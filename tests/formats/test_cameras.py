"""Cameras of COLMAP: pixels as pycolmap has them, half a pixel apart, of files that it wrote itself."""

import numpy as np
import pytest

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
