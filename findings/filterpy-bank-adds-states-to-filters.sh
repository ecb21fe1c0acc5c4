#!/usr/bin/env bash
# filterpy 2.0.0, MMAEFilterBank.P: the covariance of a bank of filters, of position and speed here.
#
# Guess: two filters that agree in all have their own mean and covariance as that of the bank: 0.75 m and 0.99 m/s.
# Seen: the mean is; the covariance has 9800 m^2 on its diagonal, 99 m and 99 m/s, when the car is at 150 m with 10 m/s: to the i-th filter's state
# the i-th number of the bank's mean is compared, in place of the mean, so that it grows with the distance from the origin. Filters beyond the
# number of states are left out: of three that agree the covariance of speed and position is 2/3 of theirs. Whoever gates with it lets everything in.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet filterpy==2.0.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
from filterpy.kalman import KalmanFilter, MMAEFilterBank


def one():
    kalman = KalmanFilter(2, 1)
    kalman.F, kalman.H, kalman.R = np.array([[1, 0.5], [0, 1]]), np.array([[1.0, 0]]), np.eye(1)
    kalman.Q = np.array([[0.5**3 / 3, 0.5**2 / 2], [0.5**2 / 2, 0.5]])
    kalman.x, kalman.P = np.array([[100.0], [10]]), np.eye(2)
    return kalman


for count in (2, 3):
    bank = MMAEFilterBank([one() for _ in range(count)], [1 / count] * count, 2, one().H)
    for step in range(1, 11):
        bank.predict()
        bank.update(np.array([100 + 5.0 * step]))
    mean, own, told = bank.x[:, 0], bank.filters[0].P, bank.P
    print(f"{count} filters that agree: mean {mean.round(3)}, each one's covariance {own.round(3).tolist()}, the bank's {told.round(3).tolist()}")
    assert np.allclose(mean, bank.filters[0].x[:, 0])
    off = told - own * min(count, 2) / count  # two of the filters are counted, for two states
    assert np.allclose(off, np.eye(2) * (mean[0] - mean[1]) ** 2 / count)
PYTHON
