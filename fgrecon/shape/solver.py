"""Levenberg-Marquardt on a factor graph, with every iterate on request."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam

from fgrecon.errors import DegenerateProblemError, FactorCallbackError

__all__ = ["Solution", "minimise"]


@dataclass(frozen=True)
class Solution:
    """Values at the minimum and, if asked for, after every accepted iteration; and the final error."""

    values: gtsam.Values
    path: tuple[gtsam.Values, ...]
    error: float
    iterations: int


def minimise(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    *,
    relative_tolerance: float = 1e-9,
    max_iterations: int = 30,
    record: bool = False,
) -> Solution:
    """Minimise the graph's error from a start.

    Args:
        graph: Factors with noise models.
        start: Finite values with every keypoint in front of the camera; they are returned where there are none.
        relative_tolerance: Stop once an iteration lowers the error by less than this fraction.
        max_iterations: Upper limit.
        record: Keep the values after every iteration.

    Raises:
        DegenerateProblemError: The linear system of a step has no solution, or the start has an infinite error.
    """
    if start.empty():  # a constant shape at a fixed pose
        return Solution(start, (), float(graph.error(start)), 0)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(relative_tolerance)
    parameters.setAbsoluteErrorTol(1e-12)
    parameters.setMaxIterations(max_iterations)
    path: list[gtsam.Values] = []  # copies: GTSAM hands out references into the optimizer
    optimizers: list[Any] = []
    if record:
        parameters.iterationHook = lambda *_: path.append(gtsam.Values(optimizers[0].values()))
    optimizers.append(gtsam.LevenbergMarquardtOptimizer(graph, start, parameters))
    try:
        values = gtsam.Values(optimizers[0].optimize())
    except FactorCallbackError:
        raise
    except RuntimeError as error:  # GTSAM's own: an indefinite or singular system
        raise DegenerateProblemError("keypoints", str(error), "Give more, or better spread, keypoints.") from error
    finally:
        optimizer = optimizers.pop()
    return Solution(values, tuple(path), float(optimizer.error()), int(optimizer.iterations()))
