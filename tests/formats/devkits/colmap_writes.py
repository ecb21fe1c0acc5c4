"""Writes cameras of COLMAP and prints their pixels: run in its own environment, FOLDER."""

import json
import sys

import numpy as np
import pycolmap

cameras = {
    1: ("SIMPLE_PINHOLE", [500.0, 320.0, 240.0]),
    2: ("PINHOLE", [500.0, 510.0, 320.0, 240.0]),
    3: ("SIMPLE_RADIAL", [500.0, 321.5, 240.0, 0.05]),
    4: ("RADIAL", [500.0, 320.0, 240.25, 0.05, -0.01]),
    5: ("OPENCV", [500.0, 510.0, 320.0, 240.0, 0.05, -0.01, 0.001, -0.002]),
    6: ("FULL_OPENCV", [500.0, 510.0, 320.0, 240.0, 0.05, -0.01, 0.001, -0.002, 0.003, 0.001, 0.002, 0.0005]),
    7: ("OPENCV_FISHEYE", [300.0, 310.0, 320.0, 240.0, -0.02, 0.004, -0.003, 0.0004]),
    8: ("SIMPLE_RADIAL_FISHEYE", [300.0, 321.5, 240.0, 0.05]),
    9: ("RADIAL_FISHEYE", [300.0, 320.0, 240.25, 0.05, -0.01]),
}
points = np.array([[x, y, 2.0] for x in (-0.9, 0.1, 0.7) for y in (-0.5, 0.3)])
model, found = pycolmap.Reconstruction(), {}
for number, (name, params) in cameras.items():
    camera = pycolmap.Camera(camera_id=number, model=name, width=640, height=480, params=params)
    model.add_camera(camera)
    found[number] = np.asarray(camera.img_from_cam(points)).tolist()
model.write_text(sys.argv[1])
model.write_binary(sys.argv[1])
json.dump({"points": points.tolist(), "pixels": found}, sys.stdout)
