"""GTSAM's linear factors of vectors, which are compiled as well (`factors.system`)."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from factors.guard import CompiledRows
from factors.native import native


class ZeroPrior(gtsam.PriorFactorVector):
    """A vector is about zero."""

    def __init__(self, key: int, noise: Any) -> None:
        """Make the factor; its noise model has the vector's size, and may be robust."""
        super().__init__(key, np.zeros(noise.dim()), noise)
        self.compiled = _compiled((key,), noise)


class Walk(gtsam.BetweenFactorVector):
    """A vector is about what it was before."""

    def __init__(self, key: int, next_key: int, noise: Any) -> None:
        """Make the factor; its noise model has the vectors' size, and may be robust."""
        super().__init__(key, next_key, np.zeros(noise.dim()), noise)
        self.compiled = _compiled((key, next_key), noise)


def _compiled(keys: tuple[int, ...], noise: Any) -> CompiledRows | None:
    kernel = native("factors._rows")
    return None if kernel is None else CompiledRows(kernel.Change(noise.dim(), len(keys) > 1), keys).with_noise(noise)
