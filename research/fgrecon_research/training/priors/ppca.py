"""Principal components of data rows, with or without missing entries.

Rows y (D,) are modelled as y = mean + directions diag(std) lambda + noise with lambda ~ N(0, I). Complete data has a
closed form, the singular value decomposition. With missing entries (NaN) the same model is fitted by EM for
probabilistic PCA (Tipping and Bishop 1999; missing entries as in Torresani, Hertzmann and Bregler 2008), with the
expanded E-step prior of PX-EM (Liu, Rubin and Wu 1998), which takes far fewer iterations and still never lets the
likelihood fall. On complete data EM ends at the closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_finite, as_shape
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearModel:
    """A fitted linear model of rows."""

    mean: Array  # (D,) mean row
    directions: Array  # (D, N) orthonormal directions, the one of largest variance first
    std: Array  # (N,) standard deviation of the data along each direction (unbiased)
    explained: Array  # (N,) fraction of the total variance along each direction
    scores: Array  # (M, N) each row's coefficients lambda, of unit variance over the data
    residual: Array  # (D,) mean square of what the directions leave unexplained in the data itself, per coordinate
    effective: float  # number of rows that count: (sum w)^2 / sum w^2 for weights w
    # log-likelihood of the observed entries after each EM iteration; empty for the closed form
    log_likelihood: list[float] = field(default_factory=list)

    @property
    def predicted_residual(self) -> Array:
        """(D,) mean square of what the directions leave unexplained in a row that they were not learnt from.

        In-sample residuals are too small by one minus the row's leverage; the mean leverage is (1 + N) / M, which
        gives M / (M - 1 - N) (the leave-one-out formula of regression, PRESS, with every leverage at its mean).
        """
        freedom = max(self.effective - 1.0 - len(self.std), 1.0)
        return self.residual * (self.effective / freedom) ** 2


def fit_linear_model(
    rows: ArrayLike,
    count: int,
    weights: ArrayLike | None = None,
    *,
    force_em: bool = False,
    tolerance: float = 1e-10,
    max_iterations: int = 3000,
) -> LinearModel:
    """Fit `count` principal directions to rows (M, D), NaN where an entry is missing.

    Args:
        rows: (M, D) data.
        count: Number N of directions.
        weights: (M,) how much each row counts, >= 0; equal by default.
        force_em: Use EM on complete data too (to compare the two).
        tolerance: EM ends when the log-likelihood rises by less than this fraction of its size.
        max_iterations: EM ends here at the latest.

    Raises:
        InvalidInputError: Wrong shapes, infinite entries, or negative weights.
        DegenerateProblemError: Too few rows or observed entries for so many directions.
    """
    data = as_shape("rows", rows, (None, None))
    if np.isinf(data).any():
        raise InvalidInputError("rows", "an infinite entry", "Give finite numbers, or NaN where missing.")
    observed = np.isfinite(data)
    w = np.ones(len(data)) if weights is None else as_finite("weights", weights, (len(data),))
    if (w < 0).any() or not w.any():
        raise InvalidInputError("weights", w.min() if len(w) else "none", "Give weights >= 0, not all of them zero.")
    keep = (w > 0) & observed.any(axis=1)
    effective = float(w[keep].sum() ** 2 / (w[keep] ** 2).sum()) if keep.any() else 0.0
    _check_counts(observed[keep], count)
    fit = _closed_form if observed[keep].all() and not force_em else _em
    model = fit(data[keep], count, w[keep] / w[keep].mean(), effective, tolerance, max_iterations)
    if keep.all():
        return model
    scores = np.zeros((len(data), count))  # a row that is not used is as probable as the mean
    scores[keep] = model.scores
    return replace(model, scores=scores)


def _check_counts(observed: NDArray[np.bool_], count: int) -> None:
    rows, size = observed.shape
    if not 0 <= count < rows or count > size:
        fix = f"Give 0 to {max(min(rows - 1, size), 0)} directions for {rows} rows of {size} numbers, or more rows."
        raise DegenerateProblemError("count", count, fix)
    seen = observed.sum(axis=0)
    if (seen < count + 2).any() and not observed.all():
        column = int(seen.argmin())
        fix = f"Each entry must be observed in at least {count + 2} rows: drop it, or ask for fewer directions."
        raise DegenerateProblemError(f"rows[:, {column}]", f"observed in {int(seen[column])} rows", fix)


def _closed_form(data: Array, count: int, weights: Array, effective: float, *_: float) -> LinearModel:
    total = weights.sum()
    mean = weights @ data / total
    centred = data - mean
    singular, right = np.linalg.svd(np.sqrt(weights)[:, None] * centred, full_matrices=False)[1:]
    variance = singular**2 / total * effective / (effective - 1.0) if effective > 1 else np.zeros(len(singular))
    directions = right[:count].T
    std = np.sqrt(variance[:count])
    projected = centred @ directions
    scores = np.divide(projected, std, out=np.zeros_like(projected), where=std > 0)
    residual = weights @ (centred - projected @ directions.T) ** 2 / total
    explained = variance[:count] / max(variance.sum(), np.finfo(float).tiny)
    return LinearModel(mean, directions, std, explained, scores, residual, effective)


def _em(
    data: Array, count: int, weights: Array, effective: float, tolerance: float, max_iterations: int
) -> LinearModel:
    observed = np.isfinite(data)
    size = data.shape[1]
    seen = observed * weights[:, None]
    mean = np.where(observed, data, 0.0).T @ weights / seen.sum(axis=0)
    centred = np.where(observed, data - mean, 0.0)
    variance = (seen * centred**2).sum() / seen.sum()
    floor = max(variance * 1e-12, np.finfo(float).tiny)
    # Start: the singular vectors with missing entries at their means, at the size that observed entries show.
    filled = np.sqrt(weights)[:, None] * centred * np.sqrt(len(data) / seen.sum(axis=0))
    _, singular, right = np.linalg.svd(filled, full_matrices=False)
    loading = right[:count].T * (singular[:count] / np.sqrt(len(data)))
    noise = max((variance * size - (loading**2).sum()) / size, variance * 1e-3, floor)
    history: list[float] = []
    for _iteration in range(max_iterations):
        z, cov, log_likelihood = _posterior(centred, observed, weights, loading, noise)
        history.append(log_likelihood)
        if len(history) > 1 and history[-1] - history[-2] <= tolerance * abs(history[-1]):
            break
        shift, loading, noise = _maximise(centred, seen, weights, z, cov)
        noise = max(noise, floor)
        mean = mean + shift
        centred = np.where(observed, data - mean, 0.0)
    z, cov, _ = _posterior(centred, observed, weights, loading, noise)
    spread = np.einsum("di,mij,dj->md", loading, cov, loading)
    # The posterior residuals hold all D noise directions, those of the closed form only the D - N left over.
    residual = (seen * ((centred - z @ loading.T) ** 2 + spread)).sum(axis=0) / seen.sum(axis=0) * (size - count) / size
    directions, singular, rotation = np.linalg.svd(loading, full_matrices=False)
    unbiased = effective / (effective - 1.0)
    std = np.sqrt((singular**2 + noise) * unbiased)
    # A posterior mean is shrunk by s^2 / (s^2 + noise): undone, it is the projection on the direction.
    safe = np.maximum(singular, np.sqrt(floor))
    scores = (z @ rotation.T) * (singular**2 + noise) / (safe * std)
    explained = (singular**2 + noise) / ((singular**2).sum() + size * noise)
    return LinearModel(mean, directions, std, explained, scores, residual, effective, history)


def _posterior(
    centred: Array, observed: NDArray[np.bool_], weights: Array, loading: Array, noise: float
) -> tuple[Array, Array, float]:
    """Mean (M, N) and covariance (M, N, N) of the latent variables, and the log-likelihood of the observed entries."""
    size, count = loading.shape
    outer = (loading[:, :, None] * loading[:, None, :]).reshape(size, -1)
    precision = np.eye(count) + (observed @ outer).reshape(-1, count, count) / noise
    cov = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    projected = centred @ loading / noise
    z: Array = np.einsum("mij,mj->mi", cov, projected)
    entries = observed.sum(axis=1)
    mahalanobis = (centred**2).sum(axis=1) / noise - (projected * z).sum(axis=1)
    determinant = np.linalg.slogdet(precision)[1] + entries * np.log(noise)
    return z, cov, float(-0.5 * weights @ (entries * np.log(2 * np.pi) + determinant + mahalanobis))


def _maximise(centred: Array, seen: Array, weights: Array, z: Array, cov: Array) -> tuple[Array, Array, float]:
    """Shift of the mean (D,), loading (D, N) and noise variance that the posterior makes most likely."""
    rows, count = z.shape
    extended = np.hstack([z, np.ones((rows, 1))])
    second = extended[:, :, None] * extended[:, None, :]
    second[:, :count, :count] += cov
    normal = (seen.T @ second.reshape(rows, -1)).reshape(-1, count + 1, count + 1)
    right = (seen * centred).T @ extended
    solution = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    loading, shift = solution[:, :count], solution[:, count]
    spread = np.einsum("di,mij,dj->md", loading, cov, loading)
    noise = float((seen * ((centred - extended @ solution.T) ** 2 + spread)).sum() / seen.sum())
    # PX-EM: the latent variables may have a mean and covariance of their own, which are then absorbed.
    latent_mean = weights @ z / weights.sum()
    latent = np.einsum("m,mij->ij", weights, second[:, :count, :count]) / weights.sum()
    latent -= np.outer(latent_mean, latent_mean)
    return shift + loading @ latent_mean, loading @ np.linalg.cholesky(latent), noise
