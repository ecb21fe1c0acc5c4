"""Random PnP problems with known answers, easy to nearly singular; shared by the tests and the benchmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["KINDS", "PnPProblem", "aspnp_cost", "random_problem"]

Array = NDArray[np.float64]

KINDS = ("solid", "planar", "nearly planar", "nearly on a line", "deep")


@dataclass(frozen=True)
class PnPProblem:
    """A camera's view of points.

    Attributes:
        points: (N, 3) in the object frame.
        image_points: (N, 2) normalised image coordinates, with noise and outliers.
        repeats: (N,) integer weights from 1.
        camera_T_object: (4, 4) the pose.
        kind: One of `KINDS`.
        noise: Standard deviation of the noise, relative to the rms radius of the image points.
        outliers: How many image points are wrong.
    """

    points: Array
    image_points: Array
    repeats: NDArray[np.int64]
    camera_T_object: Array
    kind: str
    noise: float
    outliers: int


def random_problem(rng: np.random.Generator) -> PnPProblem:
    """4 to 50 points seen under a random rotation from 1.3 to 130 times their radius, all in front of the camera.

    A quarter are planar, a third nearly singular; the noise goes up to 10 % of the image's radius, and three in ten
    have outliers, up to 30 % of the points.
    """
    count = int(rng.integers(4, 51) if rng.random() < 0.6 else rng.integers(4, 8))
    kind = str(rng.choice(KINDS, p=[0.35, 0.25, 0.15, 0.1, 0.15]))
    points = rng.uniform(-1, 1, size=(count, 3)) if rng.random() < 0.5 else rng.normal(size=(count, 3))
    if kind == "planar":
        points[:, 2] = 0
    elif kind == "nearly planar":
        points[:, 2] *= 10 ** rng.uniform(-6, -1)
    elif kind == "nearly on a line":
        points[:, 1:] *= 10 ** rng.uniform(-2, -0.5)
    points = Rotation.random(rng=rng).apply(points)
    rotation = Rotation.random(rng=rng).as_matrix()
    radius = float(np.linalg.norm(points, axis=1).max())
    distance = radius * (1.02 if kind == "deep" else 1.3 * 10 ** rng.uniform(0, 2))
    direction = np.append(rng.uniform(-0.7, 0.7, size=2), 1.0)
    if kind == "deep":  # the nearest point is up to 100 times closer than the farthest
        direction[:2] = 0
    translation = distance * direction
    in_camera = points @ rotation.T + translation
    image_points = in_camera[:, :2] / in_camera[:, 2:]
    image_radius = float(np.sqrt(((image_points - image_points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    noise = float(rng.choice([0, 1e-6, 1e-3, 0.01, 0.03, 0.1]))
    image_points += rng.normal(size=(count, 2)) * noise * image_radius
    wrong = rng.random(count) < (rng.uniform(0, 0.3) if rng.random() < 0.3 else 0)
    image_points[wrong] += rng.normal(size=(int(wrong.sum()), 2)) * image_radius
    unit = 10 ** rng.uniform(-2, 2)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, unit * translation
    repeats = rng.integers(1, 4, size=count) if rng.random() < 0.3 else np.ones(count, dtype=np.int64)
    return PnPProblem(unit * points, image_points, repeats, pose, kind, noise, int(wrong.sum()))


def aspnp_cost(points, image_points, weights, camera_T_object) -> float:
    """The cost that `aspnp` minimises, at any pose; infinite where the centroid is not in front of the camera."""
    points, image_points = np.asarray(points), np.asarray(image_points)
    weights = np.ones(len(points)) if weights is None else np.asarray(weights, dtype=np.float64)
    in_camera = points @ camera_T_object[:3, :3].T + camera_T_object[:3, 3]
    depth = float(weights @ in_camera[:, 2] / weights.sum())
    if depth <= 0:
        return float("inf")
    errors = (in_camera[:, :2] - image_points * in_camera[:, 2:]) / depth
    return float(weights @ (errors * errors).sum(axis=1))
