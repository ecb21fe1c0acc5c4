"""The structure of a factor graph as plain records, for drawing it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from factors import decode_key, key_name
from fgrecon.core.reconstruction import GraphFactor
from fgrecon.solve.graph.graph import Terms, VehicleGraph

__all__ = ["graph_factors"]

_SMALLEST_WEIGHT = 1e-12  # a keypoint of less weight has no factor


def graph_factors(vehicle: VehicleGraph, terms: Terms, weights: NDArray[np.float64]) -> tuple[GraphFactor, ...]:
    """Every factor of a vehicle's graph with the variables that it ties together.

    Args:
        vehicle: Builder of the graph.
        terms: Its factors.
        weights: (K,) weights of the keypoints that the factors were built with.
    """
    return tuple(_reprojection(vehicle, weights)) + tuple(_others(vehicle, terms))


def _reprojection(vehicle: VehicleGraph, weights: NDArray[np.float64]) -> Iterator[GraphFactor]:
    """One factor per keypoint that is measured and has a weight, however they are stacked for speed."""
    names = vehicle.problem.model.prior.category.keypoints
    variables = tuple(key_name(key) for key in vehicle.kernel.keys)
    for i in np.flatnonzero(vehicle.problem.observation.measured & (weights >= _SMALLEST_WEIGHT)) if variables else ():
        yield GraphFactor("reprojection", names[i], variables)


def _others(vehicle: VehicleGraph, terms: Terms) -> Iterator[GraphFactor]:
    faces = vehicle.problem.model.prior.category.faces
    for term, members in terms.items():
        for factor in members if term != "reprojection" else ():
            keys = list(factor.keys())
            planes = [decode_key(key).low for key in keys if decode_key(key).letter == "P"]
            label = faces[planes[0]].name + (" level" if len(keys) == 1 else "") if planes else ""
            if term == "ground":
                label = "height" if factor.dim() == 1 else "upright"
            yield GraphFactor(term, label, tuple(key_name(key) for key in keys))
