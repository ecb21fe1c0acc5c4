"""Lens distortion that is no lens's: the error names it, and not what it made of box and keypoints."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon import Camera, reconstruct, reconstruct_scene
from fgrecon.core.errors import InvalidInputError
from tests.cars import CAMERA, observe, yaw_pose


@pytest.fixture(scope="module")
def seen(prior):
    return observe(prior, yaw_pose(0.5))


@pytest.mark.parametrize(
    "distortion",
    [[1e10, 0, 0, 0], [0, 0, 1e5, 0], [0, 0, 0, 1e300], [1e300] * 4, [-50, 0, 0, 0]],
    ids=["pincushion", "tangential", "enormous", "all enormous", "barrel"],
)
@pytest.mark.parametrize("boxed", [True, False])
def test_a_distortion_that_cannot_be_undone_is_blamed(seen, distortion, boxed):
    given = seen if boxed else replace(seen, box=None)
    with pytest.raises(InvalidInputError, match="at the keypoints") as error:  # the box alone would be left out
        reconstruct(given, CAMERA.matrix, distortion=distortion)
    assert error.value.field == "distortion"
    scene = reconstruct_scene([given], Camera(CAMERA.matrix, distortion))
    assert "distortion" in str(scene.refused[0])


def test_a_keypoint_that_no_lens_images_there_is_not_measured(seen):
    """A barrel's image ends where its rays turn back; a detector's wrong point may lie beyond."""
    camera = replace(CAMERA, distortion=np.array([-0.3, 0.0, 0.0, 0.0]))
    bent = replace(seen, keypoints=camera.distort(seen.keypoints), box=None)
    pixels = bent.keypoints.copy()
    pixels[2] = 5000.0, 3000.0
    beyond, without = (reconstruct(replace(bent, keypoints=p), camera) for p in (pixels, _without(bent.keypoints, 2)))
    np.testing.assert_array_equal(beyond.camera_T_object, without.camera_T_object)


def _without(pixels, row):
    left = pixels.copy()
    left[row] = np.nan
    return left


def test_a_car_through_a_fisheye_is_the_car_of_a_pinhole(seen):
    """The same pose, from the file that says so, and drawn where the fisheye images it."""
    camera = replace(CAMERA, distortion=np.array([-0.02, 0.004, -0.003, 0.0004]), distortion_model="fisheye")
    bent = replace(seen, keypoints=camera.distort(seen.keypoints), box=None)
    pinhole = reconstruct(replace(seen, box=None), CAMERA)
    fisheye = reconstruct(bent, camera)
    np.testing.assert_allclose(fisheye.camera_T_object, pinhole.camera_T_object, atol=1e-4)
