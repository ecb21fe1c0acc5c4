"""Robust strategies: the weight of each keypoint, given its residual, its confidence and its visibility.

A strategy turns, for each keypoint, the squared Mahalanobis distance d^2 of its residual, the probability p that the
detector's point is right (w_cnn of the paper) and the probability v that the keypoint is visible at the current pose
(w_vis) into a weight w in [0, 1]. The weight becomes a noise model by sigma_i = sigma_0 / sqrt(w_i) (`factors.noise`),
so that one least-squares step with these weights is one step of iteratively re-weighted least squares (IRLS).

The strategies:

- `mixture` (default): w is the posterior probability that the point is an inlier of a two-class mixture: visible and
  right with a Gaussian error, or anything else with a uniform density over the box. This is EM, and its energy can be
  compared between poses: a confident point that the pose hides, or a visible keypoint that the detector is not
  confident of, speaks against a pose.
- `paper`: Eqs. (4) and (5) of Murthy et al. 2017, w(0) = mu0 w_cnn + (1 - mu0) w_vis(0) and
  w(t+1) = mu1 w(t) + (1 - mu1) [mu2 s(t) + (1 - mu2) w_vis(t)]. The paper prints the reprojection error e_i(t),
  normalised over the instances, in the place of s, which would raise the weight of the worst point. Its text says that
  "weights assigned to incorrectly estimated keypoints get reduced every iteration", so s = exp(-e_i / mean_j e_j).
  `paper_literal` is the printed form, e_i / max_j e_j (docs/history/solver.md compares these and other readings).
- `huber`, `cauchy`, `geman_mcclure`, `tukey`: the m-estimator's weight times the weight of Eq. (4).
- `gnc`: graduated non-convexity with the Geman-McClure loss (Yang et al., RA-L 2020): its control parameter falls
  geometrically to 1 over the updates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from factors.losses import Loss, RobustLoss
from factors.mixture import mixture
from fgrecon.core.arrays import Array
from fgrecon.core.choices import StrategyName
from fgrecon.core.settings import check_settings, choice, count, number, one_of

__all__ = ["Evidence", "RobustStrategy", "StrategyName", "strategy"]


_LOSSES = {
    StrategyName.HUBER: Loss.HUBER,
    StrategyName.CAUCHY: Loss.CAUCHY,
    StrategyName.GEMAN_MCCLURE: Loss.GEMAN_MCCLURE,
    StrategyName.TUKEY: Loss.TUKEY,
}
"""The m-estimators. Elsewhere a loss is only needed for energies to compare, which are Geman and McClure's."""


@dataclass(frozen=True)
class Evidence:
    """What a detector says about each keypoint, apart from where it is."""

    right: Array  # (K,) probability that the point is visible and right, from its confidence
    # (K,) density of a wrong point relative to the peak density of a right one, 2 pi sqrt(|Sigma|) / area
    outlier: Array
    measured: NDArray[np.bool_]  # (K,) whether there is a point at all


@dataclass(frozen=True)
class RobustStrategy:
    """One robust strategy with its parameters; see the module for what each does.

    Attributes:
        name: Which strategy.
        updates: Number of weight updates, at most 100 (the paper: 5).
        tuning: Scale of the m-estimator in multiples of sigma; None is the loss's usual one (`factors.Loss`).
        mu0: Share of w_cnn against w_vis in the first weight (Eq. 4).
        mu1: Share of the previous weight (Eq. 5).
        mu2: Share of the residual's term against w_vis (Eq. 5).
        gross: Mixture: probability that a visible keypoint's confident point is wrong all the same.
        missed: Mixture: probability that the detector is not confident of a visible keypoint.
        false_alarm: Mixture: probability that it is confident of a hidden one.
        gnc_start: GNC: control parameter at the first update.
    """

    name: StrategyName = choice(StrategyName.MIXTURE)
    updates: int = count(5, least=0, most=100)
    tuning: float | None = number(None, least=1e-6, most=1e6)
    mu0: float = number(0.5, least=0.0, most=1.0)
    mu1: float = number(0.5, least=0.0, most=1.0)
    mu2: float = number(0.7, least=0.0, most=1.0)
    gross: float = number(0.1, least=0.0, most=1.0)
    missed: float = number(0.2, least=0.0, most=1.0)
    false_alarm: float = number(0.05, least=0.0, most=1.0)
    gnc_start: float = number(64.0, least=1.0, most=1e6)

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            InvalidInputError: A parameter has the wrong type or is out of range.
        """
        check_settings(self, "strategy")

    @property
    def robust_loss(self) -> RobustLoss:
        """The m-estimator with its tuning constant."""
        return RobustLoss.of(_LOSSES.get(self.name, Loss.GEMAN_MCCLURE), self.tuning)

    @property
    def is_paper(self) -> bool:
        """Whether the weights follow Eqs. (4) and (5), which carry them from update to update."""
        return self.name in (StrategyName.PAPER, StrategyName.PAPER_LITERAL)

    @property
    def anneals(self) -> bool:
        """Whether the weights depend on the progress, so that all updates have to be made."""
        return self.name is StrategyName.GNC

    @property
    def descends(self) -> bool:
        """Whether weights at a state belong to an energy there, which a solve under them lowers."""
        return not self.is_paper and self.updates > 0

    @property
    def loss(self) -> str | None:
        """Name of the m-estimator that the factor graph puts around each keypoint, or None where weights say it all."""
        return self.name.value if self.name in _LOSSES else None

    def initial_weights(self, evidence: Evidence, visibility: Array) -> Array:
        """(..., K) weights before any residual is known (Eq. 4)."""
        weights = self.mu0 * evidence.right + (1.0 - self.mu0) * visibility
        return np.where(evidence.measured, weights, 0.0)

    def evaluate(
        self,
        squared_distance: Array,
        evidence: Evidence,
        visibility: Array,
        *,
        previous: Array | None = None,
        progress: float = 1.0,
    ) -> tuple[Array, Array]:
        """Weights (..., K) in [0, 1] and energies (...) in nats.

        The energy of `mixture` is the negative logarithm of the likelihood: it charges for hidden and for ignored
        points, so that poses can be compared by it. That of the others, the sum of the initial weights times the loss
        (`paper`: Geman and McClure's, since Eqs. 4-5 define no energy), favours a pose that hides points.

        Args:
            squared_distance: (..., K) squared Mahalanobis distances of the residuals.
            evidence: What the detector says.
            visibility: (..., K) probability of being visible.
            previous: (..., K) weights before this update; only `paper` reads them.
            progress: 0 at the first update, 1 at the last; only `gnc` reads it.
        """
        if self.name is StrategyName.MIXTURE:
            right, wrong = self.densities(evidence, visibility)
            posterior, losses = mixture(right, wrong, squared_distance)
            log_likelihood: Array = (losses - np.log(right + wrong)).sum(axis=-1)
            return posterior, log_likelihood
        initial = self.initial_weights(evidence, visibility)
        energy: Array = (initial * self.robust_loss.losses_of_squares(squared_distance)).sum(axis=-1)
        if not self.is_paper:
            return initial * self._estimator(progress).weights_of_squares(squared_distance), energy
        error = np.where(evidence.measured, np.sqrt(squared_distance), 0.0)
        if self.name is StrategyName.PAPER_LITERAL:
            term = error / np.maximum(error.max(axis=-1, keepdims=True), 1e-12)
        else:
            mean = error.sum(axis=-1, keepdims=True) / max(int(np.count_nonzero(evidence.measured)), 1)
            term = np.exp(-error / np.maximum(mean, 1e-12))
        update = self.mu2 * term + (1.0 - self.mu2) * visibility
        weights = self.mu1 * (initial if previous is None else previous) + (1.0 - self.mu1) * update
        return np.where(evidence.measured, weights, 0.0), energy

    def _estimator(self, progress: float) -> RobustLoss:
        """The m-estimator at an update: graduated non-convexity widens it at first."""
        loss = self.robust_loss
        if self.name is not StrategyName.GNC:
            return loss
        return RobustLoss(loss.loss, loss.constant * float(self.gnc_start ** (0.5 * (1.0 - progress))))

    def densities(self, evidence: Evidence, visibility: Array) -> tuple[Array, Array]:
        """Mixture: densities (..., K) of a right point and of anything else, relative to a right one's peak.

        Where nothing was measured they are 0 and 1.
        """
        right, hidden = evidence.right, 1.0 - visibility
        believed = visibility * right
        unsure = (visibility * self.missed + hidden * (1.0 - self.false_alarm)) * (1.0 - right)
        outlier = (believed * self.gross + unsure + hidden * self.false_alarm * right) * evidence.outlier
        measured = evidence.measured
        return np.where(measured, believed * (1.0 - self.gross), 0.0), np.where(measured, outlier, 1.0)


def strategy(value: RobustStrategy | StrategyName | str) -> RobustStrategy:
    """A strategy by its name, or unchanged where it is one already.

    Raises:
        InvalidInputError: There is no strategy of that name.
    """
    return value if isinstance(value, RobustStrategy) else _by_name(one_of(StrategyName, "strategy", value))


@cache
def _by_name(name: StrategyName) -> RobustStrategy:
    """With the default parameters; one for all, which nobody can change."""
    return RobustStrategy(name)
