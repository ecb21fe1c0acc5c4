#!/usr/bin/env bash
# pyrealsense2 2.59.1.11053, rs2_project_point_to_pixel and rs2_deproject_pixel_to_point: a lens of `modified_brown_conrady`.
#
# Guess: deprojecting undoes projecting, for every lens that can be projected, or is refused.
# Seen: it does for brown_conrady and inverse_brown_conrady; with modified_brown_conrady the pixel is taken for that of a lens without
# coefficients, without a word. A point at (0.4, 0.2, 1) m comes back at (0.409, 0.204, 1) with k1 = 0.15: of a wall 5 m away 4 cm.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pyrealsense2==2.59.1.11053 numpy==2.3.5
env/bin/python - <<'PYTHON'
import numpy as np
import pyrealsense2 as rs

camera = rs.intrinsics()
camera.width, camera.height, camera.fx, camera.fy, camera.ppx, camera.ppy = 1280, 720, 900.0, 900.0, 640.0, 360.0
camera.coeffs = [0.15, -0.3, 0.001, 0.002, 0.1]
point, back = [0.4, 0.2, 1.0], {}
for lens in (rs.distortion.brown_conrady, rs.distortion.inverse_brown_conrady, rs.distortion.modified_brown_conrady):
    camera.model = lens
    pixel = rs.rs2_project_point_to_pixel(camera, point)
    back[lens.name] = np.array(rs.rs2_deproject_pixel_to_point(camera, pixel, 1.0))
    print(lens.name, "pixel", np.round(pixel, 2), "point", back[lens.name].round(4))
    pinhole = [(pixel[0] - 640) / 900, (pixel[1] - 360) / 900, 1.0]
assert all(np.allclose(back[name], point, atol=1e-5) for name in ("brown_conrady", "inverse_brown_conrady"))
assert np.allclose(back["modified_brown_conrady"], pinhole, atol=1e-6) and abs(back["modified_brown_conrady"][0] - 0.4) > 0.008
PYTHON
