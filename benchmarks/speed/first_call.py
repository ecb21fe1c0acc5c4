"""The first `fgrecon.reconstruct` of a process: started as a file, with a file of cases whose first it solves."""

import json
import sys
from pathlib import Path

import fgrecon

case = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))[0]
fgrecon.reconstruct(
    case["keypoints"],
    case["camera"],
    confidence=case["confidence"],
    box=case["box"],
    ground=case["ground"],
    size_prior=case["size"],
)
