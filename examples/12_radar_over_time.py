"""A radar over time: range and range rate of a car ahead, beside its keypoints, from a camera that drives itself.

V(0,t) ---- range rate ---- X(0,t) ---- range ---- L(0)
  |                           |
  +---------- motion ---------+---- keypoints
"""

import numpy as np

import fgrecon
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose


def main() -> None:
    rng = np.random.default_rng(2)
    car = Vehicle.sample(fgrecon.load_prior("car14"), rng)
    own, speed = 12.0, 15.0  # metres per second
    trackers = {"camera alone": fgrecon.Tracker(), "with the radar": fgrecon.Tracker()}
    for frame in range(10):
        time, camera = frame / 10.0, np.eye(4)
        camera[2, 3] = own * time
        place = np.array([2.0, 1.65, 25.0 + (speed - own) * time])
        seen, _ = simulate(car, KITTI_CAMERA, yaw_pose(-np.pi / 2.0, place), rng)  # it drives away
        near = place - np.ptp(car.vertices, axis=0)[[2, 1, 0]] / [2.0, 1.0, 2.0]  # the upper edge of its rear
        radar = (
            fgrecon.Range(np.linalg.norm(near) + rng.normal(0.0, 0.1), sigma=0.1),
            fgrecon.RangeRate((speed - own) * near[2] / np.linalg.norm(near) + rng.normal(0.0, 0.1), sigma=0.1),
        )
        for name, tracker in trackers.items():
            one = seen.with_evidence(radar if name == "with the radar" else ())
            estimate = tracker.update(time, {1: one}, camera=KITTI_CAMERA, world_T_camera=camera, ground=1.65)[1]
            if frame % 3 == 0 and estimate.velocity is not None:
                off = np.linalg.norm(estimate.reconstruction.location - place)
                print(f"{time:.1f} s, {name:14s} off by {off:.2f} m, speed {np.linalg.norm(estimate.velocity):.1f} m/s")


if __name__ == "__main__":
    main()
