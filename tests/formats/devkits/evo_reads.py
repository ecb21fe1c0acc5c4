"""What evo reads of poses: FILE tum|kitti_poses."""

import json
import sys

from evo.tools import file_interface

read = file_interface.read_tum_trajectory_file if sys.argv[2] == "tum" else file_interface.read_kitti_poses_file
poses = read(sys.argv[1])
valid, details = poses.check()
json.dump({"valid": bool(valid), "details": details, "poses": [p.tolist() for p in poses.poses_se3]}, sys.stdout)
