"""A car from an image: its box, its keypoints, and from these its pose and shape.

The image is rendered; give the path of your photograph in its place. The networks' part of the
graph is the reprojection: every keypoint comes with a covariance and with the probability that it is right.

     image ---- detector ---- box ---- networks ---- keypoint_i, covariance_i, confidence_i
                               |                                      |
     N(0, I) ---- L(0) --------|------------------+-------------------+
                (lambda)       |                  |            reprojection_i
                               |       symmetry, faces, size    (weight w_i)
                               |                                      |
     ground ---- X(0,0) ---- 2D box ----------------------------------+
                 (pose)
"""

import numpy as np

import fgrecon
from fgrecon.simulation import demo_scene


def main() -> None:
    scene = demo_scene(fgrecon.load_prior("car14"), seed=6)
    image = scene.picture.image  # (H, W, 3) RGB

    # The detector finds the boxes; give boxes=(N, 4) x1, y1, x2, y2 in pixels where you know them.
    cars = fgrecon.reconstruct_image(image, scene.camera, ground=scene.ground)
    car = cars[0]
    seen = car.detection.observation
    print(f"{len(cars)} car in the image, box {seen.box.round()}, true {scene.observation.box.round()}")
    if car.result is None:
        print(f"refused: {car.error}")
        return
    result, true_pose = car.result, scene.truth.camera_T_object
    print(f"{result.status}: {result.message}")
    print(f"yaw {np.degrees(result.rotation_y):.1f} degrees, true {np.degrees(fgrecon.rotation_y(true_pose)):.1f}")
    print(f"position {result.location.round(2)} m, true {true_pose[:3, 3].round(2)}")
    print(f"length, width, height {result.box_size.round(2)} m")
    print("\nkeypoint            confidence  weight  truly visible")
    rows = zip(
        result.shape.keypoint_names, seen.confidence, result.diagnostics.weights, scene.truth.visible, strict=True
    )
    for name, sure, weight, truly in rows:
        print(f"{name:20s} {sure:9.2f} {weight:7.2f}  {'yes' if truly else 'no'}")


if __name__ == "__main__":
    main()
