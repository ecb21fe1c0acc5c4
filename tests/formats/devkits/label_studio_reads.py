"""What Label Studio's own converter makes of tasks, and its library writes again: FILE OUT NAMES KINDS.

Predictions must be valid for the controls; they are taken as accepted.
"""

import json
import sys
import tempfile
from pathlib import Path

from label_studio_sdk.converter import Converter
from label_studio_sdk.label_interface import LabelInterface
from label_studio_sdk.label_interface.objects import PredictionValue, TaskValue

tasks = json.loads(Path(sys.argv[1]).read_text())
names, kinds = ("".join(f'<Label value="{name}"/>' for name in words.split(",")) for words in sys.argv[3:5])
config = (
    f'<View><Image name="image" value="$image"/><RectangleLabels name="box" toName="image">{kinds}</RectangleLabels>'
    f'<KeyPointLabels name="keypoint" toName="image">{names}</KeyPointLabels></View>'
)
interface = LabelInterface(config)
found, again = {}, []
for task in tasks:
    (made,) = task["predictions"]
    assert interface.validate_prediction(made)
    accepted = {**task, "annotations": [{"id": 1, "completed_by": 1, "result": made["result"]}], "predictions": []}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tasks.json"
        file.write_text(json.dumps([accepted]))
        Converter(config, folder, download_resources=False).convert_to_json_min(str(file), folder, is_dir=False)
        (plain,) = json.loads((Path(folder) / "result.json").read_text())
    found[task["data"]["image"]] = plain
    value = TaskValue(data=task["data"], predictions=[PredictionValue(**made)]).model_dump()
    again.append({"id": task["id"], "data": value["data"], "annotations": value["predictions"]})
Path(sys.argv[2]).write_text(json.dumps(again))
json.dump(found, sys.stdout)
