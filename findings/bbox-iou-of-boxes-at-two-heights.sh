#!/usr/bin/env bash
# bbox 0.9.4, metrics.iou_3d (jaccard_index_3d) of two BBox3D, which are given by their centres.
#
# Guess: the volume in both by the volume in either, as long as the boxes turn about z alone, which its docstring asks for.
# Seen: along z a box is taken to reach from its centre down by its whole height, half a height too low. Boxes on one floor, or of one height,
# agree by chance; otherwise not: a sign of 1 m that fills the upper half of a box of 2 m has 0.2 instead of 0.5, and a box that stands on
# the roof of another 0.33 instead of 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet bbox==0.9.4 numpy==1.26.4
env/bin/python -W ignore - <<'PYTHON'
import numpy as np
from bbox import BBox3D
from bbox.metrics import iou_3d


def box(bottom, height):
    """A box of 4 x 2 m over the origin."""
    return BBox3D(0, 0, bottom + height / 2, length=4, width=2, height=height)


def heights(first, second):
    """IoU of two such boxes, from the intervals along z."""
    shared = max(0.0, min(first[0] + first[1], second[0] + second[1]) - max(first[0], second[0]))
    return shared / (first[1] + second[1] - shared)


cases = {
    "on one floor": ((0, 2), (0, 1), 0.5),
    "of one height": ((0, 2), (1, 2), 1 / 3),
    "the upper half": ((0, 2), (1, 1), 0.2),
    "on the roof": ((0, 1), (1, 3), 1 / 3),
    "from half of it up": ((0, 2), (1, 3), 3 / 7),
}
for name, (first, second, expected) in cases.items():
    told, corners = iou_3d(box(*first), box(*second)), box(*second).p[:, 2]
    assert np.isclose(corners.min(), second[0]) and np.isclose(corners.max(), sum(second))  # the corners are where they belong
    print(f"{name}: told {told}, is {heights(first, second):.3f}")
    assert abs(told - expected) < 1e-4
PYTHON
