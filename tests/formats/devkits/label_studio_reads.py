"""Whether Label Studio's own library takes tasks with predictions: FILE, NAMES of keypoints, KINDS."""

import json
import sys
from pathlib import Path

from label_studio_sdk.label_interface import LabelInterface

tasks = json.loads(Path(sys.argv[1]).read_text())
names, kinds = ("".join(f'<Label value="{name}"/>' for name in words.split(",")) for words in sys.argv[2:4])
config = LabelInterface(
    f'<View><Image name="image" value="$image"/><RectangleLabels name="box" toName="image">{kinds}</RectangleLabels>'
    f'<KeyPointLabels name="keypoint" toName="image">{names}</KeyPointLabels></View>'
)
found = [[config.validate_prediction(one) for one in task["predictions"]] for task in tasks]
json.dump(found, sys.stdout)
