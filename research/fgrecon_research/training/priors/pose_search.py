"""Global search for the cameras of NRSfM: EM alone keeps an instance in the pose that it started near."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fgrecon_research.training.priors.em_acceleration import EmState, start_state
from fgrecon_research.training.priors.em_ppca import (
    Cameras,
    Data,
    Posterior,
    ShapeModel,
    bound,
    e_step,
    expected_shapes,
    pose_step,
)

Array = NDArray[np.float64]


def uniform_rotations(count: int, rng: np.random.Generator) -> Array:
    """(count, 2, 3) camera rows, uniform over all rotations."""
    rows = rng.standard_normal((count, 2, 3))
    first = rows[:, 0] / np.linalg.norm(rows[:, 0], axis=1, keepdims=True)
    second = rows[:, 1] - (rows[:, 1] * first).sum(axis=1, keepdims=True) * first
    return np.stack([first, second / np.linalg.norm(second, axis=1, keepdims=True)], axis=1)


def search_cameras(
    data: Data, state: EmState, rotations: Array, dof: float | None, *, sweeps: int = 6, keep: bool = True
) -> EmState:
    """Try every given rotation, and each camera's own depth reversal, on every instance; keep what is better.

    Args:
        data: The annotations.
        state: The model, and the cameras so far.
        rotations: (Q, 2, 3) camera rows to start from.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.
        sweeps: Iterations of posterior and camera from each start.
        keep: Whether the cameras so far compete; then no instance's bound falls.

    Returns:
        The same model with the best camera of each instance.
    """
    model = state.model
    rotation, scale, translation = (np.array(part) for part in vars(state.cameras).values())
    weight = state.posterior.weight.copy()
    best = bound(data, model, state.cameras, state.posterior, dof)
    if not keep:
        best = np.full(len(best), -np.inf)
    for start in _starts(data, state, rotations):
        cameras, posterior = _fit(data, model, Cameras(start, state.cameras.inverse_scale, translation), dof, sweeps)
        score = bound(data, model, cameras, posterior, dof)
        better = score > best
        rotation[better], scale[better] = cameras.rotation[better], cameras.inverse_scale[better]
        translation[better], weight[better] = cameras.translation[better], posterior.weight[better]
        best = np.where(better, score, best)
    return start_state(data, model, Cameras(rotation, scale, translation), dof, weight)


def _starts(data: Data, state: EmState, rotations: Array) -> Iterator[Array]:
    yield _reversed(state)
    for rows in rotations:
        yield np.broadcast_to(rows, (len(data.points), 2, 3))


def _fit(data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, sweeps: int) -> tuple[Cameras, Posterior]:
    """Cameras and posterior from a start whose rotation alone means something: first the mean shape, unweighted."""
    count, instances = model.basis.shape[0], len(data.points)
    posterior = Posterior(
        np.zeros((instances, count)), np.tile(np.eye(count), (instances, 1, 1)), data.seen, np.zeros_like(data.seen)
    )
    for sweep in range(sweeps):
        cameras = pose_step(data, model, cameras, posterior)
        posterior = e_step(data, model, cameras, dof, posterior.weight if dof is not None and sweep > 1 else None)
    return cameras, posterior


def _reversed(state: EmState) -> Array:
    """(M, 2, 3) each camera mirrored at the plane that fits its seen keypoints best.

    Points in one plane look the same from both sides of its mirror image (Necker's reversal), so that this is the
    likeliest wrong camera of an instance that shows one side of the vehicle.
    """
    weight = state.posterior.weight
    shapes = expected_shapes(state.model, state.posterior.mean)
    centred = shapes - ((weight[:, None] @ shapes) / weight.sum(axis=1)[:, None, None])
    scatter = (centred * weight[:, :, None]).transpose(0, 2, 1) @ centred
    normal = np.linalg.eigh(scatter)[1][:, :, :1]
    rotation = state.cameras.rotation
    return np.asarray(rotation - 2.0 * (rotation @ normal) @ normal.transpose(0, 2, 1))
