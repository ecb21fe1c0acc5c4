#!/usr/bin/env bash
# g2o-python 0.0.12 and gtsam 4.3.0: a pose graph in g2o's format (EDGE_SE3:QUAT), its edge made in g2o and read by gtsam.readG2o(file, True).
#
# Guess: the edge has the same error in both, as its measurement and its information matrix stand in the file.
# Seen: of a shift it has, a rotation counts four times as much in gtsam. g2o's error is the vector part of a quaternion, half the angle, and so are the
# units of its information (its maintainer answered so in an issue; the format has no other description); gtsam takes the numbers for 1 / rad^2 and
# writes its own as such. A loop of which the two disagree closes elsewhere: who goes from one to the other has to multiply, or divide, by 4.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv g2o && g2o/bin/pip install --quiet g2o-python==0.0.12 numpy==1.26.4
python3 -m venv gtsam && gtsam/bin/pip install --quiet gtsam==4.3.0 numpy==2.3.5
python3 - <<'PYTHON'
from math import cos, sin

information = " ".join("400" if row == column else "0" for row in range(6) for column in range(row, 6))
for name, measured in {"turn": [0, 0, 0, sin(0.05), 0, 0, cos(0.05)], "shift": [0.1, 0, 0, 0, 0, 0, 1]}.items():
    with open(f"{name}.g2o", "w") as file:  # both vertices at the origin; 0.1 rad, or 0.1 m, between them
        file.writelines(f"VERTEX_SE3:QUAT {vertex} 0 0 0 0 0 0 1\n" for vertex in range(2))
        file.write(f"EDGE_SE3:QUAT 0 1 {' '.join(map(str, measured))} {information}\n")
PYTHON
g2o/bin/python - <<'PYTHON'
import g2o
import numpy as np

for name, expected in {"turn": 1, "shift": 4}.items():
    numbers = np.array(open(f"{name}.g2o").read().splitlines()[2].split()[3:], float)  # load() of this package knows no such type
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = numbers[7:]
    edge = g2o.EdgeSE3()
    vertices = [g2o.VertexSE3() for _ in range(2)]
    for index, vertex in enumerate(vertices):
        vertex.set_id(index)
        vertex.set_estimate(g2o.Isometry3d(np.eye(3), np.zeros(3)))
        edge.set_vertex(index, vertex)
    x, y, z, w = numbers[3:7]
    edge.set_measurement(g2o.Isometry3d(g2o.Quaternion(w, x, y, z).matrix(), numbers[:3]))
    edge.set_information(information)
    edge.compute_error()
    print(f"g2o, {name}: error {edge.error()}, chi squared {edge.chi2():.4f}")
    assert abs(edge.chi2() - expected) < 0.01
PYTHON
gtsam/bin/python - <<'PYTHON'
import gtsam

for name in ("turn", "shift"):
    graph, values = gtsam.readG2o(f"{name}.g2o", True)
    print(f"gtsam, {name}: error {graph.at(0).unwhitenedError(values)}, chi squared {2 * graph.error(values):.4f}")
    assert abs(2 * graph.error(values) - 4) < 0.01
PYTHON
