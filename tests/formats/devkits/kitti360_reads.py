"""What kitti360scripts makes of its folder: run in its own environment, FOLDER.

It has no vertices of boxes by name: they are distinguished by where they lie in the unit box, which its files have. Its
pixels are rounded to whole ones: those before are made from its points and its matrix.
"""

import io
import json
import sys
from contextlib import redirect_stdout

import numpy as np

from kitti360scripts.devkits.commons.loadCalibration import loadCalibrationCameraToPose, loadCalibrationRigid
from kitti360scripts.helpers.annotation import Annotation3D
import yaml

from kitti360scripts.helpers.project import CameraFisheye, CameraPerspective

with_loader = yaml.load
yaml.load = lambda text: with_loader(text, yaml.SafeLoader)  # it calls it as yaml 5 has it

root, name = sys.argv[1], "2013_05_28_drive_0000_sync"
with redirect_stdout(io.StringIO()):
    labels = Annotation3D(f"{root}/data_3d_bboxes", name)
found = {"corners": {}, "images": {}, "points": {}}
mounts = loadCalibrationCameraToPose(f"{root}/calibration/calib_cam_to_pose.txt")
velo = loadCalibrationRigid(f"{root}/calibration/calib_cam_to_velo.txt") @ np.linalg.inv(mounts["image_00"])
for camera in range(4):
    lens = (CameraPerspective if camera < 2 else CameraFisheye)(root, name, camera)
    for frame in (7, 8):
        seen = {}
        for by_time in labels.objects.values():
            for time, box in by_time.items():
                if time not in (-1, frame):
                    continue
                unit = np.linalg.solve(box.R, (box.vertices - box.T).T).T
                ours = [(x, y, z) for x in (-1, 1) for z in (-1, 1) for y in (-1, 1)]
                corners = np.array(
                    [
                        box.vertices[int(np.argmin(np.abs(np.sign(unit) - np.array([x, y, z])).sum(1)))]
                        for x, y, z in ours
                    ]
                )
                place = lens.cam2world[frame]
                points = lens.world2cam(corners, place[:3, :3], place[:3, 3], inverse=True)  # (3, 8)
                pixels = np.array(lens.cam2image(points.copy())[:2]).T
                ahead = points[2] > 0.1
                if camera < 2:
                    whole, exact = pixels, lens.K[:3, :3] @ points  # it rounds to whole pixels
                    pixels = (exact[:2] / exact[2]).T
                    assert np.abs(whole - pixels)[ahead].max(initial=0.0) <= 0.5
                key = f"object{box.annotationId - 1}@{frame}"
                found["corners"][key] = corners.tolist()
                seen[key] = {"corners": points.T.tolist(), "pixels": np.where(ahead[:, None], pixels, 0.0).tolist()}
        found["images"][f"image_{camera:02d}/{frame:010d}"] = seen
        scan = np.fromfile(f"{root}/data_3d_raw/{name}/velodyne_points/data/{frame:010d}.bin", np.float32).reshape(
            -1, 4
        )
        points = (np.linalg.inv(velo @ mounts[f"image_{camera:02d}"]) @ np.c_[scan[:, :3], np.ones(len(scan))].T)[:3]
        turned = lens.R_rect[:3, :3] @ points if camera < 2 else points  # as its viewer does
        found["points"][f"image_{camera:02d}/{frame:010d}"] = turned.T.tolist()
json.dump(found, sys.stdout)
