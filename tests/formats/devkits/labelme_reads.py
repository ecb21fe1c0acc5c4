"""What labelme reads of a file beside its image, and writes again: FILE OUT. What draws windows is not installed."""

import json
import sys
from unittest.mock import MagicMock

sys.modules |= {name: MagicMock() for name in ("onnxruntime", "imgviz", "imgviz.io", "PyQt5")}
from labelme import _label_file  # noqa: E402 - after what stands in

label = _label_file.read_label_file(sys.argv[1])
vehicles = {}
for one in label.shapes:
    about = vehicles.setdefault(one["group_id"], {"points": {}, "hidden": []})
    if one["shape_type"] == "rectangle":
        about |= {"kind": one["label"], "box": [value for point in one["points"] for value in point]}
    else:
        about["points"][one["label"]] = one["points"][0]
        about["hidden"].append(one["flags"]["hidden"])
shapes = [{k: v for k, v in one.items() if k not in ("mask", "other_data")} for one in label.shapes]
_label_file.write_label_file(
    filename=sys.argv[2],
    shapes=shapes,
    image_path=label.image_path,
    image_height=None,
    image_width=None,
    image_data=None,
)
json.dump({label.image_path: list(vehicles.values())}, sys.stdout)
