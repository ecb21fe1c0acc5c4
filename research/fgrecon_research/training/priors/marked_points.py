"""Points that people marked in images, located on the car models of ApolloCar3D: shapes for priors of more keypoints.

A point is first looked for on all models at once: the vertex of their common topology that is nearest to the marks of
all cars, and an offset from it, the same for all models and mirrored for its mirror image. That is what a model without
marks has (imputed). On a model with marks the point then moves to where they meet, held by a Gaussian: the fewer its
marks, the nearer it stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR, pixel_jacobian
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.catalogue import load_category
from fgrecon.io.keypoints.names import parse_names
from fgrecon_research.io.annotations.offsets import robust_offset
from fgrecon_research.training.priors.apollo79 import Apollo79, kept_models, surface_samples
from fgrecon_research.training.priors.pca import pca_prior

SCHEME = "apollo66"
"""The points that were marked."""

_FEWEST = 10  # marks of a point and its mirror image, below which nobody knows where it is
_CAP = 0.3  # metres; marks farther off do not say more about which vertex it is
_SIGMA = 0.05  # metres: residual of a mark, at its distance, up to which it counts fully
_SPREAD = 0.05  # metres: how far a point of a model lies from where the others have it
_WEAK = 1e-3  # draws the common offset to the vertex


@dataclass(frozen=True, eq=False)
class PosedMarks:
    """The marks of one car of known pose and model."""

    model: int  # index of its model
    pixels: Array  # (P, 2) marks, NaN where there is none
    camera_T_object: Array  # (4, 4) pose, metres, of the model in the size in which its pose was labelled


@dataclass(frozen=True, eq=False)
class LocatedPoints:
    """Where the points are."""

    points: Array  # (M, P, 3) in the object frame, metres, exactly mirror-symmetric
    marks: NDArray[np.int64]  # (M, P) number of marks of each point of each model and of its mirror image; 0: imputed
    residual: Array  # (P,) median distance of the marks from the points, metres at their distance; NaN without marks


def located_points(cars: Sequence[PosedMarks], camera: Camera, models: Apollo79, category: Category) -> LocatedPoints:
    """Locate every keypoint of a category on every model.

    Raises:
        InvalidInputError: Too few marks of a keypoint; names it.
    """
    count, size = len(models.names), category.size
    labelled = models.vertices / models.scale[:, None, None]
    points, marks, residual = np.zeros((count, size, 3)), np.zeros((count, size), np.int64), np.zeros(size)
    for point, mirrored in enumerate(category.mirror.tolist()):
        if point > mirrored:
            continue
        sides = ((point, np.ones(3)), (mirrored, MIRROR)) if point != mirrored else ((point, np.ones(3)),)
        rays = [_Ray.of(car, k, side) for car in cars for k, side in sides if np.isfinite(car.pixels[k, 0])]
        if len(rays) < _FEWEST:
            name = category.keypoints[point]
            raise InvalidInputError(f"marks of {name}", len(rays), f"Give cars with {_FEWEST} marks of it at least.")
        vertex = _nearest_vertex(rays, camera, labelled)
        start = labelled[:, vertex]
        start = start + _offset(rays, camera, start, _WEAK)
        for model in range(count):
            own = [ray for ray in rays if ray.model == model]
            marks[model, [point, mirrored]] = len(own)
            if own:  # the common offset's Gaussian, in the unit of robust weights
                start[model] += _offset(own, camera, start, _SIGMA / _SPREAD**2 / len(own))
        points[:, point], points[:, mirrored] = start, start * MIRROR
        residual[[point, mirrored]] = np.median(np.linalg.norm(_residuals(rays, camera, start)[1], axis=1))
    return LocatedPoints(points * models.scale[:, None, None], marks, residual)


def marked_prior(located: LocatedPoints, models: Apollo79, category: Category) -> ShapePrior:
    """The prior of a category whose keypoints are among the 66 of ApolloCar3D, or centres of some of them.

    Args:
        located: Where the 66 points are.
        category: `apollo66` itself, or one to which its names lead.

    Raises:
        InvalidInputError: The category is none of these.
    """
    names = load_category(SCHEME).keypoints
    groups = parse_names(SCHEME, category).groups
    columns = [[names.index(name) for name in groups.get(keypoint, (keypoint,))] for keypoint in category.keypoints]
    keep = kept_models(models, ())
    shapes = np.stack([located.points[keep][:, column].mean(axis=1) for column in columns], axis=1)
    marked = int((located.marks[keep].sum(axis=1) > 0).sum())
    return pca_prior(
        category,
        shapes,
        surface=surface_samples(models, keep),
        name=category.name,
        provenance={
            "source": (
                f"{len(keep)} of the 79 car models of ApolloCar3D; keypoints from the marks of people on cars of "
                f"{marked} of them, imputed by the common topology on the others"
            ),
            "terms": "ApolloScape terms (research); see the model card",
        },
    )


@dataclass(frozen=True, eq=False)
class _Ray:
    """One mark of a point, or of its mirror image: then the car is mirrored, which is the same in one image."""

    model: int
    pixel: Array
    rotation: Array  # (3, 3), with the mirror image's sign in it
    origin: Array

    @classmethod
    def of(cls, car: PosedMarks, point: int, side: Array) -> _Ray:
        return cls(car.model, car.pixels[point], car.camera_T_object[:3, :3] * side, car.camera_T_object[:3, 3])


def _nearest_vertex(rays: Sequence[_Ray], camera: Camera, vertices: Array) -> int:
    """The vertex of all models (M, V, 3) that the marks are nearest to, on average."""
    cost = np.zeros(vertices.shape[1])
    for ray in rays:
        in_camera = vertices[ray.model] @ ray.rotation.T + ray.origin
        off = np.linalg.norm(camera.project(in_camera) - ray.pixel, axis=1) * in_camera[:, 2] / camera.matrix[0, 0]
        cost += np.minimum(off, _CAP)
    return int(cost.argmin())


def _residuals(rays: Sequence[_Ray], camera: Camera, points: Array) -> tuple[Array, Array]:
    """Derivatives (N, 2, 3) of the marks by their points, and residuals (N, 2), in metres at the points' distance."""
    rotations = np.array([ray.rotation for ray in rays])
    in_camera = np.array([ray.rotation @ points[ray.model] + ray.origin for ray in rays])
    scale = in_camera[:, 2] / camera.matrix[0, 0]
    jacobian = pixel_jacobian(camera.matrix, in_camera) @ rotations
    away = np.array([ray.pixel for ray in rays]) - camera.project(in_camera)
    return scale[:, None, None] * jacobian, scale[:, None] * away


def _offset(rays: Sequence[_Ray], camera: Camera, points: Array, weak: float) -> Array:
    """(3,) offset from points (M, 3) that the rays agree on."""
    jacobian, residual = _residuals(rays, camera, points)
    return robust_offset(jacobian, residual, np.ones(len(rays)), _SIGMA, weak)
