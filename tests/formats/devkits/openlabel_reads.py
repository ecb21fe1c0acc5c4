"""What vcd reads of a file of OpenLABEL: FILE."""

import json
import sys

from vcd import core, utils

labels = core.OpenLABEL()
labels.load_from_file(sys.argv[1], validation=True)
(cuboid,) = (labels.get_object_data("7", "shape3D", frame_num=0)["val"],)
corners = utils.generate_cuboid_points_ref_4x8(cuboid)[:3, [1, 0, 5, 4, 2, 3, 6, 7]].T
frame = labels.get_frame(0)
place = frame["frame_properties"]["transforms"]["camera_to_world"]["transform_src_to_dst"]["matrix4x4"]
intervals = labels.get_frame_intervals().get_dict()
found = {
    "corners": corners.tolist(),
    "transform": [place[i : i + 4] for i in (0, 4, 8, 12)],
    "points": frame["objects"]["7"]["object_data"]["point2d"],
    "frames": [intervals[0]["frame_start"], intervals[-1]["frame_end"]],
}
json.dump(found, sys.stdout)
