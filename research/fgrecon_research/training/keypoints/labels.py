"""First keypoint labels without annotated keypoints: the shape that explains the boxes, projected by known poses.

All photographs of one shape share the coefficients of a linear surface model in the unit of their poses. Gauss-Newton
with Huber weights makes the projected surface of every photograph touch the edges of its box; the model's keypoints
are then projected, and rays against the same surface tell which of them can be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.geometry import MIRROR
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.io.catalogue import load_category
from fgrecon.solve.vehicle.visibility import clearance, probability
from fgrecon_research.training.keypoints.posed_cars import PosedCar
from fgrecon_research.training.priors.apollo79 import Apollo79, mirrored_half

SEEN = 0.5
"""A label counts as visible above this probability."""

_DIAGONAL = 5.0  # metres: what a unit of the poses is on a typical car
_EDGE_SIGMA = 0.05  # of the box's longer side; wider than the residuals, which poses common to four edges correlate
_HUBER = 1.5  # standard deviations
_ITERATIONS = 12
_UNMODELLED = "Coupe", "Convertible"
_REAR_WINDOW = "left_back_roof", "right_back_roof"
"""What the car models, of sedans, hatchbacks, SUVs and vans, do not tell of these bodies: it begins further ahead,
within the same outline."""


@dataclass(frozen=True)
class ShapeFit:
    """The shape behind a group of photographs."""

    coefficients: Array  # (N,) of the linear model
    offsets: Array  # (K, 3) of the keypoints beside the model, in the unit of the poses; zero after the fit to boxes
    # (M, 4) distance of the projected surface's edges from the box's, per photograph, as a fraction of the box's longer
    # side
    edge_error: Array


@dataclass(frozen=True)
class Labels:
    """Keypoints of photographs."""

    keypoints: Array  # (M, K, 2) pixels; NaN where unknown
    visible: Array  # (M, K) probability that each is visible; 0 outside the photograph


def unit_prior(models: Apollo79, basis: int = 10) -> ShapePrior:
    """A shape model in the unit of the photographs' poses: principal components of the models' surfaces.

    Every model is centred at the middle of its box and scaled to a diagonal of one. Surface and keypoints share the
    coefficients; both are symmetric.
    """
    mesh = mirrored_half((models.vertices + models.mirrored) / 2, models.faces)
    low, high = mesh.vertices.min(axis=1), mesh.vertices.max(axis=1)
    diagonal = np.linalg.norm(high - low, axis=1)[:, None, None]
    centre = ((low + high) / 2)[:, None] * [1.0, 1.0, 0.0]
    vertices = (mesh.vertices - centre) / diagonal
    vertices = (vertices + vertices[:, mesh.mirror] * MIRROR) / 2
    points = (models.keypoints - centre) / diagonal
    count = len(points)
    rows = np.concatenate([vertices, points], axis=1).reshape(count, -1)
    mean = rows.mean(axis=0)
    _, singular, directions = np.linalg.svd(rows - mean, full_matrices=False)
    signs = np.sign(directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)])
    vectors = (directions * (signs * singular / np.sqrt(count - 1))[:, None])[:basis]
    residual = rows - mean - (rows - mean) @ directions[:basis].T @ directions[:basis]
    shape = (-1, rows.shape[1] // 3, 3)
    mean, vectors = mean.reshape(shape)[0], vectors.reshape(shape)
    split = vertices.shape[1]
    return ShapePrior(
        category=load_category("car14"),
        mean=mean[split:],
        basis=vectors[:, split:],
        offset_sigma=np.sqrt((residual.reshape(shape)[:, split:] ** 2).mean(axis=(0, 2))),
        explained=(singular**2 / (singular**2).sum())[:basis],
        surface=Surface(mean[:split], vectors[:, :split], mesh.faces),
        name="car14 in unit boxes",
    )


def surface_of(prior: ShapePrior) -> Surface:
    """The surface that labels, masks and silhouettes are made with; a prior from `unit_prior` has one."""
    if prior.surface is None:
        raise ValueError("the prior has no surface")
    return prior.surface


def fit_shape(prior: ShapePrior, cars: Sequence[PosedCar]) -> ShapeFit:
    """Coefficients ~ N(0, I) of a `unit_prior` whose surface touches the edges of all boxes (robust)."""
    surface = surface_of(prior)
    rotation, translation, matrix = (
        np.array([getattr(c, f) for c in cars]) for f in ("rotation", "translation", "matrix")
    )
    boxes = np.array([car.box for car in cars])
    extent = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)[:, None]
    across, many = np.array([0, 1, 0, 1]), np.arange(len(cars))[:, None]

    def edges(coefficients: Array) -> tuple[Array, NDArray[np.intp], Array]:
        """(M, 4) residuals in fractions of the box, (M, 4) the vertices at the edges, (M, V, 3) camera points."""
        camera = np.einsum("mij,vj->mvi", rotation, surface.vertices(coefficients)) + translation[:, None]
        pixels = np.einsum("mij,mvj->mvi", matrix[:, :2], camera) / camera[..., 2:]
        vertex = np.concatenate([pixels.argmin(axis=1), pixels.argmax(axis=1)], axis=1)
        return (pixels[many, vertex, across] - boxes) / extent, vertex, camera

    coefficients = np.zeros(prior.dimension)
    for _ in range(_ITERATIONS):
        residual, vertex, camera = edges(coefficients)
        point = camera[many, vertex]  # (M, 4, 3)
        row = matrix[:, across]  # (M, 4, 3): the row of K that gives u or v
        value = np.einsum("mei,mei->me", row, point) / point[..., 2]
        gradient = (row - value[..., None] * [0.0, 0.0, 1.0]) / point[..., 2:]
        in_object = np.einsum("mei,mij->mej", gradient, rotation)
        jacobian = np.einsum("mej,nmej->men", in_object, surface.basis[:, vertex]) / extent[..., None] / _EDGE_SIGMA
        scaled = residual / _EDGE_SIGMA
        weight = np.minimum(1.0, _HUBER / np.maximum(np.abs(scaled), 1e-12))
        normal = np.einsum("me,men,mek->nk", weight, jacobian, jacobian) + np.eye(prior.dimension)
        step = np.linalg.solve(normal, np.einsum("me,men,me->n", weight, jacobian, scaled) + coefficients)
        # The vertex at an edge changes along the way, so full steps can swing from one side to the other.
        coefficients = coefficients - step / max(1.0, float(np.abs(step).max()))
    return ShapeFit(coefficients, np.zeros_like(prior.mean), edges(coefficients)[0])


def project_labels(prior: ShapePrior, fit: ShapeFit, cars: Sequence[PosedCar]) -> Labels:
    """Keypoints and their visibility in every photograph of a shape."""
    surface = surface_of(prior)
    points, vertices = prior.keypoints(fit.coefficients, fit.offsets), surface.vertices(fit.coefficients)
    keypoints = np.array([car.project(points) for car in cars])
    visible = np.zeros(keypoints.shape[:2])
    for row, car in enumerate(cars):
        centre = -car.rotation.T @ car.translation
        hidden = clearance(vertices, surface.faces, points, centre)
        inside = ((keypoints[row] >= car.box[:2]) & (keypoints[row] <= car.box[2:])).all(axis=1)
        visible[row] = np.where(inside, probability(hidden * _DIAGONAL), 0.0)
    return Labels(keypoints, visible)


def unmodelled(cars: Sequence[PosedCar], category: Category) -> NDArray[np.bool_]:
    """(M, K) which keypoints the car models do not know, by the bodies in the photographs' names."""
    bodies = np.array([any(body in car.name.split() for body in _UNMODELLED) for car in cars], dtype=bool)
    return bodies[:, None] & np.isin(category.keypoints, _REAR_WINDOW)
