#!/usr/bin/env bash
# pycolmap 4.2.1, Camera.rescale: a camera of COLMAP counts pixels from the corner of the image, not from a pixel's centre.
#
# Guess: halving an image moves a principal point of 320 to (320 + 0.5) / 2 - 0.5 = 159.75, as OpenCV's pixels go.
# Seen: to 160. COLMAP's first pixel has its centre at (0.5, 0.5); a camera that goes from COLMAP to OpenCV, or to anything
# with pixel centres at whole numbers, needs half a pixel less, and cameras.txt does not say so.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pycolmap==4.2.1 numpy==2.3.5
env/bin/python - <<'PYTHON'
import numpy as np
import pycolmap

camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])
camera.rescale(0.5)
print("principal point after halving:", camera.params[2:].tolist(), "OpenCV's would be", (320 + 0.5) / 2 - 0.5)
assert camera.params[2:].tolist() == [160.0, 120.0]
PYTHON
