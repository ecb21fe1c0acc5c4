"""LiDAR and camera of one frame: the whole scan as evidence of a car, beside its keypoints.

keypoints ---- X(0,0) ---- points ---- L(0)
               (pose)                (lambda)
"""

import numpy as np

import fgrecon
from fgrecon.simulation import sample_scan, sample_street


def main() -> None:
    street = sample_street(fgrecon.load_prior("car14"))  # an image, its camera, cars with keypoints
    scan = fgrecon.Points(sample_scan(street), sigma=0.02)  # metres in the camera's frame: x right, y down, z forward
    car = street.cars[0]
    for name, evidence in (("camera alone", []), ("with the LiDAR", [scan])):
        result = fgrecon.reconstruct(car.observation, street.camera, evidence=evidence)
        off = np.linalg.norm(result.location - car.truth.camera_T_object[:3, 3])
        print(f"{name:15s} {result.location.round(2)} m, off by {off:.2f} m, {result.box_size[0]:.2f} m long")


if __name__ == "__main__":
    main()
