"""Inlier-outlier mixture: a residual with a Gaussian error, or a wrong one; its loss, and its least-squares rows.

With a the density of a right point at its place, b that of a wrong one, and s = ||r||^2 the squared whitened residual,

    rho(s) = log((a + b) / (a exp(-s / 2) + b)),    w(s) = 2 rho'(s) = a exp(-s / 2) / (a exp(-s / 2) + b),

w being the probability that the point is right: the weight of iteratively re-weighted least squares, which is EM here.
A solver of least squares takes the loss in four forms, all with the same gradient w J'r:

- `Form.WEIGHTED`: sqrt(w) r and sqrt(w) J, the weights given: one step of EM. It neglects how the weights change.
- `Form.LOSS`: rows whose half squared sum is rho, without derivatives: what a step is judged by.
- `Form.NEWTON`: rows whose J'J has the loss's own curvature, w (I - (1 - w) r r') (Triggs et al. 2000, eq. 11), along r
  no less than `STIFFEST` of the weighted one. Steps by it end after a few where EM's shrink by a constant factor.
- `Form.MAJORISED`: sqrt(w) r and sqrt(w) J with the weights of this place: EM, whose parabola lies nowhere below the
  loss. Where Newton's step leaps over a minimum, because the loss bends the other way here, this one leads down.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from factors.arrays import Array

STIFFEST = 0.1
"""Share of the weighted curvature along a residual that is left at least: far out the loss bends the other way."""


class Form(IntEnum):
    """How a mixture is handed to the solver; see the module."""

    WEIGHTED = 0
    LOSS = 1
    NEWTON = 2
    MAJORISED = 3


def mixture(right: Array, wrong: Array, squares: Array) -> tuple[Array, Array]:
    """Weights w and losses rho.

    Args:
        right: (...) density a of a right point; 0 where there is none, which makes both zero.
        wrong: (...) density b of a wrong one; 0 makes it least squares.
        squares: (...) squared lengths s of the whitened residuals.
    """
    inlier = right * np.exp(-0.5 * squares)
    total = inlier + wrong
    safe = np.where(total > 0.0, total, 1.0)
    robust = (right > 0.0) & (wrong > 0.0)
    gaussian = (right > 0.0) & (wrong <= 0.0)
    weights = np.where(robust, inlier / safe, np.where(gaussian, 1.0, 0.0))
    losses = np.where(robust, np.log((right + wrong) / safe), np.where(gaussian, 0.5 * squares, 0.0))
    return weights, losses


def robust_rows(
    form: Form, right: Array, wrong: Array, residual: Array, jacobian: Array | None
) -> tuple[Array, Array | None]:
    """Rows of residuals that are right or wrong.

    Args:
        form: Which rows.
        right: (M,) densities of right points; with `Form.WEIGHTED` the weights.
        wrong: (M,) densities of wrong ones.
        residual: (M, R) whitened residuals; the R rows of each are right or wrong together.
        jacobian: (M, R, D) their derivatives, or None.

    Returns:
        The same, to be summed in squares.
    """
    squares = np.square(residual).sum(axis=1)
    if form is Form.WEIGHTED:
        root, rest, stretch = np.sqrt(right), np.ones(len(right)), np.sqrt(right)
    else:
        weights, losses = mixture(right, wrong, squares)
        root = np.sqrt(weights)
        if form is Form.LOSS:
            safe = np.where(squares > 0.0, squares, 1.0)
            rest, stretch = np.ones(len(right)), np.where(squares > 0.0, np.sqrt(2.0 * losses / safe), root)
        elif form is Form.MAJORISED:
            rest, stretch = np.ones(len(right)), root
        else:
            rest = np.sqrt(np.maximum(1.0 - (1.0 - weights) * squares, STIFFEST))
            stretch = root / rest
    rows = stretch[:, None] * residual
    if jacobian is None:
        return rows, None
    taken = np.where(squares > 0.0, (1.0 - rest) / np.where(squares > 0.0, squares, 1.0), 0.0)
    along = residual[:, None, :] @ jacobian
    return rows, root[:, None, None] * (jacobian - (taken[:, None] * residual)[..., None] * along)
