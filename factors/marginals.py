"""Marginalisation: eliminated variables leave a linear factor on their neighbours in the graph.

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

from factors.arrays import Array
from factors.errors import InvalidInputError
from factors.guard import Evaluation, guarded_factor
from factors.system import ordering_of

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
    information, linear = graph.linearize(values).hessian(ordering_of([*leaving, *staying]))
    zero = values.zeroVectors()
    dims = tuple(len(zero.at(key)) for key in staying)
    cut = len(linear) - sum(dims)
    inner = information[:cut, :cut] + _DAMPED * np.diag(np.maximum(np.diag(information)[:cut], _DAMPED))
    gain = np.empty((sum(dims), cut))
    for part in _parts(graph, leaving, [len(zero.at(key)) for key in leaving]):
        gain[:, part] = np.linalg.solve(inner[np.ix_(part, part)], information[part, cut:]).T
    kept = gtsam.Values(values)
    for key in set(kept.keys()) - set(staying):
        kept.erase(key)
    left = information[cut:, cut:] - gain @ information[:cut, cut:]
    return _marginal(tuple(staying), dims, kept, left, linear[cut:] - gain @ linear[:cut])


def _parts(graph: gtsam.NonlinearFactorGraph, leaving: Sequence[int], dims: Sequence[int]) -> list[list[int]]:
    """Places of the numbers of variables that leave, those apart that no factor ties to one another."""
    of = {key: {key} for key in leaving}
    for factor in map(graph.at, range(graph.size())):
        tied = [key for key in factor.keys() if key in of]  # noqa: SIM118 - GTSAM's
        for other in tied[1:]:
            if of[other] is not of[tied[0]]:
                of[tied[0]] |= of[other]
                of |= dict.fromkeys(of[other], of[tied[0]])
    ends = dict(zip(leaving, pairwise(accumulate(dims, initial=0)), strict=True))
    each = {id(some): some for some in of.values()}.values()
    return [[place for key in sorted(some) for place in range(*ends[key])] for some in each]


def _marginal(
    keys: tuple[int, ...], dims: tuple[int, ...], values: gtsam.Values, information: Array, linear: Array
) -> Marginal:
    """From the information (D, D) at values, and what it would move there (D,)."""
    spread, axes = np.linalg.eigh((information + information.T) / 2.0)
    known = spread > _NOTHING * max(spread[-1], 1e-300)
    root = np.sqrt(spread[known])
    right = axes[:, known].T @ linear / root
    return Marginal(keys, dims, values, root[:, None] * axes[:, known].T, right)


def normal_marginal(key: int, mean: Array, covariance: Array) -> Marginal:
    """What is known of a vector (D,) that has a mean and a covariance.

    Raises:
        LinAlgError: The covariance is singular.
    """
    values = gtsam.Values()
    values.insert(key, mean)
    return _marginal((key,), (len(mean),), values, np.linalg.inv(covariance).astype(np.float64), np.zeros(len(mean)))


def both(one: Marginal, other: Marginal) -> Marginal:
    """What is known of a vector by both, at the place that they give.

    Raises:
        LinAlgError: They leave it open.
    """
    (key,) = one.keys
    information = one.matrix.T @ one.matrix + other.matrix.T @ other.matrix

    def pull(place: Array) -> Array:
        total = np.zeros(len(place))
        for some in (one, other):
            total += some.matrix.T @ (some.right - some.matrix @ (place - some.values.atVector(key)))
        return total

    place = one.values.atVector(key)
    place = place + np.linalg.solve(information, pull(place))
    values = gtsam.Values()
    values.insert(key, place)
    return _marginal(one.keys, one.dims, values, information, pull(place))


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
