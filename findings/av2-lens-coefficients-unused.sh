#!/usr/bin/env bash
# av2 0.3.6 (Argoverse 2), PinholeCamera: intrinsics.feather has k1, k2, k3, and projections are made without them.
#
# Guess: a camera that is read from a file with k1 = 0.1 moves a point at half a focal length from the axis outwards.
# Seen: it lies where a pinhole has it. Whoever feeds these coefficients to OpenCV is 12 pixels off from the devkit, and
# from the labels that were drawn with it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps av2==0.3.6 && env/bin/pip install --quiet numpy==2.2.6 pandas==2.3.3 pyarrow==21.0.0 opencv-python-headless==4.12.0.88 universal-pathlib==0.2.6 scipy==1.16.3 numba==0.63.1 rich==14.2.0 polars==1.35.2 pyproj==3.7.2 joblib==1.5.2
env/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
import pandas as pd
from av2.geometry.camera.pinhole_camera import PinholeCamera

Path("calibration").mkdir()
name = {"sensor_name": ["ring_front_center"]}
lens = {"fx_px": 1000.0, "fy_px": 1000.0, "cx_px": 800.0, "cy_px": 450.0, "k1": 0.1, "k2": 0.0, "k3": 0.0}
pd.DataFrame({**name, **lens, "width_px": 1600, "height_px": 900}).to_feather("calibration/intrinsics.feather")
pose = dict(qw=1.0, qx=0.0, qy=0.0, qz=0.0, tx_m=0.0, ty_m=0.0, tz_m=0.0)
pd.DataFrame({**name, **pose}).to_feather("calibration/egovehicle_SE3_sensor.feather")
camera = PinholeCamera.from_feather(Path("."), "ring_front_center")
seen = camera.project_cam_to_img(np.array([[0.5, 0.0, 1.0]]))[0][0]
lens_says = 800 + 1000 * 0.5 * (1 + 0.1 * 0.5**2)
print("seen at", seen[0], "by k1 at", lens_says)
assert seen[0] == 1300.0 and abs(lens_says - 1312.5) < 1e-9
PYTHON
