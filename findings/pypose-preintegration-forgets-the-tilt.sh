#!/usr/bin/env bash
# pypose 0.9.5, module.IMUPreintegrator: positions of an inertial sensor, and their covariance, of noise of its gyroscope and accelerometer.
#
# Guess: the covariance is that of the answer: a sensor that lies still for twenty seconds drifts by as much as is told.
# Seen: of 400 runs (densities of noise as of a good sensor on a chip) the rotation does, and the height; sideways the positions scatter by 0.7 m,
# where 0.10 m is told. Errors of the rotation reach the velocity by the acceleration WITHOUT gravity, which is nothing here, though it is gravity
# that a tilted sensor takes for motion: the greatest part of the drift is missing, and more of it the longer one integrates. (gyro_cov and acc_cov,
# "covariance of the gyroscope", are densities besides, a measurement's variance times the step, as gtsam's are; they are given so here.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet pypose==0.9.5 torch==2.13.0 numpy==2.3.5 scipy==1.16.3
env/bin/python - <<'PYTHON'
import numpy as np
import pypose
import torch
from scipy.spatial.transform import Rotation

torch.set_default_dtype(torch.float64)
step, count, runs, gravity = 0.02, 1000, 400, 9.81
of_gyro, of_acceleration = 1.7e-4, 2e-3  # densities: rad/s and m/s^2, by the root of hertz
length = step * count
rng = np.random.default_rng(0)


def integrated(rates, accelerations):
    """The last rotation, velocity and position of each run, and their covariance as it is told."""
    noise = {"gyro_cov": of_gyro**2, "acc_cov": of_acceleration**2, "prop_cov": len(rates) == 1}
    integrator = pypose.module.IMUPreintegrator(gravity=gravity, reset=True, **noise).double()
    answer = integrator(dt=torch.full((len(rates), count, 1), step), gyro=torch.tensor(rates), acc=torch.tensor(accelerations))
    turn, velocity, position = (answer[name][:, -1].numpy() for name in ("rot", "vel", "pos"))
    return np.hstack([Rotation.from_quat(turn).as_rotvec(), velocity, position]), answer["cov"]


still = np.tile([0, 0, gravity], (1, count, 1))
_, covariance = integrated(np.zeros((1, count, 3)), still)
rates = rng.normal(0, of_gyro / np.sqrt(step), (runs, count, 3))
found, _ = integrated(rates, still + rng.normal(0, of_acceleration / np.sqrt(step), (runs, count, 3)))
scatter, told = found.std(axis=0), np.sqrt(np.diag(covariance[0].numpy()))
by_tilt = np.array([of_acceleration**2 * length**3 / 3 + (of_gyro * gravity) ** 2 * length**5 / 20, of_acceleration**2 * length**3 / 3]) ** 0.5
for name, at in (("rotation (rad)", 0), ("velocity (m/s)", 3), ("position (m)", 6)):
    print(f"{name}: scatter {scatter[at : at + 3].round(4)}, told {told[at : at + 3].round(4)}")
print(f"position by a closed form: {by_tilt[0]:.3f} sideways with the tilt, {by_tilt[1]:.3f} without")
assert np.allclose(scatter[[0, 1, 2, 5, 8]], told[[0, 1, 2, 5, 8]], rtol=0.15)
assert np.allclose(scatter[6:8], by_tilt[0], rtol=0.15) and np.allclose(told[6:], by_tilt[1], rtol=0.05)
PYTHON
