"""A made-up drive: simulated cars over a few frames, as images that show nothing and a keypoint file."""

from __future__ import annotations

import json

import numpy as np

from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate_track

SIZE = (1242, 375)


def simulated(count, seeds=(25, 7)):
    """For each car its observations, one a frame."""
    prior = load_prior("car14")
    cars = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        cars.append([seen for seen, _ in simulate_track(Vehicle.sample(prior, rng), count, rng)])
    return cars


def instance(seen, number, track):
    """An observation as an instance of a keypoint file."""
    points = [None if np.isnan(point).any() else point.tolist() for point in seen.keypoints]
    made = {"id": f"{number}-{track}", "frame": number, "track": track, "keypoints": points}
    made |= {"confidence": seen.confidence.tolist(), "confidence_midpoint": seen.confidence_midpoint}
    return made | ({} if seen.box is None else {"box": seen.box.tolist()})


def make_drive(folder, count=8, *, tracks=True):
    """A folder of images, numbered from 3 with one missing, and the keypoint file of its cars."""
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(0)
    cars = simulated(count)
    instances = []
    for place in range(count):
        number = 3 + place + (place >= 4)
        write_png(folder / "images" / f"{number:06d}.png", rng.integers(0, 255, (*SIZE[::-1], 3), dtype=np.uint8))
        for track, seen in enumerate(cars):
            made = instance(seen[place], number, 10 + track)
            if not tracks:
                del made["track"]
            instances.append(made)
    file = folder / "keypoints.json"
    file.write_text(json.dumps({"K": KITTI_CAMERA.matrix.tolist(), "instances": instances}))
    return folder / "images", file
