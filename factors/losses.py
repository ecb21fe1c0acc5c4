"""Robust losses of whitened residuals, with their weights: in numpy, and as GTSAM's estimators of the same names."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.errors import InvalidInputError

if TYPE_CHECKING:  # on use: weights need numpy alone
    import gtsam

_LARGEST = 1e50  # beyond, squares are soon no floats


class Loss(Enum):
    """Robust losses rho(s) of a whitened residual norm s, and the tuning constant that gives 95 % efficiency."""

    HUBER = ("huber", 1.345)
    CAUCHY = ("cauchy", 2.3849)
    GEMAN_MCCLURE = ("geman_mcclure", 2.0)
    TUKEY = ("tukey", 4.6851)

    @property
    def label(self) -> str:
        """Name as users write it."""
        return self.value[0]

    @property
    def default_constant(self) -> float:
        """Usual tuning constant, in standard deviations (Geman-McClure has no agreed one: 2)."""
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
            InvalidInputError: The constant is not positive, or is enormous.
        """
        if not 1.0 / _LARGEST <= self.constant <= _LARGEST:
            raise InvalidInputError("constant", self.constant, f"Give a positive constant, up to {_LARGEST:g}.")

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
        import gtsam

        return gtsam.noiseModel.Robust.Create(self.estimator(), noise)

    def weights(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Weights rho'(s) / s of whitened residual norms s: what the solver multiplies squared residuals by."""
        return self.weights_of_squares(np.square(np.asarray(distances, dtype=np.float64)))

    def weights_of_squares(self, squares: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of squared norms s^2."""
        k, k2 = self.constant, self.constant**2
        match self.loss:
            case Loss.HUBER:
                return k / np.maximum(np.sqrt(squares), k)
            case Loss.CAUCHY:
                return k2 / (k2 + squares)
            case Loss.GEMAN_MCCLURE:
                return np.square(k2 / (k2 + squares))
            case Loss.TUKEY:
                return np.square(np.maximum(1.0 - squares / k2, 0.0))

    def losses(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Losses rho(s) of whitened residual norms s; s^2 / 2 near zero."""
        return self.losses_of_squares(np.square(np.asarray(distances, dtype=np.float64)))

    def losses_of_squares(self, squares: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of squared norms s^2."""
        k2 = self.constant**2
        match self.loss:
            case Loss.HUBER:
                return np.where(squares <= k2, 0.5 * squares, self.constant * np.sqrt(squares) - 0.5 * k2)
            case Loss.CAUCHY:
                return 0.5 * k2 * np.log1p(squares / k2)
            case Loss.GEMAN_MCCLURE:
                return 0.5 * k2 * squares / (k2 + squares)
            case Loss.TUKEY:
                u: NDArray[np.float64] = np.minimum(squares / k2, 1.0)
                return k2 / 6.0 * u * (3.0 - 3.0 * u + u * u)  # 1 - (1 - u)^3 without its cancellation near zero

    def estimator(self) -> Any:
        """GTSAM's estimator of this loss."""
        import gtsam

        kinds: dict[Loss, Any] = {
            Loss.HUBER: gtsam.noiseModel.mEstimator.Huber,
            Loss.CAUCHY: gtsam.noiseModel.mEstimator.Cauchy,
            Loss.GEMAN_MCCLURE: gtsam.noiseModel.mEstimator.GemanMcClure,
            Loss.TUKEY: gtsam.noiseModel.mEstimator.Tukey,
        }
        return kinds[self.loss].Create(self.constant)
