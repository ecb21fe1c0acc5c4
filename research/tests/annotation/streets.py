"""Made-up streets: images on disk with labels in KITTI's formats, and a detector that returns given keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fgrecon.core.geometry import view_azimuth
from fgrecon.core.observation import Observation
from fgrecon.io.images import write_png
from tests.cars import project, yaw_pose

MATRIX = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 120.0], [0.0, 0.0, 1.0]])
SIZE = 640, 240
P2 = "P2: 700 0 320 0 0 700 120 0 0 0 1 0\n"


def directions(pose):
    """(36,) what a network says of the direction that a car in a pose is seen from."""
    centres = 2.0 * np.pi * np.arange(36) / 36
    seen = np.exp((np.cos(centres - view_azimuth(pose[:3, :3], pose[:3, 3])) - 1.0) / 0.1) + 1e-4
    return seen / seen.sum()


@dataclass
class Car:
    """The prior's mean car at a place."""

    location: tuple
    yaw: float
    kind: str = "Car"
    occlusion: int = 0
    truncation: float = 0.0
    boxed: bool = True

    def pose(self):
        return yaw_pose(self.yaw, self.location)

    def keypoints(self, prior):
        return project(prior.mean, self.pose(), MATRIX)

    def box(self, prior):
        outline = project(prior.surface.mean, self.pose(), MATRIX)
        return np.clip([*outline.min(axis=0), *outline.max(axis=0)], 0.0, [SIZE[0] - 1, SIZE[1] - 1] * 2)

    def line(self, prior):
        """Its line of a label file."""
        length, width, height = prior.box_size(np.zeros(prior.dimension))
        box = " ".join(f"{value:.3f}" for value in self.box(prior))
        x, y, z = self.location
        known = f"{height:.4f} {width:.4f} {length:.4f} {x} {y} {z} {self.yaw}"
        rest = known if self.boxed else "-1 -1 -1 -1000 -1000 -1000 -10"
        return f"{self.kind} {self.truncation} {self.occlusion} 0 {box} {rest}"


def write_drive(folder, prior, frames):
    """A drive of frames, each a mapping from the number of the track to its `Car`."""
    (folder / "image_02").mkdir(parents=True)
    lines = []
    for number, cars in enumerate(frames):
        write_png(folder / "image_02" / f"{number:06d}.png", np.full((SIZE[1], SIZE[0], 3), number, dtype=np.uint8))
        lines += [f"{number} {track} {car.line(prior)}\n" for track, car in cars.items()]
    (folder / "label_02.txt").write_text("".join(lines))
    (folder / "calib.txt").write_text(P2)
    return folder


@dataclass
class GivenKeypoints:
    """A detector that knows the cars: the image's grey value is the frame's number.

    Attributes:
        frames: The cars of each frame.
        prior: Their shape.
        noise: Standard deviation of the keypoints, pixels.
        changed: Called with frame, the car's `Car` and keypoints (K, 2); returns what is found instead.
    """

    frames: list
    prior: object
    noise: float = 0.0
    changed: object = None
    category: str = "car14"
    rng: object = field(default_factory=lambda: np.random.default_rng(0))

    def __call__(self, image, boxes, /):
        number = int(image[0, 0, 0])
        found = []
        for box in boxes:
            cars = self.frames[number].values()
            car = min(cars, key=lambda car: np.abs(car.box(self.prior) - box).max())
            points = car.keypoints(self.prior)
            points = points + self.noise * self.rng.standard_normal(points.shape)
            confidence = np.full(len(points), 0.9)
            if self.changed is not None:
                points, confidence = self.changed(number, car, points, confidence)
            found.append(Observation(points, confidence, box, confidence_midpoint=0.5, azimuth=directions(car.pose())))
        return found
