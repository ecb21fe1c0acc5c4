#!/usr/bin/env bash
# pypose 0.9.5, module.EKF and module.UKF on a linear system: a car's position and speed, of positions at ten a second.
#
# Guess: on a linear system both are the Kalman filter, to rounding; the EKF's documentation has the innovation y - h(x-), x- the predicted state.
# Seen: neither is. The EKF compares the measurement ("at current step") with the state before its prediction, a step too old: at 20 m/s its
# places are 1.9 m ahead for good, where the Kalman filter scatters by 0.4 m; its covariance is the right one and tells nothing of it. The UKF takes
# the rows of Cholesky's L for its points, whose covariance is L'L in place of LL' = P; so it tells half the variance of the speed (0.38, not 0.75).
# (Issue 360, closed, told of the EKF's time; in the example of its documentation the measurement that it takes is that of the state before.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pypose==0.9.5 torch==2.13.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import numpy as np
import pypose
import torch

torch.set_default_dtype(torch.float64)
step, count = 0.1, 300
motion, seen = torch.tensor([[1, step], [0, 1]]), torch.tensor([[1.0, 0]])
noise, of_place = torch.tensor([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]), torch.eye(1)


class Car(pypose.module.NLS):
    def state_transition(self, state, input, t=None):
        return state @ motion.T

    def observation(self, state, input, t=None):
        return state @ seen.T


rng = np.random.default_rng(0)
truth = torch.tensor(np.column_stack([20 * step * np.arange(count + 1), np.full(count + 1, 20.0)]))
measured = truth[:, :1] + torch.tensor(rng.normal(0, 1, (count + 1, 1)))


def kalman(state, place, covariance):
    state, covariance = motion @ state, motion @ covariance @ motion.T + noise
    gain = covariance @ seen.T @ torch.linalg.inv(seen @ covariance @ seen.T + of_place)
    return state + gain @ (place - seen @ state), (torch.eye(2) - gain @ seen) @ covariance


def run(filtered):
    state, covariance, states = truth[0], torch.eye(2), []
    for place in measured[1:]:
        state, covariance = filtered(state, place, covariance)
        states.append(state)
    return torch.stack(states).numpy(), covariance.numpy()


inputs = torch.zeros(1)
results = {"Kalman filter": run(kalman)}
for name in ("EKF", "UKF"):
    theirs = getattr(pypose.module, name)(Car(), Q=noise, R=of_place)
    results[name] = run(lambda state, place, covariance: theirs(state, place, inputs, covariance))
errors = {}
for name, (states, covariance) in results.items():
    error = (states - truth[1:].numpy())[50:]
    errors[name] = error.mean(axis=0), error.std(axis=0), covariance
    print(f"{name}: mean error {error.mean(axis=0).round(2)} (m, m/s), scatter {error.std(axis=0).round(2)}, told {covariance.round(3).tolist()}")
plain, extended, unscented = errors.values()
assert abs(plain[0][0]) < 0.2 and abs(extended[0][0] - 20 * step) < 0.2 and np.allclose(extended[2], plain[2])
assert 0.4 < unscented[2][1, 1] / plain[2][1, 1] < 0.6
points, weights = theirs.sigma_weight_points(truth[0], torch.tensor(plain[2]), 1)
off, lower = (points - truth[0]).numpy(), np.linalg.cholesky(plain[2])
spread = (weights.numpy() * off).T @ off
print("the UKF's points of the Kalman filter's covariance have", spread.round(3).tolist())
assert np.allclose(spread, lower.T @ lower) and not np.allclose(spread, plain[2], rtol=0.1)
PYTHON
