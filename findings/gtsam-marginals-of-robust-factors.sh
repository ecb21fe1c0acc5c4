#!/usr/bin/env bash
# gtsam 4.3.0, Marginals of a graph with robust noise models: a factor counts by its weight (w = rho'(e) / e, that of
# iteratively re-weighted least squares), not by the second derivative of its loss.
#
# Guess: the covariance is the inverse of the energy's second derivative. Beyond Huber's threshold the loss is linear, and
# an outlier says nothing of the variable: with one inlier of variance 1 the variance is 1.
# Seen: 0.9. The outlier, nine deviations off, is counted as a measurement of weight 1/9. Losses that turn down (Tukey,
# Geman-McClure) have a negative second derivative there, and are counted as positive all the same: results look surer
# than the energy is.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet gtsam==4.3.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import gtsam
import numpy as np

key, one = gtsam.symbol("x", 0), gtsam.noiseModel.Isotropic.Sigma(1, 1.0)
huber = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.0), one)
graph = gtsam.NonlinearFactorGraph()
graph.add(gtsam.PriorFactorVector(key, np.array([0.0]), one))
graph.add(gtsam.PriorFactorVector(key, np.array([10.0]), huber))
start = gtsam.Values()
start.insert(key, np.array([0.0]))
found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()


def energy(x):
    values = gtsam.Values()
    values.insert(key, np.array([x]))
    return graph.error(values)


x, step = float(found.atVector(key)[0]), 1e-3
second = (energy(x + step) - 2.0 * energy(x) + energy(x - step)) / step**2
variance = float(gtsam.Marginals(graph, found).marginalCovariance(key)[0, 0])
print(f"x {x:.3f}, second derivative {second:.3f}, so a variance of {1 / second:.3f}; Marginals: {variance:.3f}")
assert abs(second - 1.0) < 1e-3 and abs(variance - 0.9) < 1e-3
PYTHON
