"""What is left of variables that are taken out of a graph: a linear factor on those that they were tied to.

About the values x0 at which the graph was linearised, the variables that leave, eliminated (Schur's complement), leave

    0.5 |A (x - x0) - b|^2

behind on the others. `marginal` makes it, `marginal_factor` puts it into the next graph. (GTSAM's own container of
linear factors is made of at most three variables from Python.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor

Array = NDArray[np.float64]

_DAMPED = 1e-9  # of the diagonal of what is eliminated: directions that nothing determines
_NOTHING = 1e-12  # share of the largest information below which a direction has none


@dataclass(frozen=True)
class Marginal:
    """What variables left behind.

    Attributes:
        keys: Variables that it is about.
        dims: Their tangent dimensions.
        values: x0.
        matrix: (R, D) A, whitened.
        right: (R,) b.
    """

    keys: tuple[int, ...]
    dims: tuple[int, ...]
    values: gtsam.Values
    matrix: Array
    right: Array

    def scaled(self, share: float) -> Marginal:
        """The same with a share of its information."""
        root = share**0.5
        return Marginal(self.keys, self.dims, self.values, root * self.matrix, root * self.right)


def marginal(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, leaving: Sequence[int]) -> Marginal:
    """Linearise a graph and eliminate variables.

    Args:
        graph: Every factor of the variables that leave, and no other.
        values: Where to linearise, with all variables of the graph.
        leaving: Keys of the variables that leave.
    """
    staying = sorted(graph.keyVector(), key=int)
    staying = [key for key in staying if key not in leaving]
    ordering = gtsam.Ordering()
    for key in (*leaving, *staying):
        ordering.push_back(key)
    information, linear = graph.linearize(values).hessian(ordering)
    zero = values.zeroVectors()
    dims = tuple(len(zero.at(key)) for key in staying)
    cut = len(linear) - sum(dims)
    inner = information[:cut, :cut] + _DAMPED * np.diag(np.maximum(np.diag(information)[:cut], _DAMPED))
    gain = np.linalg.solve(inner, information[:cut, cut:]).T
    left = information[cut:, cut:] - gain @ information[:cut, cut:]
    spread, axes = np.linalg.eigh((left + left.T) / 2.0)
    known = spread > _NOTHING * max(spread[-1], 1e-300)
    root = np.sqrt(spread[known])
    right = axes[:, known].T @ (linear[cut:] - gain @ linear[:cut]) / root
    kept = gtsam.Values(values)
    for key in set(kept.keys()) - set(staying):
        kept.erase(key)
    return Marginal(tuple(staying), dims, kept, root[:, None] * axes[:, known].T, right)


def marginal_factor(past: Marginal) -> gtsam.CustomFactor:
    """The factor; its residual has as many rows as the matrix, without unit.

    Raises:
        InvalidInputError: A variable that is left is neither a pose X nor a vector.
    """
    for key in past.keys:
        if gtsam.Symbol(key).chr() != ord("X"):
            try:
                past.values.atVector(key)
            except RuntimeError as error:
                fix = "Let planes leave as well: what is left may be about poses and vectors."
                raise InvalidInputError("marginal", gtsam.Symbol(key).string(), fix) from error
    rows = len(past.right)
    noise = gtsam.noiseModel.Unit.Create(rows)
    return guarded_factor("marginal", noise, past.keys, past.dims, rows, _Callback(past))


@dataclass(frozen=True, slots=True)
class _Callback:
    past: Marginal

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        past = self.past
        moved = np.empty(past.matrix.shape[1])
        jacobian = past.matrix.copy() if want_jacobian else None
        for key, (a, b) in zip(past.keys, pairwise(accumulate(past.dims, initial=0)), strict=True):
            if gtsam.Symbol(key).chr() == ord("X"):
                off = past.values.atPose3(key).between(values.atPose3(key))
                moved[a:b] = gtsam.Pose3.Logmap(off)
                if jacobian is not None:
                    jacobian[:, a:b] = past.matrix[:, a:b] @ gtsam.Pose3.LogmapDerivative(off)
            else:
                moved[a:b] = values.atVector(key) - past.values.atVector(key)
        return past.matrix @ moved - past.right, jacobian
