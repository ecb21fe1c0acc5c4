#!/usr/bin/env bash
# nuscenes-devkit 1.2.0, box_in_image(..., BoxVisibility.ANY): a box is in an image if one of its corners is, not if it is seen.
#
# Guess: a bus that crosses three metres ahead of the camera, and fills the image from edge to edge, is in it.
# Seen: it is not, since all eight corners lie beside the image; get_sample_data leaves it out. A car far away is in it.
# The objects nearest to the camera are missing in whatever is trained on these lists.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps nuscenes-devkit==1.2.0 && env/bin/pip install --quiet numpy==1.26.4 pyquaternion==0.9.9 matplotlib==3.9.4 opencv-python-headless==4.11.0.86 scikit-learn==1.5.2 tqdm==4.67.1 cachetools==5.5.0
env/bin/python - <<'PYTHON'
import numpy as np
from nuscenes.utils.data_classes import Box
from nuscenes.utils.geometry_utils import BoxVisibility, box_in_image, view_points
from pyquaternion import Quaternion

matrix, size = np.array([[1266.0, 0, 800], [0, 1266, 450], [0, 0, 1]]), (1600, 900)
across = Quaternion(axis=[1, 0, 0], angle=np.pi / 2)  # its length along the image, its height upright
bus = Box([0, 0.2, 4.25], [2.5, 12.0, 3.0], across)
pixels = view_points(bus.corners(), matrix, normalize=True)
print("columns of the bus:", pixels[0].min().round(), "to", pixels[0].max().round(), "depths from", bus.corners()[2].min())
small = Box([0, 0.2, 60.0], [1.8, 4.5, 1.5], across)
found = [box_in_image(box, matrix, size, vis_level=BoxVisibility.ANY) for box in (bus, small)]
print("bus in the image:", found[0], " car at 60 m:", found[1])
assert pixels[0].min() < 0 and pixels[0].max() > 1600 and bus.corners()[2].min() > 1 and found == [False, True]
PYTHON
