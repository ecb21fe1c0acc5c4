"""What nuscenes-devkit or truckscenes-devkit makes of tables: run in its own environment, FOLDER [trucks]."""

import json
import sys

import numpy as np

root, trucks = sys.argv[1], len(sys.argv) > 2
if trucks:
    from truckscenes import TruckScenes as DataSet
    from truckscenes.utils.geometry_utils import BoxVisibility, view_points
else:
    from nuscenes import NuScenes as DataSet
    from nuscenes.utils.geometry_utils import BoxVisibility, view_points

ORDER = [6, 7, 5, 4, 2, 3, 1, 0]
"""Of the devkit's corners: rear before front, bottom before top, right before left, as fgrecon has them."""
data = DataSet("v1.0-mini", root, verbose=False)
found = {"corners": {}, "images": {}}
for label in data.sample_annotation:
    found["corners"][label["token"]] = data.get_box(label["token"]).corners()[:, ORDER].T.tolist()
for shot in data.sample_data:
    if shot["fileformat"] == "jpg" and shot["is_key_frame"]:
        _, boxes, matrix = data.get_sample_data(shot["token"], box_vis_level=BoxVisibility.NONE)
        seen = {}
        for box in boxes:
            corners = box.corners()[:, ORDER]
            pixels = view_points(corners, matrix, normalize=True)[:2]
            seen[box.token] = {
                "corners": corners.T.tolist(),
                "pixels": np.where(corners[2] > 0.1, pixels, 0.0).T.tolist(),
            }
        found["images"][shot["token"]] = seen
json.dump(found, sys.stdout)
