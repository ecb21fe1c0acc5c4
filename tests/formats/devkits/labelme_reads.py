"""What labelme reads of its file beside an image: FILE. What draws its windows is not installed."""

import json
import sys
from unittest.mock import MagicMock

sys.modules |= {name: MagicMock() for name in ("onnxruntime", "imgviz", "imgviz.io", "PyQt5")}

from labelme._label_file import read_label_file  # noqa: E402 - after what stands in

found = read_label_file(sys.argv[1])
shapes = [{key: one[key] for key in ("label", "points", "shape_type", "flags", "group_id")} for one in found.shapes]
json.dump({"image": found.image_path, "shapes": shapes}, sys.stdout)
