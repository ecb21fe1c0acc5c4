"""How sure a learnt mean shape is: learnt again from other draws of the vehicles.

The Bayesian bootstrap (Rubin 1981): each draw weighs every vehicle, with all its images, by an exponential variate and
goes on with EM from where learning ended. Images of one vehicle, drawn together, count as one witness. What all
vehicles have alike (habits of annotators, the cameras' model) moves no draw and is not in the result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon_research.training.priors.compare import align
from fgrecon_research.training.priors.em_acceleration import EmState, em, start_state
from fgrecon_research.training.priors.em_ppca import Data
from fgrecon_research.training.priors.symmetric_subspace import SymmetricSubspace

Array = NDArray[np.float64]
_ITERATIONS = 60  # of EM in a draw, from where learning ended
_TOLERANCE = 5e-5  # nats per keypoint and iteration


def vehicle_numbers(vehicles: ArrayLike | None, used: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(M',) number of the vehicle that each used image shows; each its own where they are not known.

    Raises:
        InvalidInputError: There is not one vehicle for each of the M images.
    """
    if vehicles is None:
        return np.arange(int(used.sum()))
    names = np.asarray(vehicles)
    if names.shape != used.shape:
        raise InvalidInputError("vehicles", f"shape {names.shape}", f"Give one for each of {len(used)} images.")
    return np.asarray(np.unique(names[used], return_inverse=True)[1])


def bootstrapped_means(
    data: Data,
    state: EmState,
    subspace: SymmetricSubspace,
    vehicle: NDArray[np.intp],
    draws: int,
    dof: float | None,
    rng: np.random.Generator,
    progress: Callable[[int, float], None] = lambda _draw, _bound: None,
) -> Array:
    """Mean shapes of other draws of the vehicles.

    Args:
        data: The annotations of M images.
        state: Where learning from them ended.
        subspace: Where the mean lives.
        vehicle: (M,) number of the vehicle that each image shows.
        draws: How many.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.
        rng: Source of the draws.
        progress: Told after each draw its number, from 1, and its log likelihood per keypoint, nats.

    Returns:
        (draws, K, 3) each moved, turned and scaled to fit the learnt mean best, in its frame.
    """
    means = []
    for draw in range(1, draws + 1):
        weight = rng.exponential(size=int(vehicle.max()) + 1)[vehicle]
        drawn = replace(data, importance=data.importance * weight / np.average(weight, weights=data.importance))
        start = start_state(drawn, state.model, state.cameras, dof, state.posterior.weight)
        end, _, _ = em(drawn, start, subspace, dof=dof, iterations=_ITERATIONS, tolerance=_TOLERANCE)
        means.append(align(end.model.mean, state.model.mean)[0])
        progress(draw, end.bound / drawn.keypoints)
    return np.array(means).reshape(draws, *state.model.mean.shape)
