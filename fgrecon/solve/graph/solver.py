"""Levenberg-Marquardt on a factor graph, with every iterate on request."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gtsam

from fgrecon.core.errors import DegenerateProblemError, FactorCallbackError
from fgrecon.solve.graph.graph_settings import SETTINGS


@dataclass(frozen=True)
class Solution:
    """What a minimisation ends with."""

    values: gtsam.Values  # values at the minimum
    path: tuple[gtsam.Values, ...]  # values after every accepted iteration, if asked for
    error: float  # the graph's error there
    iterations: int  # number of iterations
    converged: bool  # whether the last iteration lowered the error by hardly anything
    damping: float  # of the step that would follow


def minimise(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    *,
    relative_tolerance: float = 1e-9,
    max_iterations: int = 60,
    damping: float = SETTINGS.first_damping,
    record: bool = False,
) -> Solution:
    """Minimise the graph's error from a start.

    Args:
        graph: Factors with noise models.
        start: Finite values with every keypoint in front of the camera; they are returned where there are none.
        relative_tolerance: Stop once an iteration lowers the error by less than this fraction.
        max_iterations: Upper limit.
        damping: Of the first step.
        record: Keep the values after every iteration.

    Raises:
        DegenerateProblemError: The start has an infinite energy, or GTSAM gives a step up. (A direction that no factor
            determines is no error here: damping keeps it where it is. `fgrecon.solve.graph.covariance` finds it.)
    """
    if start.empty():  # a constant shape at a fixed pose
        return Solution(start, (), float(graph.error(start)), 0, converged=True, damping=damping)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(relative_tolerance)
    parameters.setAbsoluteErrorTol(SETTINGS.absolute_decrease_nats)
    parameters.setMaxIterations(max_iterations)
    parameters.setlambdaInitial(damping)
    path: list[gtsam.Values] = []  # copies: GTSAM hands out references into the optimizer
    optimizers: list[Any] = []
    decrease = 0.0

    def observe(_: Any, before: Any, after: Any) -> None:
        nonlocal decrease
        decrease = float(before) - float(after)
        if record:
            path.append(gtsam.Values(optimizers[0].values()))

    parameters.iterationHook = observe
    optimizers.append(gtsam.LevenbergMarquardtOptimizer(graph, start, parameters))
    try:
        values = gtsam.Values(optimizers[0].optimize())
    except FactorCallbackError:
        raise
    except RuntimeError as failure:  # GTSAM's own: an indefinite or singular system
        raise DegenerateProblemError("keypoints", str(failure), "Give more, or better spread, keypoints.") from failure
    finally:
        optimizer = optimizers.pop()
    error = float(optimizer.error())
    if not math.isfinite(error):  # GTSAM returns such a start as it is, without a word
        raise DegenerateProblemError("start", f"energy {error}", "Start with every keypoint in front of the camera.")
    converged = decrease <= max(relative_tolerance * error, SETTINGS.negligible_gain_nats)
    iterations, damping = int(optimizer.iterations()), float(optimizer.lambda_())
    return Solution(values, tuple(path), error, iterations, converged, damping)
