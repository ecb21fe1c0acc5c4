"""Shape and poses of photographs of one shape, from the silhouettes of the car in them.

Boxes alone leave the shape's roof, width and wheels to the model, and are drawn a little too large. The outline of the
projected surface has to meet the outline of the car: Gauss-Newton over the coefficients that all photographs share and
a correction of each photograph's measured pose, with the signed distance to the car's outline as residual. From
twice as far away and with twice the focal length a car looks much the same, so that what was measured of both is least
sure: a dolly zoom is part of the correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import pixel_jacobian
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon_research.training.keypoints.dataset import fill_faces, read_silhouette
from fgrecon_research.training.keypoints.deform import sampled
from fgrecon_research.training.keypoints.labels import ShapeFit, surface_of
from fgrecon_research.training.keypoints.posed_cars import PosedCar
from fgrecon_research.training.keypoints.relabel import SHIFT_SIGMA, TURN_SIGMA

_SIDE = 192  # pixels of the silhouette's longer side
_PAD = 48  # pixels around it
_SPACING = 5  # pixels between the points of the outline
_SIGMA = 0.02  # of a point, as a fraction of the longer side
_INDEPENDENT = 250.0  # points' worth that one photograph counts
_HUBER = 0.5  # standard deviations
_FAR = 0.06  # of the longer side: a point that far off counts a quarter
_OVERLAP = 0.75  # intersection over union with the projected start below which a silhouette is not believed
_ITERATIONS = 10
_STEP, _TURN_STEP = 0.7, 0.1  # largest change of a coefficient, and of a pose, in one iteration
_ZOOM_SIGMA = 0.45  # of the logarithm of the measured distance and focal length: one looks much like the other
_OUTSIDE = 0.02  # of the longer side by which a keypoint has to be beyond the outline
_CONTRADICTED = 0.3  # share of the photographs in which it has to be for its place to be wrong
_ENOUGH = 5  # photographs that can tell


@dataclass(frozen=True)
class Outline:
    """A car's silhouette."""

    mask: NDArray[np.uint8]  # (288, 288) 1 on the car, 0 elsewhere: the photograph at `scale`, 48 pixels in
    distance: Array  # signed distance from the outline, positive outside, pixels of the mask
    scale: float  # pixels of the mask per pixel of the photograph

    @classmethod
    def of(cls, likelihood: NDArray[np.uint8]) -> Outline | None:
        """The largest part of an (H, W) image of values from 0 to 255, without thin parts; None if it is empty."""
        scale = _SIDE / max(likelihood.shape)
        small = cv2.resize(likelihood, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        square = np.zeros((_SIDE + 2 * _PAD,) * 2, dtype=np.uint8)
        square[_PAD : _PAD + small.shape[0], _PAD : _PAD + small.shape[1]] = small > 127
        square = np.asarray(cv2.morphologyEx(square, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)), dtype=np.uint8)
        count, parts, statistics, _ = cv2.connectedComponentsWithStats(square)
        if count < 2:
            return None
        mask = (parts == 1 + statistics[1:, cv2.CC_STAT_AREA].argmax()).astype(np.uint8)
        return cls(mask, _signed_distance(mask), scale)

    def to_mask(self, pixels: Array) -> Array:
        """Places (..., 2) in the mask of pixels (..., 2) of the photograph."""
        return (pixels + 0.5) * self.scale - 0.5 + _PAD

    @cached_property
    def _fields(self) -> tuple[NDArray[np.float32], ...]:
        """The distance and its derivatives to the right and down."""
        down, right = np.gradient(self.distance)
        return tuple(np.asarray(field, dtype=np.float32) for field in (self.distance, right, down))

    def residuals(self, pixels: Array) -> tuple[Array, Array]:
        """Signed distances (N,) of pixels (N, 2) of the photograph from the outline, as fractions of the longer side.

        Returns:
            The distances, and their derivatives (N, 2) by the pixels.
        """
        places = self.to_mask(pixels)
        value, du, dv = (sampled(field, places) for field in self._fields)
        return value / _SIDE, np.column_stack([du, dv]) * (self.scale / _SIDE)


@dataclass(frozen=True)
class OutlineFit:
    """What the silhouettes say."""

    fit: ShapeFit  # the shape
    cars: tuple[PosedCar, ...]  # the photographs, with corrected poses where the silhouette was believed
    used: NDArray[np.bool_]  # (M,) where it was


@dataclass
class _Pose:
    """A photograph on the way: its pose in the camera's frame, and the logarithm of its dolly zoom so far."""

    car: PosedCar
    outline: Outline
    rotation: Array
    translation: Array
    zoom: float = 0.0

    def turned_by(self) -> Array:
        """Rotation vector (3,) from the measured to the present rotation."""
        return np.asarray(cv2.Rodrigues(self.rotation @ self.car.rotation.T)[0], dtype=np.float64).ravel()

    def move(self, step: Array) -> None:
        """Turn, shift and zoom by (7,)."""
        step = step * min(1.0, _TURN_STEP / max(float(np.abs(step).max()), 1e-12))
        self.rotation = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64) @ self.rotation
        self.zoom += float(step[6])
        factor = float(np.exp(step[6]))
        self.car = self.car.zoomed(factor)
        self.translation = (self.translation + step[3:6]) * factor


def read_outline(path: Path, size: tuple[int, int]) -> Outline | None:
    """The silhouette in a grey image file as large as the photograph; None without one, or if it is empty.

    Args:
        size: (width, height) of the photograph, pixels.

    Raises:
        InvalidInputError: The file is no image, or of another size.
    """
    return Outline.of(read_silhouette(path, size)) if path.exists() else None


def fit_outlines(
    prior: ShapePrior, cars: Sequence[PosedCar], outlines: Sequence[Outline | None], start: ShapeFit
) -> OutlineFit:
    """The coefficients ~ N(0, I) and poses whose projected surface meets the silhouettes.

    Args:
        prior: Model with a surface, from `unit_prior`.
        outlines: Their silhouettes, None where there is none.
    """
    surface = surface_of(prior)
    vertices = surface.vertices(start.coefficients)
    poses = {
        number: _Pose(car, outline, car.rotation, car.translation)
        for number, (car, outline) in enumerate(zip(cars, outlines, strict=True))
        if outline is not None and _overlap(surface, vertices, car, outline) >= _OVERLAP
    }
    coefficients = start.coefficients.copy()
    for _ in range(_ITERATIONS if poses else 0):
        vertices = surface.vertices(coefficients)
        # Photographs share nothing but the coefficients, so that each pose is eliminated by itself.
        normal, gradient, parts = np.eye(prior.dimension), coefficients.copy(), []
        for pose in poses.values():
            residual, by_pose, by_shape, weight = _outline_rows(surface, vertices, pose)
            precision = np.concatenate([np.full(3, TURN_SIGMA**-2), SHIFT_SIGMA**-2, [_ZOOM_SIGMA**-2]])
            away = np.concatenate([pose.turned_by(), pose.translation - pose.car.translation, [pose.zoom]])
            own = np.diag(precision) + (by_pose * weight[:, None]).T @ by_pose
            own_gradient = precision * away + by_pose.T @ (weight * residual)
            cross = (by_pose * weight[:, None]).T @ by_shape
            solved = np.linalg.solve(own, np.column_stack([cross, own_gradient]))
            normal += (by_shape * weight[:, None]).T @ by_shape - cross.T @ solved[:, :-1]
            gradient += by_shape.T @ (weight * residual) - cross.T @ solved[:, -1]
            parts.append((pose, solved))
        step = -np.linalg.solve(normal, gradient)
        step *= min(1.0, _STEP / max(float(np.abs(step).max()), 1e-12))
        for pose, solved in parts:
            pose.move(-solved[:, -1] - solved[:, :-1] @ step)
        coefficients = coefficients + step
    corrected = [
        replace(poses[n].car, rotation=poses[n].rotation, translation=poses[n].translation) if n in poses else car
        for n, car in enumerate(cars)
    ]
    used = np.array([n in poses for n in range(len(cars))])
    return OutlineFit(ShapeFit(coefficients, start.offsets, start.edge_error), tuple(corrected), used)


def _outline_rows(surface: Surface, vertices: Array, pose: _Pose) -> tuple[Array, Array, Array, Array]:
    """Of the vertices on the projected outline: residuals (N,), derivatives by pose (N, 7) and shape, weights (N,)."""
    car, outline = pose.car, pose.outline
    camera = vertices @ pose.rotation.T + pose.translation
    homogeneous = camera @ car.matrix.T
    pixels = homogeneous[:, :2] / homogeneous[:, 2:]
    places = outline.to_mask(pixels)
    drawn = np.minimum(_draw(places, surface), 1)
    contours, _ = cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=len)[::_SPACING, 0].astype(np.float64)
    vertex = np.unique(cKDTree(places).query(contour)[1])
    residual, slope = outline.residuals(pixels[vertex])
    # The vertices next to the drawn outline lie a little inside it, and should as far inside the car's.
    residual = residual - sampled(_signed_distance(drawn), places[vertex]) / _SIDE
    in_camera = np.einsum("ni,nij->nj", slope, pixel_jacobian(car.matrix, camera[vertex])) / _SIGMA
    from_centre = np.einsum("ni,ni->n", slope, pixels[vertex] - car.project(np.zeros(3))) / _SIGMA
    zoom = from_centre + in_camera @ pose.translation
    turn = np.cross(camera[vertex] - pose.translation, in_camera)
    by_pose = np.column_stack([turn, in_camera, zoom])
    by_shape = np.einsum("nj,jk,mnk->nm", in_camera, pose.rotation, surface.basis[:, vertex])
    away = np.abs(residual)
    weight = np.minimum(1.0, _HUBER * _SIGMA / np.maximum(away, 1e-12)) / (1.0 + (away / _FAR) ** 2) ** 2
    return residual / _SIGMA, by_pose, by_shape, weight * (_INDEPENDENT / len(vertex))


def contradicted(outlines: Sequence[Outline | None], keypoints: Array, mirror: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which keypoints the silhouettes of a shape say are elsewhere: those that often lie beyond the outline.

    A shape model knows sedans and vans; on a pickup or a convertible its rear window floats in the air.

    Args:
        outlines: Silhouettes of M photographs, None where there is none.
        keypoints: (M, K, 2) pixels of the photographs.
        mirror: (K,) index of each keypoint's mirror image, which counts with it.
    """
    away = np.array([o.residuals(points)[0] for o, points in zip(outlines, keypoints, strict=True) if o is not None])
    if len(away) < _ENOUGH:
        return np.zeros(len(mirror), dtype=bool)
    outside = np.maximum(away, away[:, mirror]) > _OUTSIDE
    return outside.mean(axis=0) > _CONTRADICTED


def _signed_distance(mask: NDArray[np.uint8]) -> Array:
    """Distance of every pixel from the outline of a mask of ones and zeros, positive outside."""
    away = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) - cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    return np.asarray(cv2.GaussianBlur(away, (0, 0), 1.0), dtype=np.float64)


def _overlap(surface: Surface, vertices: Array, car: PosedCar, outline: Outline) -> float:
    """Intersection over union of the projected surface and the silhouette."""
    drawn = _draw(outline.to_mask(car.project(vertices)), surface) > 0
    return float((drawn & (outline.mask > 0)).sum() / max(int((drawn | (outline.mask > 0)).sum()), 1))


def _draw(places: Array, surface: Surface) -> NDArray[np.uint8]:
    """The projected surface in a silhouette's mask."""
    return fill_faces(places[surface.faces], _SIDE + 2 * _PAD)
