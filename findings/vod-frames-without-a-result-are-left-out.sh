#!/usr/bin/env bash
# vod-tudelft 1.0.3 (View of Delft), vod.evaluation.Evaluation(labels).evaluate(results): two folders of KITTI's text files.
#
# Guess: frames that have labels and no file of results, since nothing was found there, count as frames in which everything was missed.
# Seen: the frames to look at are those of the results' folder: what a detector says nothing of is not asked for. With the first half of 200 cars
# found, an empty file for each other frame makes 55, no file 100. Of two detectors the one that leaves out empty files is the better one,
# and so is one that stopped halfway. A file of results without labels beside it is an error, so that it is the labels that look checked.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 numba==0.63.1 matplotlib==3.10.7
env/bin/pip install --quiet --no-deps vod-tudelft==1.0.3
env/bin/python -W ignore - <<'PYTHON'
import contextlib
import io
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np

sys.modules["k3d"] = sys.modules["k3d.plot"] = MagicMock()  # draws in notebooks
from vod.evaluation import Evaluation

rng = np.random.default_rng(0)
for folder in ("labels", "empty", "none"):
    Path(folder).mkdir()
for frame, score in enumerate(rng.permutation(np.linspace(0.5, 0.9, 200))):  # one car in each frame, those of the first half are found
    x, z, turn = rng.uniform([-3, 8, -3], [3, 20, 3])
    line, name = f"Car 0 0 0 100 100 200 200 1.5 1.8 4.2 {x:.3f} 1.6 {z:.3f} {turn:.3f}", f"{frame:05}.txt"
    Path("labels", name).write_text(line + "\n")
    Path("empty", name).write_text(f"{line} {score:.5f}\n" if frame < 100 else "")
    if frame < 100:
        Path("none", name).write_text(f"{line} {score:.5f}\n")
told = {}
for folder in ("empty", "none"):
    with contextlib.redirect_stdout(io.StringIO()):
        told[folder] = Evaluation("labels").evaluate(folder, [0])["entire_area"]["Car_3d_all"]
    print(f"half of 200 cars found, {folder} files for the other frames: average precision {told[folder]:.2f}")
assert abs(told["empty"] - 54.55) < 0.01 and abs(told["none"] - 100) < 0.01
PYTHON
