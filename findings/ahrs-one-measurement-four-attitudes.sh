#!/usr/bin/env bash
# ahrs 0.4.0, estimators of an attitude from one reading of accelerometer and magnetometer: Davenport, QUEST, FAMC, Tilt, SAAM, TRIAD, FLAE, FQA.
#
# Guess: whichever is taken, one reading gives one attitude, or its documentation says in which sense it goes.
# Seen: of an exact reading (north, east, down; a field that dips by 60 degrees) the first four give the turn from the body to the world; SAAM and
# TRIAD, of which the examples look the same, give its inverse; FLAE's magnetic_dip counts upwards where Davenport's and QUEST's counts downwards,
# so that it is 77 degrees off, and right with -60; FQA is upside down, as it wants gravity with the other sign. All results are called attitude.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet ahrs==0.4.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from ahrs import filters
from scipy.spatial.transform import Rotation

field = np.array([np.cos(np.radians(60)), 0, np.sin(np.radians(60))])  # north and down
truth = Rotation.from_euler("ZYX", [0.7, 0.3, -0.4])  # body to world
gravity, magnetic = truth.inv().apply([0, 0, 9.81]), truth.inv().apply(50 * field)
estimators = {
    "Davenport": filters.Davenport(magnetic_dip=60.0),
    "QUEST": filters.QUEST(magnetic_dip=60.0),
    "FAMC": filters.FAMC(),
    "Tilt": filters.Tilt(),
    "SAAM": filters.SAAM(),
    "TRIAD": filters.TRIAD(v1=np.array([0, 0, 1.0]), v2=field),
    "FLAE": filters.FLAE(magnetic_dip=60.0),
    "FLAE, dip -60": filters.FLAE(magnetic_dip=-60.0),
    "FQA": filters.FQA(mag_ref=field.tolist()),
}
degrees = {}
for name, estimator in estimators.items():
    answer = np.array(estimator.estimate(gravity.copy(), magnetic.copy()))
    answer = Rotation.from_matrix(answer) if answer.shape == (3, 3) else Rotation.from_quat(np.roll(answer, -1))
    degrees[name] = [np.degrees((other.inv() * answer).magnitude()) for other in (truth, truth.inv())]
    print(f"{name}: {degrees[name][0]:.2f} degrees from the attitude, {degrees[name][1]:.2f} from its inverse")
off, inverse_off = (np.array([degrees[name][column] for name in estimators]) for column in (0, 1))
assert (off[:4] < 1e-3).all() and (inverse_off[4:6] < 1e-3).all() and (off[4:6] > 100).all()
assert 77 < off[6] < 78 and off[7] < 0.1 and off[8] > 179.9
PYTHON
