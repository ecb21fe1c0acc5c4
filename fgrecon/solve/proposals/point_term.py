"""Measured points as an energy term of the search: those about where a vehicle's keypoints and box are, and not more.

Taken are points on rays through the vehicle's 2D box, somewhat enlarged, at depths at which some vehicle fills it. That
is generous on purpose: which of them are the vehicle's is decided by the energy (`factors.surface_points`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from factors.surface_patches import SurfacePatches
from factors.surface_points import PointRows
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.evidence import Points
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import Hypotheses, Quadratic
from fgrecon.solve.vehicle.model import VehicleModel

Array = NDArray[np.float64]

POINTS = SETTINGS.points


@dataclass(frozen=True)
class PointTerm:
    """Points on the vehicle's surface, or on anything else.

    Attributes:
        rows: The points about the vehicle.
    """

    rows: PointRows
    name: ClassVar[str] = "points"

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        rows, root = self.rows, self.rows.share**0.5
        size = 6 + h.coefficients.shape[1]
        residual, jacobian = np.zeros((len(h), len(rows.points))), np.zeros((len(h), len(rows.points), size))
        for i in range(len(h)):
            state = h.rotation[i], h.translation[i], h.coefficients[i]
            match = rows.match(*state)
            off, by = rows.distances(match, *state, want=True)
            assert by is not None
            weights, energy = rows.assess(match, off)
            scale = root * np.sqrt(weights)
            total.energy[i] += energy
            residual[i], jacobian[i] = scale * off, scale[:, None] * by
        jacobian[..., 3:6] = jacobian[..., 3:6] @ h.rotation.transpose(0, 2, 1)
        total.add(residual, jacobian)

    def energies(self, h: Hypotheses) -> Array:
        """(H,) energies of the hypotheses, nats."""
        found = np.zeros(len(h))
        for i in range(len(h)):
            state = h.rotation[i], h.translation[i], h.coefficients[i]
            match = self.rows.match(*state)
            found[i] = self.rows.assess(match, self.rows.distances(match, *state, want=False)[0])[1]
        return found


def point_term(observation: Observation, camera: Camera, model: VehicleModel) -> PointTerm | None:
    """The points of an observation's evidence about its vehicle; None where there are too few."""
    given = [one for one in observation.evidence if isinstance(one, Points)]
    prior = model.prior
    if not given or prior.surface is None:
        return None
    points, sigma, origin = [], [], np.asarray(given[0].origin, dtype=np.float64)
    for one in given:
        index = _about(one.points, observation, camera)
        points.append(one.points[index])
        sigma.append(np.broadcast_to(np.asarray(one.sigma), (len(one.points),))[index])
    kept, noise = np.concatenate(points), np.concatenate(sigma)
    if len(kept) > POINTS.most_points:
        index = np.linspace(0, len(kept) - 1, POINTS.most_points).astype(np.intp)
        kept, noise = kept[index], noise[index]
    if len(kept) < POINTS.least_points:
        return None
    share = POINTS.independent_points / (POINTS.independent_points + len(kept))
    noise = np.hypot(noise, POINTS.surface_sigma_m)
    rows = PointRows(
        kept, noise, origin, _patches(prior), model.dimension_mean, model.dimension_basis, POINTS.odds, share
    )
    return PointTerm(rows)


@lru_cache(maxsize=16)
def _patches(prior: ShapePrior) -> SurfacePatches:
    assert prior.surface is not None
    return SurfacePatches.of(prior.surface.mean, prior.surface.basis, prior.surface.faces)


def _about(points: Array, observation: Observation, camera: Camera) -> NDArray[np.intp]:
    """Indices of the points (N, 3) about where a vehicle must be, thinned to one a cell."""
    box = observation.place
    if box is None:
        return np.zeros(0, dtype=np.intp)
    size = box[2:] - box[:2]
    margin = POINTS.frustum_margin * float(size.max())
    focal = float(camera.matrix[1, 1])
    nearest, farthest = (focal * metres / float(size[1]) for metres in POINTS.heights_m)
    if camera.image_size is not None and (
        box[1] <= SETTINGS.border_pixels or box[3] >= camera.image_size[1] - 1.0 - SETTINGS.border_pixels
    ):
        nearest = 0.0  # the image shows a part of its height
    index = np.flatnonzero((points[:, 2] > max(nearest, MIN_DEPTH)) & (points[:, 2] < farthest))
    homogeneous = points[index] @ camera.matrix.T
    pixels = homogeneous[:, :2] / homogeneous[:, 2:]
    inside = np.all((pixels > box[:2] - margin) & (pixels < box[2:] + margin), axis=1)
    index = index[inside]
    cells = np.floor(points[index] / POINTS.cell_m).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return index[np.sort(first)]
