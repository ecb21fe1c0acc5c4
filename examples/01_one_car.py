"""One car from its keypoints: pose, shape, and how sure they are.

The keypoints are simulated with the mistakes of a real network; use your detector's in their place. What is solved:

     N(0, I) ---- L(0) ------+------------------+
                (lambda)     |                  |
                       reprojection_i      symmetry, faces, size
                       (weight w_i)
                             |
       ground ---- X(0,0) ---+--- 2D box
                   (pose)
"""

import numpy as np

import fgrecon
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose


def main() -> None:
    rng = np.random.default_rng(3)
    car = Vehicle.of_prior(fgrecon.load_prior("car14"), coefficients=[0.8, -0.6, 0.3, 0.0, 0.5])
    true_pose = yaw_pose(yaw=-2.1, location=np.array([-3.0, 1.65, 12.0]))
    seen, truth = simulate(car, KITTI_CAMERA, true_pose, rng)

    result = fgrecon.reconstruct(
        seen.keypoints,
        KITTI_CAMERA,
        confidence=seen.confidence,
        box=seen.box,
        ground=1.65,  # height of a level camera; leave it out where you do not know it
    )

    print(f"{result.status}: {result.message}")
    print(f"yaw {np.degrees(result.rotation_y):.1f} degrees, true {np.degrees(-2.1):.1f}")
    print(f"position {result.location.round(2)} m, true {true_pose[:3, 3]}")
    print(f"length, width, height {result.box_size.round(2)} m")
    if result.uncertainty.pose_covariance is not None:
        sigma = np.sqrt(np.diag(result.uncertainty.pose_covariance))
        print(f"1 sigma: rotation {np.degrees(sigma[:3]).round(1)} degrees, position {sigma[3:].round(2)} m")
    print("\nkeypoint            confidence  weight  visible  truly visible")
    rows = zip(
        result.shape.keypoint_names,
        seen.confidence,
        result.diagnostics.weights,
        result.diagnostics.visibility,
        truth.visible,
        strict=True,
    )
    for name, confidence, weight, visible, truly in rows:
        print(f"{name:20s} {confidence:9.2f} {weight:7.2f} {visible:8.2f}  {'yes' if truly else 'no'}")


if __name__ == "__main__":
    main()
