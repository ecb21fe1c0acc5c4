"""Noise models: IRLS weights, detector covariances and robust losses.

A weight w_i of iteratively re-weighted least squares enters a factor as its standard deviation,

    sigma_i = sigma_0 / sqrt(w_i),    or    Sigma_i / w_i

where a detector gives a keypoint's own 2x2 covariance: the factor's energy ||r_i / sigma_i||^2 is then w_i times that
of an unweighted one. It may act alone or inside a robust loss, which then weighs the whitened norm. A weight of zero
means no factor at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError

__all__ = ["Loss", "Noise", "RobustLoss", "as_noise", "diagonal_noise", "keypoint_noise", "keypoint_whiteners"]

Noise = gtsam.noiseModel.Base | float
"""A noise model, or one sigma for every row of the residual, in the residual's unit."""

_SMALLEST_WEIGHT = 1e-12


class Loss(Enum):
    """Robust losses rho(s) of a whitened residual norm s, and the tuning constant that gives 95 % efficiency."""

    HUBER = ("huber", 1.345)
    CAUCHY = ("cauchy", 2.3849)
    GEMAN_MCCLURE = ("geman_mcclure", 1.0)
    TUKEY = ("tukey", 4.6851)

    @property
    def label(self) -> str:
        """Name as users write it."""
        return self.value[0]

    @property
    def default_constant(self) -> float:
        """Usual tuning constant, in standard deviations (Geman-McClure has no agreed one: 1)."""
        return self.value[1]

    @classmethod
    def of(cls, name: Loss | str) -> Loss:
        """A loss by its name.

        Raises:
            InvalidInputError: There is no such loss.
        """
        for loss in cls:
            if name in (loss, loss.label):
                return loss
        raise InvalidInputError("loss", name, f"Use one of {', '.join(loss.label for loss in cls)}.")


@dataclass(frozen=True)
class RobustLoss:
    """A robust loss with its tuning constant in standard deviations of the residual."""

    loss: Loss
    constant: float

    def __post_init__(self) -> None:
        """Check the constant.

        Raises:
            InvalidInputError: The constant is not positive and finite.
        """
        if not (np.isfinite(self.constant) and self.constant > 0):
            raise InvalidInputError("constant", self.constant, "Give a positive tuning constant.")

    @classmethod
    def of(cls, name: Loss | str, constant: float | None = None) -> RobustLoss:
        """A loss by its name, with its usual constant unless another is given.

        Raises:
            InvalidInputError: There is no such loss, or the constant is not positive.
        """
        loss = Loss.of(name)
        return cls(loss, loss.default_constant if constant is None else float(constant))

    def wrap(self, noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Robust:
        """The noise model with this loss around it."""
        return gtsam.noiseModel.Robust.Create(self.estimator(), noise)

    def weights(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Weights rho'(s) / s of whitened residual norms s: what the solver multiplies squared residuals by."""
        s2, k2 = self._squares(distances)
        match self.loss:
            case Loss.HUBER:
                return np.minimum(1.0, self.constant / np.sqrt(np.maximum(s2, 1e-300)))
            case Loss.CAUCHY:
                return k2 / (k2 + s2)
            case Loss.GEMAN_MCCLURE:
                return np.square(k2 / (k2 + s2))
            case Loss.TUKEY:
                return np.square(np.maximum(1.0 - s2 / k2, 0.0))

    def losses(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Losses rho(s) of whitened residual norms s; s^2 / 2 near zero."""
        s2, k2 = self._squares(distances)
        match self.loss:
            case Loss.HUBER:
                return np.where(s2 <= k2, 0.5 * s2, self.constant * np.sqrt(s2) - 0.5 * k2)
            case Loss.CAUCHY:
                return 0.5 * k2 * np.log1p(s2 / k2)
            case Loss.GEMAN_MCCLURE:
                return 0.5 * k2 * s2 / (k2 + s2)
            case Loss.TUKEY:
                u: NDArray[np.float64] = np.minimum(s2 / k2, 1.0)
                return k2 / 6.0 * u * (3.0 - 3.0 * u + u * u)  # 1 - (1 - u)^3 without its cancellation near zero

    def _squares(self, distances: ArrayLike) -> tuple[NDArray[np.float64], float]:
        squares: NDArray[np.float64] = np.square(np.asarray(distances, dtype=np.float64))
        return squares, self.constant**2

    def estimator(self) -> Any:
        """GTSAM's estimator of this loss."""
        kinds: dict[Loss, Any] = {
            Loss.HUBER: gtsam.noiseModel.mEstimator.Huber,
            Loss.CAUCHY: gtsam.noiseModel.mEstimator.Cauchy,
            Loss.GEMAN_MCCLURE: gtsam.noiseModel.mEstimator.GemanMcClure,
            Loss.TUKEY: gtsam.noiseModel.mEstimator.Tukey,
        }
        return kinds[self.loss].Create(self.constant)


def keypoint_noise(
    weight: float,
    sigma: float,
    *,
    covariance: ArrayLike | None = None,
    robust: RobustLoss | None = None,
) -> gtsam.noiseModel.Base | None:
    """Noise model of one keypoint's reprojection factor.

    Args:
        weight: IRLS weight w_i >= 0.
        sigma: Standard deviation sigma_0 of a keypoint of weight 1, pixels; not used where a covariance is given.
        covariance: (2, 2) covariance of the keypoint, pixels^2, where the detector gives one.
        robust: Robust loss around it, or None.

    Returns:
        The noise model, or None for a weight of zero (the keypoint gets no factor).

    Raises:
        InvalidInputError: The weight is negative or not finite, sigma is not positive, or the covariance is not
            symmetric positive definite.
    """
    if not (np.isfinite(weight) and weight >= 0):
        raise InvalidInputError("weight", weight, "Give a finite weight >= 0.")
    if weight < _SMALLEST_WEIGHT:
        return None
    noise: gtsam.noiseModel.Base
    if covariance is None:
        noise = gtsam.noiseModel.Isotropic.Sigma(2, _positive("sigma", sigma) / float(np.sqrt(weight)))
    else:
        matrix = finite_array("covariance", covariance, (2, 2))
        if matrix[0, 1] != matrix[1, 0] or matrix[0, 0] <= 0 or np.linalg.det(matrix) <= 0:
            raise InvalidInputError("covariance", matrix.tolist(), "Give a symmetric positive definite 2x2 matrix.")
        noise = gtsam.noiseModel.Gaussian.Covariance(matrix / weight)
    return noise if robust is None else robust.wrap(noise)


def keypoint_whiteners(weights: ArrayLike, sigma: float, covariances: ArrayLike | None = None) -> NDArray[np.float64]:
    """Inverse square roots of Sigma_i / w_i for many keypoints at once.

    Args:
        weights: (K,) IRLS weights w_i >= 0.
        sigma: Standard deviation sigma_0 of a keypoint of weight 1, pixels; not used where covariances are given.
        covariances: (K, 2, 2) covariance of each keypoint, pixels^2, or None.

    Returns:
        (K, 3) entries a, b, c of lower triangular matrices W_i = [[a, 0], [b, c]], W_i' W_i = w_i Sigma_i^-1; zero for
        a keypoint without weight.

    Raises:
        InvalidInputError: A weight is negative or not finite, sigma is not positive, or a covariance is not symmetric
            positive definite.
    """
    array = finite_array("weights", weights, (None,))
    if array.size and array.min() < 0:
        raise InvalidInputError("weights", float(array.min()), "Give weights >= 0.")
    result = np.zeros((len(array), 3))
    if covariances is None:
        result[:, 0] = result[:, 2] = 1.0 / _positive("sigma", sigma)
    else:
        S = finite_array("covariances", covariances, (len(array), 2, 2))
        determinants = S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2
        wrong = (S[:, 0, 1] != S[:, 1, 0]) | (S[:, 0, 0] <= 0) | (determinants <= 0)
        if wrong.any():
            raise InvalidInputError("covariances", S[wrong][0].tolist(), "Give symmetric positive definite matrices.")
        # The inverse of the Cholesky factor [[l, 0], [m, n]] with l^2 = S_00, l m = S_01, l n = sqrt(det).
        result[:, 0] = 1.0 / np.sqrt(S[:, 0, 0])
        result[:, 2] = np.sqrt(S[:, 0, 0] / determinants)
        result[:, 1] = -S[:, 0, 1] / S[:, 0, 0] * result[:, 2]
    return result * np.sqrt(np.where(array < _SMALLEST_WEIGHT, 0.0, array))[:, None]


def diagonal_noise(field: str, sigmas: ArrayLike) -> gtsam.noiseModel.Diagonal:
    """Noise model with one standard deviation per row.

    Raises:
        InvalidInputError: A sigma is not positive and finite (GTSAM would make a hard constraint of zero).
    """
    array = finite_array(field, sigmas, (None,))
    if not len(array) or array.min() <= 0:
        raise InvalidInputError(field, array.tolist(), "Give positive standard deviations.")
    return gtsam.noiseModel.Diagonal.Sigmas(array)


def as_noise(field: str, noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """A noise model of dimension `rows` from a model or from one sigma.

    Raises:
        InvalidInputError: The model has another dimension, or sigma is not positive and finite.
    """
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise InvalidInputError(f"{field}.noise", f"dimension {noise.dim()}", f"Give a model of dimension {rows}.")
        return noise
    return gtsam.noiseModel.Isotropic.Sigma(rows, _positive(f"{field}.noise", noise))


def _positive(field: str, value: float) -> float:
    number = float(value)
    if not (np.isfinite(number) and number > 0):
        raise InvalidInputError(field, value, "Give a positive number.")
    return number
