"""What ultralytics and torchvision make of numbers: run in their own environment, < JSON with points, trust, box."""

import json
import sys

import numpy as np
import torch
from ultralytics.engine.results import Results

given = json.load(sys.stdin)
points, trust = torch.tensor(given["points"]), torch.tensor(given["trust"])
found = Results(
    np.zeros((375, 1242, 3), np.uint8),
    "a/street.jpg",
    {2: "car"},
    boxes=torch.tensor([[*given["box"], 7.0, 0.9, 2.0]]),
    keypoints=torch.cat([points, trust[..., None]], dim=2),
)
found.save_txt("scored.txt", save_conf=True)
found.save_txt("plain.txt")
json.dump({"to_json": json.loads(found.to_json()), "summary": found.summary()}, sys.stdout)
