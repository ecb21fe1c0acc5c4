"""A vehicle's silhouette as an energy term of the search: the same rows as in the graph (`factors.silhouette`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from factors.distance_field import DistanceField
from factors.mixture import mixture
from factors.silhouette import SilhouetteOdds, SilhouetteRows
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.mask import Mask, joined
from fgrecon.core.observation import Observation
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import Hypotheses, Quadratic
from fgrecon.solve.vehicle.model import VehicleModel

MASKS = SETTINGS.masks


@dataclass(frozen=True)
class MaskTerm:
    """A mask, which the surface's outline has."""

    rows: SilhouetteRows
    name: str = "mask"

    def add(self, total: Quadratic, h: Hypotheses) -> None:
        """Add this term."""
        residual = np.zeros((len(h), 2 * self.rows.directions.shape[1]))
        jacobian = np.zeros((*residual.shape, 6 + h.coefficients.shape[1]))
        for i in range(len(h)):
            state = h.rotation[i], h.translation[i], h.coefficients[i]
            vertices, says = self.rows.match(*state)
            off, by = self.rows.distances(vertices, *state, want=True)
            assert by is not None
            weights, losses = mixture(*self.rows.densities(says), np.square(off))
            share = self.rows.share(says)
            total.energy[i] += share * losses.sum()
            scale = np.sqrt(share * weights)
            residual[i], jacobian[i] = scale * off, scale[:, None] * by
        jacobian[..., 3:6] = jacobian[..., 3:6] @ h.rotation.transpose(0, 2, 1)
        total.add(residual, jacobian)


def mask_terms(observation: Observation, camera: Camera, model: VehicleModel) -> tuple[MaskTerm, ...]:
    """The silhouette of an observation, if it has one; the other masks hide the vehicle."""
    masks = [one for one in observation.evidence if isinstance(one, Mask)]
    own, hiding = [one for one in masks if not one.hides], [one for one in masks if one.hides]
    if not own:
        return ()
    mask = own[0]
    sigma = mask.outline_sigma
    span = MASKS.span_share * float((mask.box[2:] - mask.box[:2]).max())
    odds = SilhouetteOdds(
        MASKS.right, span, MASKS.hidden_sigmas * sigma, SETTINGS.border_pixels, MASKS.independent_rows
    )
    rows = SilhouetteRows(
        mask.field,
        _hidden(tuple(hiding)) if hiding else None,
        camera.matrix,
        camera.image_size or mask.image_size,
        model.outline.mean,
        model.outline.basis,
        _directions(MASKS.directions),
        _farthest(mask, MASKS.directions),
        sigma,
        odds,
    )
    return (MaskTerm(rows),)


@lru_cache(maxsize=4)
def _directions(count: int) -> Array:
    """(2, count) unit vectors all around."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles)])


@lru_cache(maxsize=64)  # several problems are made of a vehicle
def _farthest(mask: Mask, count: int) -> Array:
    return mask.farthest(_directions(count))


@lru_cache(maxsize=64)
def _hidden(hiding: tuple[Mask, ...]) -> DistanceField:
    return joined(hiding).field
