"""What nuscenes-devkit or truckscenes-devkit reads of a submission, and how it scores it against itself: FILE KIND."""

import json
import sys
from importlib import import_module

from nuscenes.utils.data_classes import Box
from pyquaternion import Quaternion

ORDER = [6, 7, 5, 4, 2, 3, 1, 0]
kit, task = "truckscenes" if sys.argv[2] == "truckscenes" else "nuscenes", "detection"
if sys.argv[2] == "nuscenes_tracking":
    from nuscenes.eval.common.config import config_factory
    from nuscenes.eval.tracking.data_classes import TrackingBox as Kind

    config_factory("tracking_nips_2019")  # the names of the classes are known from then on
    task = "tracking"
else:
    Kind = import_module(f"{kit}.eval.detection.data_classes").DetectionBox
boxes, meta = import_module(f"{kit}.eval.common.loaders").load_prediction(sys.argv[1], 500, Kind)
corners = [Box(b.translation, b.size, Quaternion(b.rotation)).corners()[:, ORDER].T.tolist() for b in boxes.all]
found = {"samples": sorted(boxes.sample_tokens), "corners": corners, "meta": meta}
if task == "detection":
    algo, utils = (import_module(f"{kit}.eval.{name}") for name in ("detection.algo", "common.utils"))
    said = algo.accumulate(boxes, boxes, "car", utils.center_distance, 2.0)
    found["scored"] = {"mAP": float(algo.calc_ap(said, 0.1, 0.1)), "mAOE": float(algo.calc_tp(said, 0.1, "orient_err"))}
json.dump(found, sys.stdout)
