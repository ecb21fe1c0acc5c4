#!/usr/bin/env bash
# pycolmap 4.2.1, refine_absolute_pose(..., return_covariance=True): a covariance of six numbers, the rotation's first.
#
# Guess: the covariance of a rotation vector in radians, and of the translation beside it.
# Seen: it is that of half the rotation vector, as the vector part of a small quaternion is: over 400 images of one
# camera with noise of a pixel the rotation scatters by twice the deviation that is told, the translation by what is told. A filter or a
# pose graph that takes these covariances trusts the rotation four times as much as it may; rows and columns of the rotation have to be doubled.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pycolmap==4.2.1 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

rng = np.random.default_rng(0)
camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])
turn, place = Rotation.from_euler("xyz", [0.4, 0.5, -0.3]), np.array([0.3, -0.2, 0.5])
ahead = rng.uniform([-2, -1.5, 8], [2, 1.5, 12], (60, 3))
points = turn.inv().apply(ahead - place)
pixels = ahead[:, :2] / ahead[:, 2:] * 500 + [320, 240]
options = pycolmap.AbsolutePoseRefinementOptions()
options.loss_function_scale = 1e4  # squares, so that the covariance is that of a plain fit

errors, told = [], []
for _ in range(400):
    start = pycolmap.Rigid3d(pycolmap.Rotation3d(turn.as_quat()), place)
    noisy, inliers = pixels + rng.normal(0, 1, pixels.shape), np.ones(60, bool)
    answer = pycolmap.refine_absolute_pose(start, noisy, points, inliers, camera, refinement_options=options, return_covariance=True)
    pose = answer["cam_from_world"]
    errors.append(np.append((Rotation.from_quat(pose.rotation.quat) * turn.inv()).as_rotvec(), pose.translation - place))
    told.append(answer["covariance"])
scatter, deviation = np.std(errors, axis=0), np.sqrt(np.diag(np.mean(told, axis=0)))
ratio = scatter / deviation
print("scatter", scatter.round(5), "told", deviation.round(5), "ratio", ratio.round(2))
assert (abs(ratio[:3] - 2) < 0.25).all() and (abs(ratio[3:] - 1) < 0.15).all()
PYTHON
