"""What ZOD's devkit makes of a folder: run in its own environment, FOLDER. It has no corners in the world."""

import json
import sys
from pathlib import Path

import numpy as np
from zod import ZodFrames
from zod.constants import AnnotationProject, Anonymization, Camera, Lidar

ORDER = [0, 3, 4, 7, 1, 2, 5, 6]  # rear before front, bottom before top, right before left
found = {"corners": {}, "images": {}, "points": {}}
for frame in ZodFrames(sys.argv[1], "mini"):
    calib, time = frame.calibration, frame.info.keyframe_time.timestamp()
    place = frame.ego_motion.get_poses(time) @ calib.lidars[Lidar.VELODYNE].extrinsics.transform
    seen_by = np.linalg.inv(calib.cameras[Camera.FRONT].extrinsics.transform)
    (scan,) = frame.get_lidar()
    scan.transform(seen_by @ calib.lidars[Lidar.VELODYNE].extrinsics.transform)
    for label in frame.get_annotation(AnnotationProject.OBJECT_DETECTION):
        box = label.box3d
        if box is None:
            continue
        found["corners"][label.uuid] = (box.corners[ORDER] @ place[:3, :3].T + place[:3, 3]).tolist()
        box.convert_to(Camera.FRONT, calib)
        seen = {"corners": box.corners[ORDER].tolist(), "pixels": box.project_into_camera(calib)[1:][ORDER].tolist()}
        assert label.subclass == "Vehicle_Car"
        for way in (Anonymization.BLUR, Anonymization.DNAT):
            name = f"front_{way.value}/{Path(frame.info.get_key_camera_frame(way).filepath).stem}"
            found["images"].setdefault(name, {})[label.uuid] = seen
            found["points"][name] = scan.points.tolist()
json.dump(found, sys.stdout)
