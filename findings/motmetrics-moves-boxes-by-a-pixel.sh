#!/usr/bin/env bash
# motmetrics 1.4.0, io.loadtxt of MOT's lines: one is taken off x and y, as from files for Matlab.
#
# Guess: a box that is written at x = 10 is read at x = 10.
# Seen: at 9 (and y = 20 at 19). Two files that were both read so agree; one of them beside boxes from anywhere else (a
# detector in Python counts from 0) is a pixel off, which costs boxes of 20 pixels a fifth of their overlap.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet motmetrics==1.4.0 numpy==1.26.4 pandas==2.2.3
env/bin/python - <<'PYTHON'
import motmetrics

open("found.txt", "w").write("1,1,10,20,20,20,0.9,-1,-1,-1\n")
row = motmetrics.io.loadtxt("found.txt", fmt="mot15-2D").iloc[0]
print("x", row["X"], "y", row["Y"], "width", row["Width"])
assert (row["X"], row["Y"], row["Width"], row["Height"]) == (9, 19, 20, 20)
overlap = 19 * 19 / (2 * 400 - 19 * 19)
print("overlap of a box of 20 pixels with itself, a pixel off:", round(overlap, 2))
PYTHON
