#!/usr/bin/env bash
# rosbags-image 0.10.4, message_to_cvimage of a sensor_msgs/CompressedImage: a depth image in millimetres, "16UC1; png compressed".
#
# Guess: the 16 bits that the PNG has, as the same function gives of the image that is not compressed.
# Seen: 8 bits, the upper ones: a wall 3.0 m away is 11. Depths are steps of 256 mm, what is nearer than 25 cm is 0 and so "not measured", and
# nothing is said. cv_bridge had the same for years (issue 206 of vision_opencv); here "mono16" as color_space does not help, it is an error.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet rosbags-image==0.10.4 rosbags==0.11.9 numpy==2.3.5 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import cv2
import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
names = ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
Time, Header, Image, CompressedImage = (store.types[name] for name in names)
header = Header(stamp=Time(0, 0), frame_id="camera")
depth = np.tile(np.array([200, 1000, 3000, 3200, 12345], np.uint16), (4, 1))  # mm
plain = Image(header, 4, 5, "16UC1", 0, 10, depth.view(np.uint8).ravel())
packed = CompressedImage(header, "16UC1; png compressed ", cv2.imencode(".png", depth)[1].ravel())
assert np.array_equal(cv2.imdecode(packed.data, cv2.IMREAD_UNCHANGED), depth)
for name, message in {"Image": plain, "CompressedImage": packed}.items():
    seen = message_to_cvimage(message)
    print(name, seen.dtype, seen[0])
assert np.array_equal(message_to_cvimage(plain), depth)
assert seen.dtype == np.uint8 and abs(seen.astype(int) - depth / 256).max() < 1
PYTHON
