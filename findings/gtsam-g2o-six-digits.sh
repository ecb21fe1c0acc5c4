#!/usr/bin/env bash
# gtsam 4.3.0, writeG2o(graph, values, file): numbers are written with six significant digits.
#
# Guess: poses that are written and read again are what they were, at least to the precision of their noise models.
# Seen: of a pose in UTM coordinates, (456789.123, 5412345.678), four metres are lost, and two poses that are 1.2 m apart come back
# at one place while the edge between them still says 1.2 m. In local coordinates half a centimetre is lost a few kilometres out.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet gtsam==4.3.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import gtsam
import numpy as np


def lost(*places):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, place in enumerate(places):
        values.insert(key, gtsam.Pose3(gtsam.Rot3(), np.array(place)))
    step = values.atPose3(0).between(values.atPose3(1))
    graph.add(gtsam.BetweenFactorPose3(0, 1, step, gtsam.noiseModel.Isotropic.Sigma(6, 0.01)))
    gtsam.writeG2o(graph, values, "drive.g2o")
    read, again = gtsam.readG2o("drive.g2o", True)
    places_again = [again.atPose3(key).translation() for key in range(len(places))]
    return np.linalg.norm(np.subtract(places_again, places), axis=1), places_again


utm, (first, second) = lost((456789.123, 5412345.678, 300.12), (456789.123, 5412346.9, 300.12))
local, _ = lost((4567.896, 1234.564, 0.0), (4569.0, 1234.564, 0.0))
print("lost in UTM:", utm.round(2), "m, of the two places", first, second, "; lost in local coordinates:", local.round(4), "m")
assert 4.0 < utm[0] < 5.0 and np.array_equal(first, second)
assert 0.004 < local[0] < 0.006
PYTHON
