"""Made-up annotations for the tests of NRSfM: a category that is no car, and images drawn from the model itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgrecon.core.category import Category

CHAIR = {
    "name": "chair",
    "keypoints": [
        "left_front_foot",
        "right_front_foot",
        "left_back_foot",
        "right_back_foot",
        "left_front_seat",
        "right_front_seat",
        "left_back_seat",
        "right_back_seat",
        "left_back_top",
        "right_back_top",
        "backrest_centre",
    ],
    "symmetric_pairs": [
        ["left_front_foot", "right_front_foot"],
        ["left_back_foot", "right_back_foot"],
        ["left_front_seat", "right_front_seat"],
        ["left_back_seat", "right_back_seat"],
        ["left_back_top", "right_back_top"],
    ],
    "faces": [],
    "edges": [
        ["left_front_foot", "left_front_seat"],
        ["right_front_foot", "right_front_seat"],
        ["left_back_foot", "left_back_seat"],
        ["left_back_seat", "left_back_top"],
        ["left_back_top", "right_back_top"],
    ],
    "dimensions": {
        "length": {
            "plus": ["left_front_foot", "right_front_foot"],
            "minus": ["left_back_foot", "right_back_foot"],
            "ratio": 0.9,
        },
        "width": {"plus": ["left_front_seat"], "minus": ["right_front_seat"], "ratio": 0.95},
        "height": {
            "plus": ["left_back_top", "right_back_top"],
            "minus": ["left_front_foot", "right_front_foot", "left_back_foot", "right_back_foot"],
            "ratio": 1.0,
        },
    },
    "ground": {
        "keypoints": ["left_front_foot", "right_front_foot", "left_back_foot", "right_back_foot"],
        "ratio": 0.0,
    },
}
"""Content of a category file: x forward (where the sitter looks), y down, z left."""


def chair() -> Category:
    return Category.from_dict(CHAIR)


def chair_mean() -> np.ndarray:
    left = np.array(
        [[0.22, 0.0, 0.21], [-0.23, 0.0, 0.2], [0.2, -0.45, 0.22], [-0.2, -0.46, 0.2], [-0.27, -0.92, 0.19]]
    )
    shape = np.empty((11, 3))
    shape[0:10:2], shape[1:10:2] = left, left * [1, 1, -1]
    shape[10] = [-0.26, -0.7, 0.0]
    return shape


@dataclass(frozen=True)
class World:
    """Truth and images: mean (K, 3), basis (N, K, 3), noise sigma, keypoints (M, K, 2) without and with gaps."""

    mean: np.ndarray
    basis: np.ndarray
    sigma: float
    complete: np.ndarray
    keypoints: np.ndarray
    coefficients: np.ndarray


def draw_world(
    seed: int,
    count: int = 200,
    vectors: int = 2,
    sigma: float = 0.005,
    missing: float = 0.4,
    nearness: float = 0.0,
) -> World:
    """Images of chairs from all around, up to 50 degrees from above, each drawn from the linear model."""
    rng = np.random.default_rng(seed)
    mean, mirror = chair_mean(), chair().mirror
    basis = rng.standard_normal((vectors, 11, 3))
    basis = 0.5 * (basis + basis[:, mirror] * [1, 1, -1])
    basis *= (0.03 * 0.7 ** np.arange(vectors))[:, None, None]
    z = rng.standard_normal((count, vectors))
    shapes = mean + np.tensordot(z, basis, axes=1)
    azimuth, elevation, roll = rng.uniform(-np.pi, np.pi, count), rng.uniform(0, 0.9, count), rng.normal(0, 0.1, count)
    points = np.empty((count, 11, 2))
    for m, shape in enumerate(shapes):
        turn = _about(1, azimuth[m]).T @ _about(0, 0.0)
        camera = _about(2, roll[m]) @ _about(0, elevation[m]) @ turn
        seen = (shape - shape.mean(axis=0)) @ camera.T
        flat = seen[:, :2] / (1.0 + nearness * seen[:, 2:])
        scale = rng.uniform(100, 900)
        points[m] = scale * (flat + sigma * rng.standard_normal((11, 2))) + rng.uniform(0, 1000, 2)
    keypoints = points.copy()
    keypoints[rng.random((count, 11)) < missing] = np.nan
    return World(mean, basis, sigma, points, keypoints, z)


def _about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def best_similarity(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Umeyama without reflection, written on its own as an oracle: moved source, rotation, scale."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    d = np.diag([1, 1, np.linalg.det(u @ vt)])
    rotation, scale = u @ d @ vt, np.trace(np.diag(s) @ d) / (a**2).sum()
    return scale * a @ rotation.T + target.mean(0), rotation, scale
