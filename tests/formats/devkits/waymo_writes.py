"""Writes the made-up scene as Waymo's tables with Waymo's own components: run in its own environment, FOLDER < SCENE.

SCENE is JSON: `frames` (microseconds, pose 4 x 4, boxes with place, size, heading), `cameras` (matrix, lens, pose).
"""

import json
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from waymo_open_dataset.v2 import column_types as types
from waymo_open_dataset.v2.perception import base, box, camera_image, context, pose

root, name, scene = Path(sys.argv[1]), "1005081002024129653_5313_150_5333_150", json.load(sys.stdin)


def write(folder, rows):
    (root / folder).mkdir(parents=True)
    schema = type(rows[0]).schema()
    columns = [row.to_flatten_dict() for row in rows]
    pq.write_table(pa.Table.from_pylist(columns, schema=schema), root / folder / f"{name}.parquet")


def flat(matrix):
    return types.Transform(transform=[value for row in matrix for value in row])


boxes, images, poses, cameras = [], [], [], []
for camera in scene["cameras"]:
    fx, fy, cx, cy = camera["matrix"]
    lens = dict(zip(("k1", "k2", "p1", "p2", "k3"), camera["lens"]))
    key = base.SegmentCameraKey(segment_context_name=name, camera_name=camera["number"])
    intrinsic = context.Intrinsic(f_u=fx, f_v=fy, c_u=cx, c_v=cy, **lens)
    cameras.append(
        context.CameraCalibrationComponent(
            key=key,
            intrinsic=intrinsic,
            extrinsic=flat(camera["pose"]),
            width=scene["width"],
            height=scene["height"],
            rolling_shutter_direction=5,
        )
    )
for frame in scene["frames"]:
    key = base.FrameKey(segment_context_name=name, frame_timestamp_micros=frame["micros"])
    poses.append(pose.VehiclePoseComponent(key=key, world_from_vehicle=flat(frame["pose"])))
    for item in frame["boxes"]:
        key = base.LaserLabelKey(
            segment_context_name=name, frame_timestamp_micros=frame["micros"], laser_object_id=item["name"]
        )
        place, size = (types.Vec3d(*item[part]) for part in ("place", "size"))
        boxes.append(
            box.LiDARBoxComponent(
                key=key,
                box=types.Box3d(center=place, size=size, heading=item["heading"]),
                type=1,
                num_lidar_points_in_box=9,
                num_top_lidar_points_in_box=5,
            )
        )
    for camera in scene["cameras"]:
        zero = dict.fromkeys("xyz", 0.0)
        images.append(
            camera_image.CameraImageComponent(
                key=base.CameraKey(
                    segment_context_name=name, frame_timestamp_micros=frame["micros"], camera_name=camera["number"]
                ),
                image=bytes.fromhex(scene["image"]),
                pose=flat(frame["image_pose"]),
                velocity=camera_image.Velocity(
                    linear_velocity=types.Vec3s(**zero), angular_velocity=types.Vec3d(**zero)
                ),
                pose_timestamp=frame["micros"] * 1e-6,
                rolling_shutter_params=camera_image.RollingShutterParams(
                    shutter=0.0, camera_trigger_time=0.0, camera_readout_done_time=0.0
                ),
            )
        )
write("lidar_box", boxes)
write("camera_image", images)
write("vehicle_pose", poses)
write("camera_calibration", cameras)
