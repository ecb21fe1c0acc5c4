"""Robust strategies: how much each keypoint counts, given its residual, its confidence and its visibility.

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
  `paper_literal` is the printed form, e_i / max_j e_j (docs/method.md compares these and other readings).
- `huber`, `cauchy`, `geman_mcclure`, `tukey`: the m-estimator's weight times the weight of Eq. (4).
- `gnc`: graduated non-convexity with the Geman-McClure loss (Yang et al., RA-L 2020): its control parameter falls
  geometrically to 1 over the updates.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError

__all__ = ["Evidence", "RobustStrategy", "StrategyName", "strategy"]

Array = NDArray[np.float64]


class StrategyName(StrEnum):
    """The robust strategies by name."""

    MIXTURE = "mixture"
    PAPER = "paper"
    PAPER_LITERAL = "paper_literal"
    HUBER = "huber"
    CAUCHY = "cauchy"
    GEMAN_MCCLURE = "geman_mcclure"
    TUKEY = "tukey"
    GNC = "gnc"


_TUNING = {  # multiples of sigma; 95 % efficiency under Gaussian noise where that is defined
    StrategyName.HUBER: 1.345,
    StrategyName.CAUCHY: 2.385,
    StrategyName.GEMAN_MCCLURE: 2.0,
    StrategyName.TUKEY: 4.685,
    StrategyName.GNC: 2.0,
}


_IN_GRAPH = (StrategyName.HUBER, StrategyName.CAUCHY, StrategyName.GEMAN_MCCLURE, StrategyName.TUKEY)


@dataclass(frozen=True)
class Evidence:
    """What a detector says about each keypoint, apart from where it is.

    Attributes:
        right: (K,) probability that the point is visible and right, from its confidence.
        outlier: (K,) density of a wrong point relative to the peak density of a right one, 2 pi sqrt(|Sigma|) / area.
        measured: (K,) whether there is a point at all.
    """

    right: Array
    outlier: Array
    measured: NDArray[np.bool_]


@dataclass(frozen=True)
class RobustStrategy:
    """One robust strategy with its parameters; see the module for what each does.

    Attributes:
        name: Which strategy.
        updates: Number of weight updates (the paper: 5).
        tuning: Scale of the m-estimator in multiples of sigma.
        mu0: Share of w_cnn against w_vis in the first weight (Eq. 4).
        mu1: Share of the previous weight (Eq. 5).
        mu2: Share of the residual's term against w_vis (Eq. 5).
        gross: Mixture: probability that a visible keypoint's confident point is wrong all the same.
        missed: Mixture: probability that the detector is not confident of a visible keypoint.
        false_alarm: Mixture: probability that it is confident of a hidden one.
        gnc_start: GNC: control parameter at the first update.
    """

    name: StrategyName = StrategyName.MIXTURE
    updates: int = 5
    tuning: float = 2.0
    mu0: float = 0.5
    mu1: float = 0.5
    mu2: float = 0.7
    gross: float = 0.1
    missed: float = 0.2
    false_alarm: float = 0.05
    gnc_start: float = 64.0

    def __post_init__(self) -> None:
        """Check the parameters.

        Raises:
            InvalidInputError: A parameter is out of range.
        """
        if not 0 <= self.updates <= 1000:
            raise InvalidInputError("strategy.updates", self.updates, "Give a number from 0 to 1000.")
        for field in ("mu0", "mu1", "mu2", "gross", "missed", "false_alarm"):
            value = getattr(self, field)
            if not 0.0 <= value <= 1.0:
                raise InvalidInputError(f"strategy.{field}", value, "Give a number from 0 to 1.")
        for field, lowest in (("tuning", 1e-6), ("gnc_start", 1.0)):
            value = getattr(self, field)
            if not lowest <= value < np.inf:
                raise InvalidInputError(f"strategy.{field}", value, f"Give a finite number of at least {lowest}.")

    @property
    def is_paper(self) -> bool:
        """Whether the weights follow Eqs. (4) and (5), which carry them from update to update."""
        return self.name in (StrategyName.PAPER, StrategyName.PAPER_LITERAL)

    @property
    def anneals(self) -> bool:
        """Whether the weights depend on the progress, so that all updates have to be made."""
        return self.name is StrategyName.GNC

    @property
    def loss(self) -> str | None:
        """Name of the m-estimator that the factor graph puts around each keypoint, or None where weights say it all."""
        return self.name.value if self.name in _IN_GRAPH else None

    def initial_weights(self, evidence: Evidence, visibility: Array) -> Array:
        """(..., K) weights before any residual is known (Eq. 4)."""
        weights = self.mu0 * evidence.right + (1.0 - self.mu0) * visibility
        return np.where(evidence.measured, weights, 0.0)

    def weights(
        self,
        squared_distance: Array,
        evidence: Evidence,
        visibility: Array,
        *,
        previous: Array | None = None,
        progress: float = 1.0,
    ) -> Array:
        """(..., K) weights in [0, 1]; see `evaluate`."""
        return self.evaluate(squared_distance, evidence, visibility, previous=previous, progress=progress)[0]

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
            inlier, outlier = self._mixture(squared_distance, evidence, visibility)
            total = np.where(evidence.measured, inlier + outlier, 1.0)
            mixture_energy: Array = -np.log(total).sum(axis=-1)
            return np.where(evidence.measured, inlier, 0.0) / total, mixture_energy
        initial = self.initial_weights(evidence, visibility)
        energy: Array = (initial * _m_estimator_loss(self.name, squared_distance, self.tuning)).sum(axis=-1)
        if not self.is_paper:
            estimator = _m_estimator_weight(self.name, squared_distance, self.tuning, self._control(progress))
            return initial * estimator, energy
        error = np.where(evidence.measured, np.sqrt(squared_distance), 0.0)
        if self.name is StrategyName.PAPER_LITERAL:
            term = error / np.maximum(error.max(axis=-1, keepdims=True), 1e-12)
        else:
            mean = error.sum(axis=-1, keepdims=True) / max(int(np.count_nonzero(evidence.measured)), 1)
            term = np.exp(-error / np.maximum(mean, 1e-12))
        update = self.mu2 * term + (1.0 - self.mu2) * visibility
        weights = self.mu1 * (initial if previous is None else previous) + (1.0 - self.mu1) * update
        return np.where(evidence.measured, weights, 0.0), energy

    def _control(self, progress: float) -> float:
        return float(self.gnc_start ** (1.0 - progress)) if self.name is StrategyName.GNC else 1.0

    def _mixture(self, squared_distance: Array, evidence: Evidence, visibility: Array) -> tuple[Array, Array]:
        """Densities of being a right point, and of being anything else, relative to a right point's peak."""
        right, hidden = evidence.right, 1.0 - visibility
        seen = visibility * right
        inlier = seen * (1.0 - self.gross) * np.exp(-0.5 * squared_distance)
        unsure = (visibility * self.missed + hidden * (1.0 - self.false_alarm)) * (1.0 - right)
        outlier = (seen * self.gross + unsure + hidden * self.false_alarm * right) * evidence.outlier
        return inlier, outlier


def strategy(value: RobustStrategy | StrategyName | str) -> RobustStrategy:
    """A strategy by its name, with the usual tuning constant, or unchanged where it is one already.

    Raises:
        InvalidInputError: There is no strategy of that name.
    """
    if isinstance(value, RobustStrategy):
        return value
    try:
        name = StrategyName(value)
    except ValueError:
        names = ", ".join(name.value for name in StrategyName)
        raise InvalidInputError("strategy", value, f"Use one of {names}.") from None
    return RobustStrategy(name=name, tuning=_TUNING.get(name, 2.0))


def _m_estimator_weight(name: StrategyName, d2: Array, k: float, control: float) -> Array:
    if name is StrategyName.HUBER:
        return k / np.maximum(np.sqrt(d2), k)
    if name is StrategyName.CAUCHY:
        return 1.0 / (1.0 + d2 / k**2)
    if name is StrategyName.TUKEY:
        return np.square(np.maximum(1.0 - d2 / k**2, 0.0))
    scale = control * k**2
    return np.square(scale / (scale + d2))


def _m_estimator_loss(name: StrategyName, d2: Array, k: float) -> Array:
    if name is StrategyName.HUBER:
        d = np.sqrt(d2)
        return np.where(d <= k, 0.5 * d2, k * (d - 0.5 * k))
    if name is StrategyName.CAUCHY:
        return 0.5 * k**2 * np.log1p(d2 / k**2)
    if name is StrategyName.TUKEY:
        return k**2 / 6.0 * (1.0 - np.maximum(1.0 - d2 / k**2, 0.0) ** 3)
    return 0.5 * d2 * k**2 / (k**2 + d2)
