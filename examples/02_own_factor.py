"""A factor of one's own in the graph: a radar that measures the distance to the car.

     N(0, I) ---- L(0) ---- reprojection_i ---- X(0,0) ---- distance    <- the new factor
                (lambda)                        (pose)

A factor is a callback that returns its residual and its Jacobian; `guarded_factor` checks both before GTSAM sees them.
"""

import gtsam
import numpy as np
from numpy.typing import NDArray

import fgrecon
from factors import X, guarded_factor
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose


def distance_factor(metres: float, sigma: float) -> gtsam.CustomFactor:
    """|t| - metres, the distance of the car's origin from the camera; residual in metres."""

    def callback(values: gtsam.Values, _: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        pose = values.atPose3(X(0, 0))
        t = pose.translation()
        jacobian = np.zeros((1, 6))  # GTSAM's order: rotation, then translation in the car's own frame
        jacobian[0, 3:] = t @ pose.rotation().matrix() / np.linalg.norm(t)
        return np.array([np.linalg.norm(t) - metres]), jacobian

    return guarded_factor("distance", sigma, [X(0, 0)], [6], 1, callback)


def main() -> None:
    rng = np.random.default_rng(5)
    prior = fgrecon.load_prior("car14")
    true_pose = yaw_pose(yaw=1.9, location=np.array([4.0, 1.65, 25.0]))
    seen, _ = simulate(Vehicle.sample(prior, rng), KITTI_CAMERA, true_pose, rng)
    camera_only = fgrecon.reconstruct(seen, KITTI_CAMERA)
    radar = distance_factor(float(np.linalg.norm(true_pose[:3, 3])), sigma=0.1)
    with_radar = fgrecon.reconstruct(seen, KITTI_CAMERA, extra_factors=[radar])

    for name, result in (("camera only", camera_only), ("with the radar", with_radar)):
        off = np.linalg.norm(result.location - true_pose[:3, 3])
        print(f"{name:15s} position {result.location.round(2)} m, off by {off:.2f} m")


if __name__ == "__main__":
    main()
