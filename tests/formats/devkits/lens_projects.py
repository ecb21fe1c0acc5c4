"""Pixels of a fisheye by OpenCV's omnidir, which is in its contributed modules: run in its own environment."""

import json
import sys

import cv2
import numpy as np

given = json.load(sys.stdin)
points, lens = np.array(given["points"])[None], np.array(given["lens"])
zero = np.zeros((1, 3))
pixels, _ = cv2.omnidir.projectPoints(points, zero, zero, np.array(given["K"]), lens[0], lens[None, 1:])
json.dump(pixels.reshape(-1, 2).tolist(), sys.stdout)
