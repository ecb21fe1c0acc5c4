"""What av2 reads of a file of detections: FILE."""

import json
import sys
from pathlib import Path

from av2.evaluation.detection.constants import HIERARCHY
from av2.structures.cuboid import CuboidList
from av2.utils.io import read_feather

path = Path(sys.argv[1])
table = read_feather(path)
needed = {"log_id", "timestamp_ns", "category", "score", "length_m", "width_m", "height_m", "tx_m", "ty_m", "tz_m"}
assert needed <= set(table.columns)
assert set(table["category"]) <= set(HIERARCHY["FINEGRAIN"])
corners = [cuboid.vertices_m[[6, 7, 5, 4, 2, 3, 1, 0]].tolist() for cuboid in CuboidList.from_feather(path)]
json.dump({"corners": corners}, sys.stdout)
