#!/usr/bin/env bash
# pyransac3d 0.7.0, Cylinder().fit(points, thresh, maxIteration): points all around a pole with half a centimetre of noise, no outliers.
#
# Guess: a few of 2000 random samples give the pole, as Plane, Sphere and Line find theirs.
# Seen: three points are drawn, the normal of their plane is taken for the axis and their circle for the section. That is the cylinder only if
# the three lie at one height, which of a pole 10 m long hardly ever happens: the axis lies across the pole, and the radius of 0.3 m becomes
# a hundred metres, without a word but few inliers; at 3 m the axis is 10 degrees off. Of one as long as it is thick it is right. The project's
# issue 13 calls the fit unstable; its pull request 42 measured it on a cylinder twice as long as thick.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pyransac3d==0.7.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import random

import numpy as np
import pyransac3d

RADIUS = 0.3  # m
for length in (0.6, 3.0, 10.0):
    tilts, radii, shares = [], [], []
    for seed in range(3):
        random.seed(seed)
        rng = np.random.default_rng(seed)
        around, height = rng.uniform(0, 2 * np.pi, 600), rng.uniform(0, length, 600)
        points = np.stack([RADIUS * np.cos(around), RADIUS * np.sin(around), height], axis=1) + rng.normal(0, 0.005, (600, 3))
        cylinder = pyransac3d.Cylinder().fit(points, thresh=0.03, maxIteration=2000)
        tilts.append(np.degrees(np.arccos(abs(cylinder.axis[2]))))
        radii.append(cylinder.radius)
        shares.append(len(cylinder.inliers) / len(points))
    print(f"{length} m long: axis off by {np.round(tilts, 1)} degrees, radii {np.round(radii, 2)} m, inliers {np.round(shares, 2)}")
    if length < 1:
        assert max(tilts) < 10 and max(np.abs(np.array(radii) - RADIUS)) < 0.02 and min(shares) > 0.9
    if length == 10:
        assert min(tilts) > 45 and min(radii) > 10 * RADIUS and max(shares) < 0.4
PYTHON
