"""Range and range rate of a vehicle: of a radar, a range finder or an ultrasonic sensor.

    s = R' (o - t),    r = (|s - q(s, lambda)| - range) / sigma

for a sensor at o in the camera's frame, q being the point of the vehicle's cuboid (length, width and height by lambda)
that is nearest to the sensor, or its middle. In metres. And with c the cuboid's middle, p = R c + t and u the unit
vector from o to p,

    r = u . (R (forward, 0, left) - w) - rate,    metres per second,

w being the sensor's own velocity in the camera's axes: zero where the rate is over the ground, or V relative to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from factors.arrays import Array
from factors.guard import Evaluation, guarded_factor
from factors.mixture import Form
from factors.sensed import SensedFactor

_NOWHERE = 1e-9  # metres: of a sensor in the vehicle's surface no direction leads out


@dataclass(frozen=True, eq=False)
class RangeRows:
    """A range of a vehicle."""

    metres: float  # the range
    sigma: float  # its standard deviation, metres
    origin: Array  # (3,) where the sensor is, camera frame
    size: Array  # (3,) length, width and height of the mean shape, metres
    size_basis: Array  # (3, N) their change per unit of each coefficient
    to_centre: bool = False  # whether it is that of the vehicle's middle, else that of its nearest surface

    def evaluate(
        self, rotation: Array, translation: Array, coefficients: Array, *, want: bool
    ) -> tuple[float, Array | None]:
        """The whitened residual, and where wanted its derivative (6 + N,).

        By a turn about the object's axes, a shift along them, and the coefficients.
        """
        sensor = (self.origin - translation) @ rotation
        length, width, height = self.size + self.size_basis @ coefficients
        low, high = np.array([-length / 2.0, -height, -width / 2.0]), np.array([length / 2.0, 0.0, width / 2.0])
        nearest = (low + high) / 2.0 if self.to_centre else np.clip(sensor, low, high)
        away = sensor - nearest
        distance = float(np.linalg.norm(away))
        residual = (distance - self.metres) / self.sigma
        if not want:
            return residual, None
        along = away / distance if distance > _NOWHERE else np.zeros(3)
        by_low, by_high = (
            -self.size_basis[[0, 2, 1]] * np.array([[0.5], [1.0], [0.5]]),
            self.size_basis[[0, 2, 1]] / 2.0,
        )
        by_high[1] = 0.0
        side = (sensor > high)[:, None] * by_high + (sensor < low)[:, None] * by_low
        by_shape = -along @ ((by_low + by_high) / 2.0 if self.to_centre else side)
        return residual, np.concatenate([np.cross(along, sensor), -along, by_shape]) / self.sigma


class RangeFactor(SensedFactor):
    """A range on pose and lambda.

    Attributes:
        rows: The range.
    """

    name = "range"

    def __init__(self, rows: RangeRows, pose: int | Array, coefficients: int | Array) -> None:
        """Bind it to variables by their keys, or to constants: camera_T_object (4, 4), lambda (N,)."""
        super().__init__(pose, coefficients, rows.size_basis.shape[1], 1)
        self.rows = rows

    def energy(self, values: gtsam.Values) -> float:
        """Half the squared residual, nats."""
        return 0.5 * self.rows.evaluate(*self.state(values), want=False)[0] ** 2

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The row at the values."""
        residual, jacobian = self.rows.evaluate(*self.state(values), want=want_jacobian)
        root = self.common_factor**-0.5 if self.form is Form.WEIGHTED else 1.0
        return np.array([root * residual]), None if jacobian is None else root * jacobian[None, self._columns]


@dataclass(frozen=True, slots=True)
class _RangeRate:
    pose_key: int
    velocity_key: int
    rate: float
    origin: Array
    middle: Array
    sensor_velocity: Array

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        pose = values.atPose3(self.pose_key).matrix()
        rotation, velocity = pose[:3, :3], values.atVector(self.velocity_key)
        own = np.array([velocity[0], 0.0, velocity[1]])
        away = rotation @ self.middle + pose[:3, 3] - self.origin
        distance = max(float(np.linalg.norm(away)), _NOWHERE)
        ray, relative = away / distance, rotation @ own - self.sensor_velocity
        residual = np.array([ray @ relative - self.rate])
        if not want_jacobian:
            return residual, None
        across = (relative - ray * (ray @ relative)) / distance @ rotation  # by a shift along the object's axes
        along = ray @ rotation
        jacobian = np.zeros((1, 9))
        jacobian[0, :3] = np.cross(self.middle, across) + np.cross(own, along)
        jacobian[0, 3:6], jacobian[0, 6], jacobian[0, 7] = across, along[0], along[2]
        return residual, jacobian


def range_rate_factor(
    keys: tuple[int, int], rate: float, sigma: float, origin: Array, middle: Array, sensor_velocity: Array
) -> gtsam.CustomFactor:
    """A range rate on pose and velocity.

    Args:
        keys: Of camera_T_object and of the velocity (forward, left, turn rate).
        rate: Metres per second, positive where the vehicle goes away.
        sigma: Its standard deviation, metres per second.
        origin: (3,) where the sensor is, camera frame.
        middle: (3,) the point of the vehicle that it is measured at, object frame.
        sensor_velocity: (3,) of the sensor, over what the velocity is over, in the camera's axes.
    """
    callback = _RangeRate(*keys, rate, origin, middle, sensor_velocity)
    return guarded_factor("range rate", sigma, keys, (6, 3), 1, callback)
