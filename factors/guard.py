"""The one gate between Python residuals and GTSAM.

A Jacobian with a wrong number of rows kills the process, one with a wrong number of columns gives a wrong answer in
silence, and a NaN stops the optimiser without a word. So every factor of this package is built by `guarded_factor`,
which checks what a callback returns before GTSAM sees it. An exception inside a callback keeps its type and aborts the
optimisation.

A callback is a plain callable (a frozen dataclass with ``__call__``), because a bound method of a ``CustomFactor``
subclass leaks memory. It returns its whole Jacobian as one array, whose columns follow the keys: one check covers all
blocks, and a kernel that evaluates every keypoint at once hands out its rows as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.errors import FactorCallbackError, InvalidInputError
from factors.keys import key_name
from factors.noise import Noise, as_noise

Evaluation = tuple[NDArray[np.float64], NDArray[np.float64] | None]
"""Residual (rows,) and Jacobian (rows, sum of the dimensions of all keys); the latter may be None where not wanted."""

Callback = Callable[[gtsam.Values, bool], Evaluation]
"""Evaluates a residual at the values; the flag says whether the Jacobian is wanted."""


@dataclass(frozen=True, slots=True)
class CompiledRows:
    """The rows of a callback, compiled."""

    source: Any  # what has them, a `factors._rows.Source`
    # of each variable that it takes the key, or its value where it is a constant, or None where there is none
    variables: tuple[int | NDArray[np.float64] | None, ...]
    # (rows, rows) upper triangular, by which a noise model whitens them; None where they are whitened
    whitener: NDArray[np.float64] | None = None
    robust: Any = None  # GTSAM's estimator that weighs them; None for none

    @property
    def keys(self) -> tuple[int, ...]:
        """Keys of its variables."""
        return tuple([variable for variable in self.variables if isinstance(variable, int)])

    def with_noise(self, model: Any) -> CompiledRows:
        """The rows with a noise model: Gaussian, or robust around such a one."""
        robust = None
        if isinstance(model, gtsam.noiseModel.Robust):
            robust, model = model.robust(), model.noise()
        whitener = None if model.isUnit() else np.ascontiguousarray(model.R())
        return CompiledRows(self.source, self.variables, whitener, robust)


class CompiledFactor(gtsam.CustomFactor):
    """A factor that is compiled as well: `factors.system` linearises it without its callback."""

    def __init__(self, noise: Any, keys: Sequence[int], callback: Any, compiled: CompiledRows) -> None:
        """Make the factor of rows before the noise model whitens them."""
        super().__init__(noise, keys, callback)
        self.compiled = compiled.with_noise(noise)


_FLOAT = np.dtype(np.float64)
_INFINITY = float("inf")
_dot = np.vdot


def guarded_factor(
    name: str,
    noise: Noise,
    keys: Sequence[int],
    dims: Sequence[int],
    rows: int,
    callback: Callback,
    *,
    allow_infinite: bool = False,
    compiled: CompiledRows | None = None,
) -> gtsam.CustomFactor:
    """Wrap a callback into a GTSAM factor whose every evaluation is checked.

    Args:
        name: Name of the factor, for error messages.
        noise: Noise model of dimension `rows`, or one sigma for all rows in the residual's unit.
        keys: Keys of the variables.
        dims: Tangent dimension of each variable.
        rows: Length of the residual.
        callback: Evaluates residual and Jacobian.
        allow_infinite: Whether the residual may be infinite, so that Levenberg-Marquardt rejects the step. NaN never is
            allowed, nor is an infinite Jacobian.
        compiled: The same rows compiled, before the noise model whitens them; None where they are not.

    Returns:
        The factor. Evaluating it raises `FactorCallbackError` where the callback returns a wrong shape or type, or
        numbers that are not finite.

    Raises:
        InvalidInputError: There are no keys, one is repeated, `dims` does not match them, the noise model has another
            dimension, or the callback is no function.
    """
    if not keys or len(set(keys)) != len(keys):
        raise InvalidInputError(f"{name}.keys", [key_name(k) for k in keys], "Give at least one key, each once.")
    if len(dims) != len(keys) or min(dims) < 1 or rows < 1:
        raise InvalidInputError(f"{name}.dims", (tuple(dims), rows), "Give one positive dimension per key.")
    given: object = callback
    if not callable(given):
        fix = "Give a function of the values, and of whether the Jacobian is wanted."
        raise InvalidInputError(f"{name}.callback", given, fix)
    blocks = tuple(slice(a, b) for a, b in pairwise(accumulate(dims, initial=0)))
    guard = _Guard(name, callback, (rows,), (rows, sum(dims)), blocks, len(blocks) == 1, allow_infinite)
    model = as_noise(name, noise, rows)
    if compiled is None:
        return gtsam.CustomFactor(model, list(keys), guard)
    return CompiledFactor(model, list(keys), guard, compiled)


@dataclass(frozen=True, slots=True)
class _Guard:
    """What GTSAM calls; it holds no reference to its factor, so that the two are freed without a cycle."""

    name: str
    callback: Callback
    residual_shape: tuple[int]
    jacobian_shape: tuple[int, int]
    blocks: tuple[slice, ...]
    single: bool
    allow_infinite: bool

    def __call__(self, _factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> NDArray[np.float64]:
        result = self.callback(values, jacobians is not None)
        if type(result) is not tuple or len(result) != 2:
            raise FactorCallbackError(f"{self.name}: the callback must return (residual, Jacobian), got {type(result)}")
        residual, jacobian = result
        # NaN and infinity survive in the sum of squares: one cheap product clears nearly every array. `_explain` looks
        # at the rest and has the last word (squares of finite numbers may overflow).
        if (
            type(residual) is not np.ndarray
            or residual.shape != self.residual_shape
            or residual.dtype is not _FLOAT
            or not residual.dot(residual) < _INFINITY
        ):
            self._explain("residual", residual, self.residual_shape, self.allow_infinite)
        if jacobians is None:
            return residual
        if (
            type(jacobian) is not np.ndarray
            or jacobian.shape != self.jacobian_shape
            or jacobian.dtype is not _FLOAT
            or not _dot(jacobian, jacobian) < _INFINITY
        ):
            self._explain("Jacobian", jacobian, self.jacobian_shape, allow_infinite=False)
        if self.single:
            jacobians[0] = jacobian
        else:
            for i, block in enumerate(self.blocks):
                jacobians[i] = jacobian[:, block]  # type: ignore[index]  # an array: checked above
        return residual

    def _explain(self, what: str, array: Any, shape: tuple[int, ...], allow_infinite: bool) -> None:
        """Raise the error of an array that failed the quick test, unless it turns out to be right."""
        if type(array) is not np.ndarray or array.shape != shape or array.dtype != _FLOAT:
            got = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise FactorCallbackError(f"{self.name}: the {what} must be float64 {shape}, got {got}")
        wrong = np.isnan(array) if allow_infinite else ~np.isfinite(array)
        if wrong.any():
            where = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise FactorCallbackError(f"{self.name}: the {what} is {array[where]} at {where}")
