"""EM iterations with safeguarded extrapolation: the same optimum in a fraction of the iterations.

SQUAREM (Varadhan and Roland 2008): from three successive parameter vectors v0, v1, v2 of EM a longer step
v0 + 2 s (v1 - v0) + s^2 (v2 - 2 v1 + v0) is tried, and taken only where the bound is no lower than EM's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon_research.training.priors.em_ppca import (
    Cameras,
    Data,
    Posterior,
    ShapeModel,
    bound,
    e_step,
    model_step,
    orthonormal_rows,
    pose_step,
)
from fgrecon_research.training.priors.symmetric_subspace import SymmetricSubspace

Array = NDArray[np.float64]
Report = Callable[[int, float], None]
"""Called after each iteration with its number and the bound per seen keypoint (nats)."""

_FIRST_STEP = 4.0
_NOISE_FLOOR = 1e-8


@dataclass(frozen=True)
class EmState:
    """Everything that EM iterates on."""

    # the shape model, scaled so that the mean's keypoints lie at an RMS distance of 1 from the origin
    model: ShapeModel
    cameras: Cameras  # one per instance
    posterior: Posterior  # the latent variables under both
    bound: float  # the bound of all instances together, nats


def start_state(
    data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, weight: Array | None = None
) -> EmState:
    """A state from a model and cameras, scaled to unit size; the bound does not depend on that scale."""
    scale = 1.0 / float(np.sqrt(np.square(model.mean).sum(axis=1).mean()))
    model = ShapeModel(model.mean * scale, model.basis * scale, model.variance * scale**2)
    cameras = Cameras(cameras.rotation, cameras.inverse_scale * scale, cameras.translation * scale)
    return _evaluated(data, model, cameras, dof, weight)


def _evaluated(data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, weight: Array | None) -> EmState:
    posterior = e_step(data, model, cameras, dof, weight if dof is not None else None)
    return EmState(model, cameras, posterior, float(bound(data, model, cameras, posterior, dof).sum()))


def em(
    data: Data,
    state: EmState,
    subspace: SymmetricSubspace,
    *,
    dof: float | None,
    iterations: int,
    tolerance: float,
    report: Report | None = None,
) -> tuple[EmState, list[float], bool]:
    """Iterate EM with extrapolation until the bound rises by less than `tolerance` nats per keypoint and iteration.

    Args:
        data: The annotations.
        state: Where to start.
        subspace: Where the mean and basis live.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.
        iterations: Most iterations.
        tolerance: When to stop.
        report: Told of the progress.

    Returns:
        The last state, the bound at the start and after each pair of iterations (never falling), and whether it
        converged.
    """
    keypoints = data.keypoints
    history, longest = [state.bound], _FIRST_STEP
    for iteration in range(2, iterations + 1, 2):
        first = _iterate(data, state, subspace, dof)
        second = _iterate(data, first, subspace, dof)
        leap, length = _extrapolate(data, state, first, second, dof, longest)
        if leap is not None and leap.bound >= second.bound:
            second = leap
            longest = 4.0 * longest if length == longest else longest
        elif length > 1.0:
            longest = max(_FIRST_STEP, longest / 4.0)
        gain = (second.bound - state.bound) / keypoints
        state = second
        history.append(state.bound)
        if report is not None:
            report(iteration, state.bound / keypoints)
        if gain < 2.0 * tolerance:
            return state, history, True
    return state, history, False


def _iterate(data: Data, state: EmState, subspace: SymmetricSubspace, dof: float | None) -> EmState:
    """One iteration of EM: cameras, model, posterior."""
    cameras = pose_step(data, state.model, state.cameras, state.posterior)
    model, posterior = model_step(data, state.model, cameras, state.posterior, subspace, _NOISE_FLOOR)
    return _evaluated(data, model, cameras, dof, posterior.weight)


def _extrapolate(
    data: Data, state: EmState, first: EmState, second: EmState, dof: float | None, longest: float
) -> tuple[EmState | None, float]:
    """The state a longer step away, or None where the step is no longer than EM's; and the step's length."""
    v0, v1, v2 = _vector(state), _vector(first), _vector(second)
    change = v1 - v0
    bend = v2 - v1 - change
    length = float(np.clip(np.linalg.norm(change) / max(float(np.linalg.norm(bend)), 1e-300), 1.0, longest))
    if length <= 1.01:
        return None, length
    model, cameras = _from_vector(v0 + 2.0 * length * change + length**2 * bend, second)
    leap = _evaluated(data, model, cameras, dof, second.posterior.weight)
    return (leap if np.isfinite(leap.bound) else None), length


def _vector(state: EmState) -> Array:
    model, cameras = state.model, state.cameras
    parts = (
        model.mean,
        model.basis,
        np.log([model.variance]),
        cameras.rotation,
        np.log(cameras.inverse_scale),
        cameras.translation,
    )
    return np.concatenate([part.ravel() for part in parts])


def _from_vector(vector: Array, like: EmState) -> tuple[ShapeModel, Cameras]:
    model, cameras = like.model, like.cameras
    shapes = (
        model.mean.shape,
        model.basis.shape,
        (1,),
        cameras.rotation.shape,
        cameras.inverse_scale.shape,
        cameras.translation.shape,
    )
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    parts = [part.reshape(shape) for part, shape in zip(np.split(vector, ends[:-1]), shapes, strict=True)]
    return (
        ShapeModel(parts[0], parts[1], max(float(np.exp(parts[2][0])), _NOISE_FLOOR)),
        Cameras(orthonormal_rows(parts[3]), np.exp(parts[4]), parts[5]),
    )
