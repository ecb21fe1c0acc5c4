"""Results as files for other programs: meshes, tables, results of KITTI, nuScenes and COCO, messages in MCAP.

`export` chooses by the ending of the name; `read_results` reads what `fgrecon reconstruct --json`, `fgrecon demo` and
`fgrecon track --json` write, `read_video_frames` the frames of `fgrecon run`. trimesh, pyarrow and mcap are imported on
use. `read_images_file` reads what other programs want to know of the images.
"""

from fgrecon.io.export.formats import FORMATS, KINDS, export
from fgrecon.io.export.image_info import ImageInfo, read_images_file
from fgrecon.io.export.results import NamedResult, read_results
from fgrecon.io.export.video_frames import read_video_frames

__all__ = [
    "FORMATS",
    "KINDS",
    "ImageInfo",
    "NamedResult",
    "export",
    "read_images_file",
    "read_results",
    "read_video_frames",
]
