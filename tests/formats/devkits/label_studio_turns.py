"""Where Label Studio's own library has the corners of a turned rectangle: < JSON of a region's value and image size."""

import json
import sys

from label_studio_sdk.converter.utils import convert_annotation_to_yolo_obb

json.dump(convert_annotation_to_yolo_obb(json.load(sys.stdin), normalize=False), sys.stdout)
