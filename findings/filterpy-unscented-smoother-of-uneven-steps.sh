#!/usr/bin/env bash
# filterpy 2.0.0, UnscentedKalmanFilter.rts_smoother(Xs, Ps, Qs, dts) of measurements that come in uneven steps.
#
# Guess: with the dts and Qs that the filter ran with it is the smoother; on a linear system that is KalmanFilter.rts_smoother(Xs, Ps, Fs, Qs).
# Seen: from state k it predicts k + 1 with dts[k], the step that led to k, where the filter took dts[k + 1], and KalmanFilter's smoother Fs[k + 1];
# and Qs is not looked at, the filter's Q of the moment serves for all. Steps moved by one and one Q are not in the docstring, and the
# smoothed track is worse than the filtered one.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet filterpy==2.0.0 numpy==2.3.5 scipy==1.16.3 matplotlib==3.10.7
env/bin/python - <<'PYTHON'
import numpy as np
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter


def move(dt):
    return np.array([[1, dt], [0, 1]])


rng = np.random.default_rng(0)
steps = rng.choice([0.1, 1.0], 200)
noises = [np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) for dt in steps]
true = [np.array([0.0, 5.0])]
for dt, noise in zip(steps, noises, strict=True):
    true.append(move(dt) @ true[-1] + rng.multivariate_normal([0, 0], noise))
true = np.array(true[1:])
measured = true[:, 0] + rng.normal(0, 0.5, len(true))

linear = KalmanFilter(dim_x=2, dim_z=1)
points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)
unscented = UnscentedKalmanFilter(2, 1, 0.1, hx=lambda x: x[:1], fx=lambda x, dt: move(dt) @ x, points=points)
linear.H, linear.x, unscented.x = np.array([[1.0, 0.0]]), np.array([[0.0], [5.0]]), np.array([0.0, 5.0])
linear.R = unscented.R = np.array([[0.25]])
states, covariances = [], []
for dt, noise, value in zip(steps, noises, measured, strict=True):
    linear.F, linear.Q, unscented.Q = move(dt), noise, noise
    linear.predict(), linear.update(value)
    unscented.predict(dt=dt), unscented.update(np.array([value]))
    assert np.allclose(linear.x[:, 0], unscented.x)
    states.append(unscented.x.copy()), covariances.append(unscented.P.copy())
states, covariances = np.array(states), np.array(covariances)


def error(track):
    return np.sqrt(np.mean((np.asarray(track).reshape(-1, 2) - true) ** 2, axis=0)).round(3)


right = linear.rts_smoother(states[..., None], covariances, Fs=[move(dt) for dt in steps], Qs=noises)[0]
given = unscented.rts_smoother(states, covariances, Qs=noises, dts=steps)[0]
tenfold = unscented.rts_smoother(states, covariances, Qs=[10 * noise for noise in noises], dts=steps)[0]
print("errors of position and speed: filtered", error(states), "KalmanFilter's smoother", error(right), "the unscented one", error(given))
print("with ten times the noises it gives the same:", np.array_equal(given, tenfold))
assert (error(right) < error(states)).all() and (error(given) > error(states)).all() and np.array_equal(given, tenfold)
PYTHON
