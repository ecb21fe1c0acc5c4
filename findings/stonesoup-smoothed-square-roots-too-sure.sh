#!/usr/bin/env bash
# Stone Soup 1.9.1, KalmanSmoother after SqrtKalmanPredictor and SqrtKalmanUpdater, which are there for the sake of numerical stability.
#
# Guess: a track of square roots is smoothed as one of covariances is, or refused: means and covariances are the same to rounding.
# Seen: the means are; the covariances are wrong without a word, here those of a position that is known to 0.55 m as 0.13 m. The smoother puts its
# covariance where such a state keeps the root, so that .covar is P P' for P, and the step before takes that for what is known
# of the next state. The last state, which the filter made, is right; ExtendedKalmanSmoother and UnscentedKalmanSmoother do the same.
# A gate or a fusion that takes these tracks weighs them by up to eighteen times too much.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet stonesoup==1.9.1 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
from datetime import datetime, timedelta

import numpy as np
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor import kalman as predictors
from stonesoup.smoother import kalman as smoothers
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, SqrtGaussianState
from stonesoup.types.track import Track
from stonesoup.updater import kalman as updaters

step, start, count = 0.5, datetime(2026, 1, 1), 20
motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.8)])
sensor = LinearGaussian(2, (0,), np.array([[0.7]]))
mean, covariance = np.array([[0.5], [1]]), np.array([[4.0, 1], [1, 3]])
measured = np.random.default_rng(0).normal(np.arange(1, count + 1) * step, 1)


def track_of(predictor, updater, state):
    track = Track()
    for number, position in enumerate(measured, 1):
        time = start + timedelta(seconds=step * number)
        prediction = predictor.predict(state, timestamp=time)
        detection = Detection(np.array([[position]]), timestamp=time, measurement_model=sensor)
        state = updater.update(SingleHypothesis(prediction, detection))
        track.append(state)
    return track


plain = track_of(predictors.KalmanPredictor(motion), updaters.KalmanUpdater(sensor), GaussianState(mean, covariance, timestamp=start))
root = SqrtGaussianState(mean, np.linalg.cholesky(covariance), timestamp=start)
roots = track_of(predictors.SqrtKalmanPredictor(motion), updaters.SqrtKalmanUpdater(sensor), root)
assert all(np.allclose(a.covar, b.covar) for a, b in zip(plain, roots))

# independently: all states by the measurements and the motion at once
turn = np.array([[1, step], [0, 1]])
noise = 0.8 * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
information = np.zeros((2 * count + 2, 2 * count + 2))
information[:2, :2] = np.linalg.inv(covariance)
for number in range(count):
    both = slice(2 * number, 2 * number + 4)
    link = np.hstack([-turn, np.eye(2)])
    information[both, both] += link.T @ np.linalg.inv(noise) @ link
    information[2 * number + 2, 2 * number + 2] += 1 / 0.7
exact = [np.linalg.inv(information)[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(1, count + 1)]

for name in ("KalmanSmoother", "ExtendedKalmanSmoother", "UnscentedKalmanSmoother"):
    good, bad = (getattr(smoothers, name)(motion).smooth(track) for track in (plain, roots))
    assert all(np.allclose(a.state_vector, b.state_vector) for a, b in zip(good, bad))
    assert all(np.allclose(state.covar, known, rtol=1e-4) for state, known in zip(good, exact))
    told, known = (np.sqrt([state.covar[0, 0] for state in states]) for states in (bad, good))
    print(f"{name}: deviations of the first five positions {known[:5].round(2)}, by square roots {told[:5].round(2)}; last {known[-1]:.2f}, {told[-1]:.2f}")
    assert np.isclose(told[-1], known[-1]) and (told[:-1] < 0.8 * known[:-1]).all() and told[0] < 0.3 * known[0]
PYTHON
