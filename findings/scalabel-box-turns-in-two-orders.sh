#!/usr/bin/env bash
# scalabel 0.3.1, Box3D.orientation: three turns of a box, "stored as axis angles" says the viewer that draws it.
#
# Guess: the viewer and the writer of nuScenes' results, both of this package, turn a box alike.
# Seen: the viewer turns about y, then z, then x; the writer takes the same three for x, then y, then z of the turned box. Boxes that
# turn about one axis, as upright vehicles do, are the same; one that leans by 0.1 and 0.2 rad beside a turn of 0.7 is 7.8 degrees off.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet scalabel==0.3.1 scipy==1.16.3
env/bin/python - <<'PYTHON'
import inspect

import numpy as np
from scalabel.label import to_nuscenes
from scalabel.label.typing import Box3D
from scalabel.vis.geometry import Label3d
from scipy.spatial.transform import Rotation

assert '"XYZ", label.box3d.orientation' in inspect.getsource(to_nuscenes)  # how the writer turns


def drawn(turns):
    box = Box3D(alpha=0.0, orientation=turns, location=(0.0, 0.0, 0.0), dimension=(2.0, 2.0, 2.0))
    v000, v001, v010, _, v100, *_ = (np.array(v) for v in Label3d.from_box3d(box).vertices)
    return np.stack([(v100 - v000) / 2, (v010 - v000) / 2, (v001 - v000) / 2], axis=1)


def off(turns):
    return np.degrees((Rotation.from_matrix(drawn(turns)).inv() * Rotation.from_euler("XYZ", turns)).magnitude())


print("about y alone:", round(off((0.0, 0.7, 0.0)), 6), "degrees; leaning:", round(off((0.1, 0.7, 0.2)), 3))
assert off((0.0, 0.7, 0.0)) < 1e-6 and 7.8 < off((0.1, 0.7, 0.2)) < 7.9
PYTHON
