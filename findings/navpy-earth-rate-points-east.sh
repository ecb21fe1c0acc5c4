#!/usr/bin/env bash
# navpy 1.0, earthrate(lat): "the earth rotation rate resolved on NED axes", in rad/s.
#
# Guess: w (cos, 0, -sin) of the latitude: the axis of the Earth lies in the plane of the meridian, north and up.
# Seen: w (cos, -sin, 0): what belongs down stands in the east. The length is right, so that a check of it passes. At 48 degrees an inertial
# navigation that takes it off its gyroscopes has 11 degrees per hour too much about two axes; a gyrocompass that looks for this vector finds
# north 48 degrees off. navrate, lla2ecef and the rotations of this package are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet navpy==1.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import navpy
import numpy as np

SPEED = 7.292115e-5  # rad/s, WGS84
for latitude in (-33.0, 0.0, 48.0, 90.0):
    pole = np.array([0, 0, 1000.0])
    true = navpy.ecef2ned(pole, latitude, 11.0, 0.0) / 1000 * SPEED  # the axis of the Earth, turned by the package itself
    angle = np.radians(latitude)
    assert abs(true - SPEED * np.array([np.cos(angle), 0, -np.sin(angle)])).max() < 1e-15
    told = navpy.earthrate(latitude)
    off = np.degrees(told - true) * 3600
    print(f"latitude {latitude:5.1f}: told {told.round(9)}, is {true.round(9)} rad/s, off by {off.round(2)} degrees per hour")
    assert abs(told - SPEED * np.array([np.cos(angle), -np.sin(angle), 0])).max() < 1e-15
    assert abs(np.linalg.norm(told) - SPEED) < 1e-15
assert abs(np.degrees(np.arctan2(*navpy.earthrate(48.0)[1::-1])) + 48) < 1e-9
PYTHON
