"""A car followed frame by frame while the camera drives, with a motion factor of one's own: its speed by radar.

keypoints ---- X(0,t) ---- motion ---- X(0,t+1) ---- keypoints
|          |             |
L(0)       V(0,t) ---- V(0,t+1)
|             |
radar         radar
"""

import gtsam
import numpy as np

import fgrecon
from factors import V
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose

SPEED = 6.0  # metres per second, towards the camera


def radar(_first: int, second: int, _seconds: float, spread: float) -> list[gtsam.NonlinearFactor]:
    """A factor on the velocity (forward, left, turn rate) in the second frame: forward is known to 0.2 m/s."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(spread * np.array([0.2, 100.0, 100.0]))
    return [gtsam.PriorFactorVector(V(0, second), np.array([SPEED, 0.0, 0.0]), noise)]


def main() -> None:
    rng = np.random.default_rng(2)
    fleet = fgrecon.SIZE_PRIORS["kitti"]
    car = Vehicle.sample(fgrecon.load_prior("car14").for_fleet(fleet), rng)
    tracker = fgrecon.Tracker(size_prior=fleet, motion_factors=radar)
    truths = []
    for t in range(20):
        time = 0.1 * t
        world_T_camera = yaw_pose(0.0, np.array([0.0, 0.0, 5.0 * time]))
        world_T_car = yaw_pose(np.pi / 2.0, np.array([-3.0, 1.65, 38.0 - SPEED * time]))
        truths.append(np.linalg.inv(world_T_camera) @ world_T_car)
        seen, _ = simulate(car, KITTI_CAMERA, truths[-1], rng)

        estimate = tracker.update(time, {7: seen}, camera=KITTI_CAMERA, world_T_camera=world_T_camera, ground=1.65)[7]

        off = np.linalg.norm(estimate.reconstruction.location - truths[-1][:3, 3])
        speed = "" if estimate.speed is None else f", {estimate.speed:.1f} m/s"
        print(f"{time:.1f} s: off by {off:.2f} m, facing {estimate.facing_probability:.3f}{speed}")
    ends = tracker.smooth()[7]
    off = [np.linalg.norm(e.reconstruction.location - truth[:3, 3]) for e, truth in zip(ends, truths, strict=True)]
    print(f"by all frames: off by {np.mean(off):.2f} m on average")


if __name__ == "__main__":
    main()
