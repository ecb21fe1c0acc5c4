"""Results as files for other programs: meshes (PLY, GLB), tables (CSV, Parquet) and KITTI's result lines.

`export` chooses by the ending of the name; `read_results` reads what `fgrecon reconstruct --json`, `fgrecon demo` and
`fgrecon track --json` write. trimesh and pyarrow are imported on use. Keypoint labels have a file of their own, COCO's:
`write_coco_keypoints` and `read_coco_keypoints`.
"""

from fgrecon.io.export.coco_keypoints import read_coco_keypoints, write_coco_keypoints
from fgrecon.io.export.files import FORMATS, export
from fgrecon.io.export.results import NamedResult, read_results

__all__ = ["FORMATS", "NamedResult", "export", "read_coco_keypoints", "read_results", "write_coco_keypoints"]
