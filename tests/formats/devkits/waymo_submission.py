"""What waymo-open-dataset reads of `Objects`, and how it scores them against themselves: FILE."""

import json
import os
import sys
from pathlib import Path

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
import numpy as np
import tensorflow as tf
from google.protobuf import text_format
from waymo_open_dataset.metrics.python.wod_detection_evaluator import WODDetectionEvaluator
from waymo_open_dataset.protos import metrics_pb2
from waymo_open_dataset.utils import box_utils

objects = metrics_pb2.Objects.FromString(Path(sys.argv[1]).read_bytes()).objects
numbers = ("center_x", "center_y", "center_z", "length", "width", "height", "heading")
boxes = np.array([[getattr(one.object.box, name) for name in numbers] for one in objects])
corners = box_utils.get_upright_3d_box_corners(tf.constant(boxes)).numpy()[:, [2, 1, 6, 5, 3, 0, 7, 4]]
config = metrics_pb2.Config()
text_format.Parse(
    "breakdown_generator_ids: ONE_SHARD difficulties { } matcher_type: TYPE_HUNGARIAN iou_thresholds: 0.7 "
    "iou_thresholds: 0.7 iou_thresholds: 0.7 iou_thresholds: 0.7 iou_thresholds: 0.7 box_type: TYPE_3D "
    "num_desired_score_cutoffs: 11",
    config,
)
evaluator, count = WODDetectionEvaluator(config), len(objects)
scored = {}
for name, turn in (("same", 0.0), ("flipped", np.pi)):
    truth = np.add(boxes, [0, 0, 0, 0, 0, 0, turn])
    frames, kinds = tf.zeros(count, tf.int64), tf.constant([one.object.type for one in objects], tf.uint8)
    evaluator.update_state(
        {
            "ground_truth_frame_id": frames,
            "ground_truth_bbox": tf.constant(truth, tf.float32),
            "ground_truth_type": kinds,
            "ground_truth_difficulty": tf.ones(count, tf.uint8),
        },
        {
            "prediction_frame_id": frames,
            "prediction_bbox": tf.constant(boxes, tf.float32),
            "prediction_type": kinds,
            "prediction_score": tf.constant([one.score for one in objects]),
            "prediction_overlap_nlz": tf.zeros(count, tf.bool),
        },
    )
    result = evaluator.result()
    scored[name] = [float(result.average_precision[0]), float(result.average_precision_ha_weighted[0])]
about = [[one.object.id, one.object.type, one.score, one.context_name, one.frame_timestamp_micros] for one in objects]
json.dump({"corners": corners.tolist(), "about": about, "scored": scored}, sys.stdout)
