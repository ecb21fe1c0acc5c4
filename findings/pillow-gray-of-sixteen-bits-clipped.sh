#!/usr/bin/env bash
# Pillow 13.0.0, Image.convert: a gray PNG of 16 bits becomes white above 255, a colour PNG of the same numbers does not.
#
# Guess: both become 8 bits alike, by their upper byte or by scaling; the class of the picture says nothing of brightness.
# Seen: the colour PNG is opened as RGB with the upper bytes, as OpenCV reads either. The gray one is opened as I;16, and
# convert("L") or convert("RGB") cuts at 255 instead, so a photograph of a camera with 12 or 16 bits is white all over.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pillow==13.0.0 numpy==2.4.6 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import cv2
import numpy as np
from PIL import Image

numbers = np.array([[0, 200, 300, 4095, 65535]], dtype=np.uint16)
cv2.imwrite("gray.png", numbers)
cv2.imwrite("colour.png", np.dstack([numbers] * 3))
gray = np.asarray(Image.open("gray.png").convert("RGB"))[0, :, 0].tolist()
colour = np.asarray(Image.open("colour.png").convert("RGB"))[0, :, 0].tolist()
print("given", numbers[0].tolist(), "gray", gray, "colour", colour, "OpenCV", cv2.imread("gray.png")[0, :, 0].tolist())
assert gray == [0, 200, 255, 255, 255] and colour == [0, 0, 1, 15, 255] == cv2.imread("gray.png")[0, :, 0].tolist()
PYTHON
