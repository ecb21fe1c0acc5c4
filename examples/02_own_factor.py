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
from fgrecon.solve import Problem, VehicleGraph, build, minimise, prepare


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
    camera_only = fgrecon.reconstruct(seen.keypoints, KITTI_CAMERA, confidence=seen.confidence, box=seen.box)

    # The same graph at the same weights, with one factor more.
    problem = Problem.of(seen, KITTI_CAMERA, prepare(prior), ground=None, options=fgrecon.Options(box="off"))
    vehicle = VehicleGraph(problem, camera_only.pose, pose_free=True)
    graph = build(vehicle.terms(camera_only.weights, box_weights=np.ones(4)))
    graph.add(distance_factor(float(np.linalg.norm(true_pose[:3, 3])), sigma=0.1))
    start = vehicle.values(camera_only.pose, camera_only.coefficients, camera_only.offsets)
    pose, _, _ = vehicle.read(minimise(graph, start).values)

    for name, location in (("camera only", camera_only.location), ("with the radar", pose.translation())):
        print(f"{name:15s} position {location.round(2)} m, off by {np.linalg.norm(location - true_pose[:3, 3]):.2f} m")


if __name__ == "__main__":
    main()
