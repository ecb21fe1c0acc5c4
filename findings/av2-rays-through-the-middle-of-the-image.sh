#!/usr/bin/env bash
# av2 0.3.6 (Argoverse 2), PinholeCamera.compute_pixel_ray_directions(uv): rays of pixels, in the camera's frame.
#
# Guess: the inverse of project_cam_to_img of the same camera: a point's pixel has a ray through the point.
# Seen: projecting takes the camera's principal point, the rays take the middle of the image. With a principal point 20 pixels off the
# middle the ray misses a point 50 m ahead by a metre, with one 300 off, as of an image that was cropped at one side, by 15. The planes that
# bound the field of view are those of the middle too: such a camera has points in its image that right_clipping_plane leaves out.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps av2==0.3.6 && env/bin/pip install --quiet numpy==2.2.6 pandas==2.3.3 pyarrow==21.0.0 opencv-python-headless==4.12.0.88 universal-pathlib==0.2.6 scipy==1.16.3 numba==0.63.1 rich==14.2.0 polars==1.35.2 pyproj==3.7.2 joblib==1.5.2
env/bin/python - <<'PYTHON'
import numpy as np
from av2.geometry.camera.pinhole_camera import Intrinsics, PinholeCamera
from av2.geometry.se3 import SE3


def camera(cx):
    return PinholeCamera(SE3(np.eye(3), np.zeros(3)), Intrinsics(1000.0, 1000.0, cx, 600.0, 1600, 1200), "ring_front_left")


point = np.array([[5.0, 2.5, 50.0]])
missed = []
for cx in (800.0, 780.0, 500.0):
    pixel = camera(cx).project_cam_to_img(point)[0][:, :2]
    ray = camera(cx).compute_pixel_ray_directions(pixel)[0]
    reached = ray / ray[2] * point[0, 2]
    missed.append(np.linalg.norm(reached - point[0]))
    print("principal point", cx, ": pixel", pixel[0], "ray at 50 m", reached.round(3), "of the point", point[0])
assert np.allclose(missed, [0, 1, 15], atol=1e-9)

right = np.array([[21.0, 0.0, 20.0]])
pixel, _, seen = camera(500.0).project_cam_to_img(right)
side = (camera(500.0).right_clipping_plane @ np.append(right[0], 1)).round(2)
print("a point at column", pixel[0, 0], "of 1600, in the image:", seen[0], "; distance inside the right plane:", side, "m")
assert seen[0] and side < -3
PYTHON
