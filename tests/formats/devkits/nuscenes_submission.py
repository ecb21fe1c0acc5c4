"""What nuscenes-devkit reads of a submission: FILE nuscenes|nuscenes_tracking."""

import json
import sys
from pathlib import Path

from nuscenes.eval.common.data_classes import EvalBoxes
from nuscenes.utils.data_classes import Box
from pyquaternion import Quaternion

ORDER = [6, 7, 5, 4, 2, 3, 1, 0]
if sys.argv[2] == "nuscenes":
    from nuscenes.eval.detection.data_classes import DetectionBox as Kind
else:
    from nuscenes.eval.common.config import config_factory
    from nuscenes.eval.tracking.data_classes import TrackingBox as Kind

    config_factory("tracking_nips_2019")  # the names of the classes are known from then on
boxes = EvalBoxes.deserialize(json.loads(Path(sys.argv[1]).read_text())["results"], Kind)
corners = [Box(b.translation, b.size, Quaternion(b.rotation)).corners()[:, ORDER].T.tolist() for b in boxes.all]
json.dump({"samples": sorted(boxes.sample_tokens), "corners": corners}, sys.stdout)
