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


def rendered(motion, camera, rng_seed=0):
    """(375, 1242) image of a road and a wall 40 m ahead, both patterned, from a camera that has moved."""
    import cv2

    rng = np.random.default_rng(rng_seed)
    columns, rows = np.meshgrid(np.arange(1242.0), np.arange(375.0))
    rays = camera.rays(np.stack([columns, rows], axis=-1)) @ motion[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        to_road, to_wall = (1.65 - motion[1, 3]) / rays[..., 1], (40.0 - motion[2, 3]) / rays[..., 2]
    on_road = (to_road > 0) & (to_road < to_wall)
    places = motion[:3, 3] + rays * np.where(on_road, to_road, to_wall)[..., None]
    seen = []
    for axis, metre in ((2, 20.0), (1, 8.0)):
        pattern = cv2.GaussianBlur(rng.normal(0, 300, (900, 900)), (0, 0), 1.5)
        at = (places[..., [0, axis]] * metre + 450.0).astype(np.float32)
        seen.append(cv2.remap(pattern, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
    return np.clip(np.where(on_road, *seen) + 128, 0, 255).astype(np.uint8)


def make_drive(folder, count=8, *, tracks=True, metres=None):
    """A folder of images, numbered from 3 with one missing, and the keypoint file of its cars.

    The images show nothing, or a road on which the camera goes so many metres from number to number.
    """
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(0)
    cars = simulated(count)
    instances = []
    for place in range(count):
        number = 3 + place + (place >= 4)
        image = rng.integers(0, 255, (*SIZE[::-1], 3), dtype=np.uint8)
        if metres is not None:
            ahead = np.eye(4)
            ahead[2, 3] = metres * (number - 3)
            image = np.repeat(rendered(ahead, KITTI_CAMERA)[..., None], 3, axis=2)
        write_png(folder / "images" / f"{number:06d}.png", image)
        for track, seen in enumerate(cars):
            made = instance(seen[place], number, 10 + track)
            if not tracks:
                del made["track"]
            instances.append(made)
    file = folder / "keypoints.json"
    file.write_text(json.dumps({"K": KITTI_CAMERA.matrix.tolist(), "instances": instances}))
    return folder / "images", file
