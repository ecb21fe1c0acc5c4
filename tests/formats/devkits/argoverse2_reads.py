"""What av2 makes of a folder of logs: run in its own environment, FOLDER."""

import json
import sys
from pathlib import Path

import numpy as np
from av2.datasets.sensor.av2_sensor_dataloader import AV2SensorDataLoader
from av2.structures.cuboid import CuboidList
from av2.structures.sweep import Sweep
from av2.utils.io import read_feather

ORDER = [6, 7, 5, 4, 2, 3, 1, 0]
"""Of the devkit's corners: rear before front, bottom before top, right before left, as fgrecon has them."""
root = Path(sys.argv[1])
data = AV2SensorDataLoader(root, root)
found = {"corners": {}, "images": {}, "points": {}}
for log in data.get_log_ids():
    table = read_feather(root / log / "annotations.feather")
    cuboids = CuboidList.from_feather(root / log / "annotations.feather")
    names = [f"{t}-{u}" for t, u in zip(table["timestamp_ns"], table["track_uuid"])]
    for name, cuboid in zip(names, cuboids):
        city = cuboid.transform(data.get_city_SE3_ego(log, cuboid.timestamp_ns))
        found["corners"][name] = city.vertices_m[ORDER].tolist()
    for camera in ("ring_front_center", "ring_rear_left"):
        for time in data.get_ordered_log_lidar_timestamps(log):
            image = data.get_closest_img_fpath(log, camera, time)
            seen = {}
            for name, cuboid in zip(names, cuboids):
                if cuboid.timestamp_ns == time:
                    pixels, points, _ = data.project_ego_to_img_motion_compensated(
                        cuboid.vertices_m[ORDER], camera, int(image.stem), time, log
                    )
                    points = np.asarray(points)[:, :3]
                    seen[name] = {
                        "corners": points.tolist(),
                        "pixels": np.where(points[:, 2:] > 0.1, pixels, 0.0).tolist(),
                    }
            found["images"][f"{camera}/{image.stem}"] = seen
            sweep = Sweep.from_feather(data.get_lidar_fpath(log, time))
            _, points, _ = data.project_ego_to_img_motion_compensated(sweep.xyz, camera, int(image.stem), time, log)
            found["points"][f"{camera}/{image.stem}"] = np.asarray(points)[:, :3].tolist()
json.dump(found, sys.stdout)
