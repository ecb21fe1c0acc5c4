#!/usr/bin/env bash
# rosbags-image 0.10.4, message_to_cvimage of a sensor_msgs/Image whose rows are longer than its width, as drivers of cameras lay them out
# in memory (rows of a multiple of 32 or 64 bytes): `step` tells the length of a row.
#
# Guess: the first `width` pixels of each row, or an error, since the buffer is larger than height x width.
# Seen: `step` is not looked at. Pixels are taken one after the other, so that each row begins where the one before ended: a line straight down
# comes out slanted, the last rows are missing, nothing is said. cv_bridge had the same and reads `step` today. Of NV12, whose buffer has half
# as many rows again, the colour is read from the brightness, and a third of the rows is missing.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet rosbags-image==0.10.4 rosbags==0.11.9 numpy==2.3.5 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
Time, Header, Image = (store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/Image"))


def read(encoding, height, width, rows):
    """What is read of a message with these rows, after it was written and read as ROS does."""
    header = Header(stamp=Time(0, 0), frame_id="camera")
    message = Image(header, height, width, encoding, 0, rows.shape[1], rows.ravel())
    return store.deserialize_cdr(store.serialize_cdr(message, Image.__msgtype__), Image.__msgtype__)


image = np.zeros((60, 100), np.uint8)
image[:, 40] = 255
for step in (100, 128):
    rows = np.zeros((60, step), np.uint8)
    rows[:, :100] = image
    seen = message_to_cvimage(read("mono8", 60, 100, rows))
    lines = [np.flatnonzero(row).tolist() for row in seen]
    print(f"rows of {step} bytes: the line is in columns {lines[:6]} ..., {(seen > 0).sum()} of 60 pixels of it")
    assert seen.shape == (60, 100) and np.array_equal(seen, image) == (step == 100)
assert np.array_equal(seen.ravel(), rows.ravel()[:6000])
planes = np.concatenate([np.full((60, 100), 90, np.uint8), np.full((30, 100), 128, np.uint8)])  # gray: brightness, then no colour
seen = message_to_cvimage(read("nv12", 60, 100, planes), "bgr8")
print("NV12, 60 x 100, gray all over:", seen.shape, "pixels of", np.unique(seen.reshape(-1, 3), axis=0).tolist())
assert seen.shape == (40, 100, 3) and abs(np.ptp(seen, axis=2)).min() > 20
PYTHON
