"""What pykitti makes of a day of KITTI's raw data: run in its own environment, FOLDER.

It has poses and calibrations but no tracklets: corners are made here of the file, as KITTI's own devkit draws them
(run_demoTracklets.m: the origin is the bottom's centre, x forward, y left, z up).
"""

import json
import sys
from xml.etree import ElementTree as ET

import numpy as np
import pykitti

drive = pykitti.raw(sys.argv[1], "2011_09_26", "0001")
calib, found = drive.calib, {"corners": {}, "images": {}}
velos = {2: calib.T_cam2_velo, 3: calib.T_cam3_velo}
matrices = {2: calib.K_cam2, 3: calib.K_cam3}
root = ET.parse(f"{sys.argv[1]}/2011_09_26/2011_09_26_drive_0001_sync/tracklet_labels.xml").getroot()
for frame, oxts in enumerate(drive.oxts):
    for number, item in enumerate(root.findall("./tracklets/item")):
        high, wide, long = (float(item.findtext(name)) for name in "hwl")
        row = item.findall("./poses/item")[frame]
        x, y, z, yaw = (float(row.findtext(name)) for name in ("tx", "ty", "tz", "rz"))
        ours = [(a * long / 2, b * wide / 2, c) for a in (-1, 1) for c in (0, high) for b in (-1, 1)]
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        corners = np.column_stack([np.array(ours) @ turn.T + [x, y, z], np.ones(8)])
        world = corners @ (oxts.T_w_imu @ np.linalg.inv(calib.T_velo_imu)).T
        key = f"{number}@{frame}"
        found["corners"][key] = world[:, :3].tolist()
        for camera, motion in velos.items():
            points = (corners @ motion.T)[:, :3]
            pixels = points @ matrices[camera].T
            seen = found["images"].setdefault(f"image_{camera:02d}/{frame:010d}", {})
            seen[key] = {"corners": points.tolist(), "pixels": (pixels[:, :2] / pixels[:, 2:]).tolist()}
json.dump(found, sys.stdout)
