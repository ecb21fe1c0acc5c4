#!/usr/bin/env bash
# pykitti 0.3.1, raw(...).get_velo(i), velo and frames=...: the i-th scan of a drive of KITTI's raw data, of which some scans are missing (as of
# 2011_09_26_drive_0009, which has four scans fewer than images).
#
# Guess: i is the number of the frame, that of the file's name: image i, pose i and scan i belong together; a missing scan is an error or None.
# Seen: i counts the files that are there. Behind the gap each scan is one of a later frame, and projects into the image as if the car had
# moved; zip(velo, cam2) pairs them so for the rest of the drive, and nothing tells.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet --no-deps pykitti==0.3.1 && env/bin/pip install --quiet numpy==2.2.6 pillow==12.0.0 pandas==2.3.3 opencv-python-headless==4.12.0.88
env/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
import pykitti

day = Path("2011_09_26")
drive = day / "2011_09_26_drive_0001_sync"
for kind in ("oxts", "velodyne_points"):
    (drive / kind / "data").mkdir(parents=True)
(day / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
(day / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n")
cameras = [f"P_rect_0{i}: 700 0 600 {-i * 10} 0 700 180 0 0 0 1 0\nR_rect_0{i}: 1 0 0 0 1 0 0 0 1\n" for i in range(4)]
(day / "calib_cam_to_cam.txt").write_text("".join(cameras))
(drive / "oxts/timestamps.txt").write_text("".join(f"2011-09-26 13:02:{i:02d}.000000000\n" for i in range(6)))
for i in range(6):
    packet = [49.0, 8.4, 100.0, 0.0, 0.0, 0.1 * i, *[0.0] * 19, 4, 10, 5, 5, 5][:30]
    (drive / f"oxts/data/{i:010d}.txt").write_text(" ".join(map(str, packet)) + "\n")
    if i != 2:  # its scan was not recorded
        np.array([[i, 0, 0, 0]], np.float32).tofile(drive / f"velodyne_points/data/{i:010d}.bin")

data = pykitti.raw(".", "2011_09_26", "0001")
scans = [int(data.get_velo(i)[0, 0]) for i in range(5)]
chosen = pykitti.raw(".", "2011_09_26", "0001", frames=[3, 4])
pairs = [(round(oxts.packet.yaw * 10), int(scan[0, 0])) for oxts, scan in zip(chosen.oxts, chosen.velo)]
print("scans of frames 0 to 4:", scans, "; pose and scan of the frames 3 and 4:", pairs, "; length", len(data))
assert scans == [0, 1, 3, 4, 5] and pairs == [(3, 4), (4, 5)] and len(data) == 6
PYTHON
