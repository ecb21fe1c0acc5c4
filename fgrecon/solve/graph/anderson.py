"""Anderson acceleration of a fixed-point iteration that converges slowly."""

from __future__ import annotations

import numpy as np

from factors.native import native
from fgrecon.core.arrays import Array
from fgrecon.solve.graph.graph_settings import SETTINGS

NEWTON = SETTINGS.newton


class Anderson:
    """Anderson's acceleration of the iteration x -> x + f(x), from the last steps (Walker and Ni 2011, type II).

    The tangent spaces of successive iterates are taken for one: near the end they are.
    """

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._kernel = native("fgrecon.solve._native")
        self._changes: Array | None = None  # (n, D) of f, and
        self._moves: Array | None = None  # what was moved meanwhile
        self._last: Array | None = None
        self._moved: Array | None = None

    def propose(self, step: Array) -> Array | None:
        """Where to go, given the plain step f (D,); None where nothing is known but that."""
        if self._last is not None and self._moved is not None:
            self._changes = _remembered(self._changes, step - self._last)
            self._moves = _remembered(self._moves, self._moved)
        self._last = step
        if self._changes is None or self._moves is None:
            return None
        if self._kernel is not None:
            return self._kernel.accelerated(self._changes, self._moves, step, NEWTON.acceleration_ridge)
        return _accelerated(self._changes, self._moves, step)

    def took(self, step: Array) -> None:
        """Say what step was made."""
        self._moved = step

    def forget(self) -> None:
        """Forget what was learnt: the steps were not those of one iteration."""
        self._changes = self._moves = self._last = self._moved = None


def _accelerated(changes: Array, moves: Array, step: Array) -> Array | None:
    """The step whose change by the mixture of the remembered ones is least; None where a change is none."""
    squares = changes @ changes.T
    index = np.arange(len(squares))
    squares[index, index] *= 1.0 + NEWTON.acceleration_ridge
    try:
        np.linalg.cholesky(squares)
        share = np.linalg.solve(squares, changes @ step)
    except np.linalg.LinAlgError:
        return None
    return step - share @ (moves + changes)


def _remembered(rows: Array | None, row: Array) -> Array:
    """The last few rows (n, D) with one more."""
    return row[None] if rows is None else np.concatenate([rows[1 - NEWTON.remembered_steps :], row[None]])
