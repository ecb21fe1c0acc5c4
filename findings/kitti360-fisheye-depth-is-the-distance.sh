#!/usr/bin/env bash
# kitti360scripts 1.0.0, CameraFisheye.cam2image(points) -> u, v, depth: the same call as of CameraPerspective, by which boxes are drawn and
# hidden ones sorted out.
#
# Guess: depth is z, as CameraPerspective gives it; the lens is that of image_02.yaml (camodocal's MEI), with xi, k1, k2, p1, p2.
# Seen: depth is the distance from the camera with the sign of z: a point 10 m to the right and 1 m ahead has 1 with one camera, 10.05 with
# the other. p1 and p2 change no pixel, however large they are.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet kitti360scripts==1.0.0 numpy==1.23.5 matplotlib==3.7.5 scikit-image==0.21.0 scipy==1.11.4 opencv-python-headless==4.8.1.78
env/bin/python - <<'PYTHON'
import numpy as np
from kitti360scripts.helpers.project import CameraFisheye, CameraPerspective


def fisheye(p1, p2):
    camera = CameraFisheye.__new__(CameraFisheye)
    camera.fi = {
        "mirror_parameters": {"xi": 2.2134},
        "distortion_parameters": {"k1": 0.0169, "k2": 1.6549, "p1": p1, "p2": p2},
        "projection_parameters": {"gamma1": 1336.3, "gamma2": 1335.8, "u0": 716.9, "v0": 705.8},
    }
    return camera


flat = CameraPerspective.__new__(CameraPerspective)
flat.K = np.array([[552.554261, 0, 682.049453, 0], [0, 552.554261, 238.769549, 0], [0, 0, 1, 0]])
side = np.array([10.0, 0.0, 1.0])[:, None]
depths = float(flat.cam2image(side.copy())[2]), float(fisheye(0.0, 0.0).cam2image(side.copy())[2])
print("depth of a point 10 m to the right and 1 m ahead, perspective and fisheye:", depths)
pixels = [np.ravel(fisheye(p, -p).cam2image(side.copy())[:2]) for p in (0.0, 0.05)]
print("its pixel without and with p1, p2 of 0.05:", *pixels)
assert depths[0] == 1.0 and abs(depths[1] - np.hypot(10.0, 1.0)) < 1e-9
assert np.array_equal(*pixels)
PYTHON
