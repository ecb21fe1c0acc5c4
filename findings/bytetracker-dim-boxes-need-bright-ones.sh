#!/usr/bin/env bash
# bytetracker 0.3.2, BYTETracker.update(detections, image): boxes of low score (0.1 to track_thresh) go on with tracks that no box of high score fits.
#
# Guess: this is what ByteTrack is for: a car that goes into the shade, found at 0.3 for some frames, keeps its track.
# Seen: the classes of the low ones are taken from the high ones, and low boxes beyond as many as there are of these are dropped, without a word. The
# car keeps its track only while other cars are found at a high score anywhere in the image, each of which saves one; alone it is lost
# at once. BoxMOT, where the code comes from, has mended the index in its pull request 621 of 2022.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet numpy==2.3.5 scipy==1.16.3 lap==0.5.12
env/bin/pip install --quiet --no-deps bytetracker==0.3.2
env/bin/python - <<'PYTHON'
import sys
import types

import numpy as np

sys.modules["torch"] = types.SimpleNamespace(Tensor=type("Tensor", (), {}))  # the tracker asks for the type and calls numpy(), no more
from bytetracker import BYTETracker


class Detections(np.ndarray):
    """An array with the one method of a tensor that the tracker calls."""

    def numpy(self):
        return np.asarray(self)


def kept(bright, dim):
    """How many of the dim cars have a track in each of 8 frames of which they are in the shade for the last 5."""
    tracker, counts = BYTETracker(track_thresh=0.5), []
    for frame in range(8):
        rows = []
        for car in range(bright + dim):
            left = 200 * car + 3 * frame
            rows.append([left, 100, left + 80, 150, 0.3 if car >= bright and frame > 2 else 0.9, 2])
        tracks = tracker.update(np.array(rows, float).view(Detections), None)
        counts.append(sum(int(track[0] > 200 * bright - 50) for track in tracks))
    return counts


for bright, dim in ((0, 1), (1, 1), (1, 3), (2, 3), (3, 3)):
    counts = kept(bright, dim)
    print(f"{dim} cars go into the shade, {bright} stay in the sun: tracks of the dim ones, frame by frame: {counts}")
    assert counts[:3] == [dim] * 3 and counts[3:] == [min(bright, dim)] * 5
PYTHON
