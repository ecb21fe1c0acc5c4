"""What vcd reads of a file of OpenLABEL, validated, and writes again: FILE OUT."""

import json
import sys

from vcd import core, utils

labels = core.OpenLABEL()
labels.load_from_file(sys.argv[1], validation=True)
found, places = {}, {}
for number, frame in labels.data["openlabel"]["frames"].items():
    about = frame["frame_properties"]
    image, vehicles = about["streams"]["camera"]["uri"], []
    for name in frame.get("objects", {}):
        number_of = int(number)
        cuboid = labels.get_object_data(name, "shape3D", frame_num=number_of)["val"]
        u, v, width, height = labels.get_object_data(name, "shape", frame_num=number_of)["val"]
        points = labels.get_frame(number_of)["objects"][name]["object_data"]["point2d"]
        vehicles.append(
            {
                "name": name,
                "kind": labels.get_object(name)["type"],
                "box": [u - width / 2, v - height / 2, u + width / 2, v + height / 2],
                "corners": utils.generate_cuboid_points_ref_4x8(cuboid)[:3, [1, 0, 5, 4, 2, 3, 6, 7]].T.tolist(),
                "points": {point["name"]: point["val"] for point in points},
                "hidden": [not point["attributes"]["boolean"][0]["val"] for point in points],
                "score": labels.get_object_data(name, "confidence", frame_num=number_of)["val"],
            }
        )
    found[image] = vehicles
    if "transforms" in about:
        places[image] = about["transforms"]["camera_to_world"]["transform_src_to_dst"]["matrix4x4"]
labels.save(sys.argv[2], validate=True)
intervals = labels.get_frame_intervals().get_dict()
frames = [intervals[0]["frame_start"], intervals[-1]["frame_end"]]
json.dump({"images": found, "places": places, "frames": frames}, sys.stdout)
