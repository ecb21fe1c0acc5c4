"""Retrieval of the right car model among 79: marked cars of known model, left out of the prior that fits them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import FgreconError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.vehicle_mesh import VehicleMesh, model_distances
from fgrecon.solve.pipeline import reconstruct
from fgrecon_research.paper.apollocar3d import MarkedCar, MarkedCars
from fgrecon_research.paper.known_shape import BASIS, KNOWN_SHAPE_OPTIONS, learnt_from_others
from fgrecon_research.training.priors.apollo79 import DUPLICATE, Apollo79, apollo79_prior

CLOSEST_ROWS = ("chance", "mean shape", "keypoints", "Hausdorff", "keypoints+others", "Hausdorff+others")
"""Models by the distance of the prior's mean shape; by the mean distance of the keypoints and by the Hausdorff distance
of the wireframes of a car solved from its marks. `+others` knows what the cars of all other models tell: where people
put their marks, and how frequent each model is."""

_SOLVED = CLOSEST_ROWS[2:4], CLOSEST_ROWS[4:6]


@dataclass(frozen=True)
class ClosestModelRanks:
    """At which place the right model is."""

    names: tuple[str, ...]  # C names of cars
    count: int  # how many different models there are; a car that has two names counts once
    # (C,) place of the right model, from 1, by row but chance; last where solving failed
    ranks: Mapping[str, NDArray[np.int64]]
    # (C,) by how much the second model is farther than the first, metres, by the Hausdorff distance with `+others`; NaN
    # where solving failed
    margins: Array

    def share(self, row: str, first: int) -> float:
        """Percentage of cars whose right model is among the first so many."""
        if row == CLOSEST_ROWS[0]:
            return 100.0 * first / self.count
        return share_within(self.ranks[row], first)

    def median(self, row: str) -> float:
        """Median place of the right model."""
        return (self.count + 1) / 2 if row == CLOSEST_ROWS[0] else float(np.median(self.ranks[row]))


def share_within(ranks: NDArray[np.int64], first: int) -> float:
    """Percentage of places (C,) that are among the first so many; NaN without any."""
    return 100.0 * float((ranks <= first).mean()) if len(ranks) else float("nan")


def car_models(models: Apollo79) -> list[VehicleMesh]:
    """The models as cars were labelled with them, with their keypoints."""
    names = models.names
    return [
        VehicleMesh(
            names[i],
            models.vertices[i] / models.scale[i],
            models.faces.astype(np.int64),
            {str(k): point for k, point in enumerate(models.keypoints[i] / models.scale[i])},
        )
        for i in range(len(names))
    ]


def rank_models(
    cars: MarkedCars, models: Apollo79, advance: Callable[[int, int], None] = lambda *_: None
) -> ClosestModelRanks:
    """Solve every car from its marks and rank the models.

    Args:
        models: The 79 models; the prior of a car has not learnt from its own.
    """
    library = car_models(models)
    ranks: dict[str, dict[str, int]] = {}
    margins: dict[str, float] = {}
    for name in sorted({car.model for car in cars.cars}):
        group = [car for car in cars.cars if car.model == name]
        offsets, frequency = learnt_from_others(models, cars, group)
        plain = apollo79_prior(models, basis=BASIS, exclude=[name])
        frequent = apollo79_prior(models, basis=BASIS, exclude=[name], weights=frequency)
        mean = _ranked(plain.mean, library, name)
        for car in group:
            found = {CLOSEST_ROWS[1]: mean[1][1]}
            for rows, prior, marked in zip(_SOLVED, (plain, frequent), (np.zeros_like(offsets), offsets), strict=True):
                shape = _shape(car, cars, prior, marked)
                places = _ranked(shape, library, name)
                found |= {row: place for row, (_, place) in zip(rows, places, strict=True)}
                margins[car.name] = places[1][0]
            ranks[car.name] = found
        advance(len(ranks), len(cars.cars))
    order = [car.name for car in cars.cars]
    return ClosestModelRanks(
        names=tuple(order),
        count=len(models.names) - all(name in models.names for name in DUPLICATE),
        ranks={row: np.array([ranks[name][row] for name in order], dtype=np.int64) for row in CLOSEST_ROWS[1:]},
        margins=np.array([margins[name] for name in order]),
    )


def _shape(car: MarkedCar, cars: MarkedCars, prior: ShapePrior, offsets: Array) -> Array | None:
    """(14, 3) keypoints as solved; None where that failed."""
    marked = replace(prior, mean=prior.mean + offsets)
    try:
        result = reconstruct(car.observation, cars.camera, prior=marked, options=KNOWN_SHAPE_OPTIONS)
    except FgreconError:
        return None
    return result.wireframe - offsets if np.isfinite(result.wireframe).all() else None


def _ranked(shape: Array | None, library: Sequence[VehicleMesh], right: str) -> tuple[tuple[float, int], ...]:
    """Margin of the first model and place of the right one, by keypoints and by Hausdorff distance."""
    same = set(DUPLICATE) if right in DUPLICATE else {right}
    others = DUPLICATE[1] if right not in DUPLICATE else None
    if shape is None:
        return ((float("nan"), len(library)),) * 2
    found = model_distances([str(k) for k in range(len(shape))], shape, None, library)
    ranked = []
    for distances in (found.keypoints, found.hausdorff):
        own = min(d for d, model in zip(distances, library, strict=True) if model.name in same)
        rest = [
            d for d, model in zip(distances, library, strict=True) if model.name not in same and model.name != others
        ]
        first, second = sorted([own, *rest])[:2]
        ranked.append((float(second - first), 1 + int(np.sum(np.array(rest) < own))))
    return tuple(ranked)
