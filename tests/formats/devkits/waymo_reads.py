"""What waymo-open-dataset makes of its tables: run in its own environment, FOLDER."""

import json
import os
import sys
from pathlib import Path

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
import numpy as np
import pyarrow.parquet as pq
import tensorflow as tf
from waymo_open_dataset import v2
from waymo_open_dataset.utils import box_utils
from waymo_open_dataset.wdl_limited.camera.ops import py_camera_model_ops

ORDER = [2, 1, 6, 5, 3, 0, 7, 4]
"""Of the devkit's corners: rear before front, bottom before top, right before left, as fgrecon has them."""
NAMES = {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}


def read(folder, component):
    (file,) = (Path(sys.argv[1]) / folder).glob("*.parquet")
    return [component.from_dict(row) for row in pq.read_table(file).to_pylist()]


poses = {row.key.frame_timestamp_micros: row for row in read("vehicle_pose", v2.VehiclePoseComponent)}
cameras = {row.key.camera_name: row for row in read("camera_calibration", v2.CameraCalibrationComponent)}
found, frames = {"corners": {}, "images": {}}, {}
for row in read("lidar_box", v2.LiDARBoxComponent):
    time, box = row.key.frame_timestamp_micros, tf.constant([row.box.numpy(np.float64)])
    pose = np.array(poses[time].world_from_vehicle.transform).reshape(4, 4)
    corners = box_utils.get_upright_3d_box_corners(box).numpy()[0][ORDER] @ pose[:3, :3].T + pose[:3, 3]
    key = f"{time}-{row.key.laser_object_id}"
    found["corners"][key] = corners.tolist()
    frames.setdefault(time, {})[key] = corners
for image in read("camera_image", v2.CameraImageComponent):
    lens, time, seen = cameras[image.key.camera_name], image.key.frame_timestamp_micros, {}
    numbers = lens.intrinsic
    shutter = image.rolling_shutter_params
    for key, corners in frames[time].items():
        pixels = py_camera_model_ops.world_to_image(
            np.array(lens.extrinsic.transform).reshape(4, 4),
            np.array([getattr(numbers, n) for n in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")]),
            [lens.width, lens.height, lens.rolling_shutter_direction],
            np.array(
                [
                    *image.pose.transform,
                    *([0.0] * 6),
                    image.pose_timestamp,
                    shutter.shutter,
                    shutter.camera_trigger_time,
                    shutter.camera_readout_done_time,
                ]
            ),
            corners,
        ).numpy()
        seen[key] = {"pixels": pixels[:, :2].tolist(), "valid": (pixels[:, 2] > 0).tolist()}
    found["images"][f"{NAMES[image.key.camera_name]}/{time}"] = seen
json.dump(found, sys.stdout)
