"""Whether probabilities mean what they say: how often what was said with a probability is so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Reliability", "reliability"]


@dataclass(frozen=True)
class Reliability:
    """How often statements of a confidence are right; arrays of B bins that hold equally many statements.

    Attributes:
        confidence: (B,) mean confidence.
        right: (B,) share that is right.
        count: (B,) number of statements.
    """

    confidence: NDArray[np.float64]
    right: NDArray[np.float64]
    count: NDArray[np.int64]

    @property
    def error(self) -> float:
        """Expected calibration error: mean distance of the two, by number of statements."""
        return float(np.abs(self.confidence - self.right) @ self.count / max(self.count.sum(), 1))


def reliability(confidence: ArrayLike, right: ArrayLike, bins: int = 10) -> Reliability:
    """Sort statements (any shape) by confidence into bins of equal size."""
    sure, hit = np.ravel(confidence).astype(np.float64), np.ravel(right).astype(np.float64)
    parts = [part for part in np.array_split(np.argsort(sure, kind="stable"), bins) if len(part)]
    return Reliability(
        np.array([sure[part].mean() for part in parts]),
        np.array([hit[part].mean() for part in parts]),
        np.array([len(part) for part in parts], dtype=np.int64),
    )
