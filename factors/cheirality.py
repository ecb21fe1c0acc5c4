"""Points in front of the camera: a barrier that rejects a step, and a check of the start.

Behind the camera the projection has no meaning and robust losses do not help: Tukey, Welsch, DCS and truncated losses
are finite at infinity and let the step through. A factor of its own, without any loss, is 0 in front and infinite
behind, so that Levenberg-Marquardt sees an infinite energy, rejects the step and damps.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from factors.errors import DegenerateProblemError
from factors.guard import Evaluation, guarded_factor
from factors.kernel import ProjectionKernel
from factors.projection import SHALLOWEST

__all__ = ["check_in_front", "cheirality_factor"]


def cheirality_factor(kernel: ProjectionKernel, min_depth: float = SHALLOWEST) -> gtsam.CustomFactor:
    """Barrier: 1 row, 0 where every keypoint lies deeper than `min_depth` (metres), else infinity; Jacobian zero.

    The optimisation must start in front of the camera: see `check_in_front`.

    Raises:
        InvalidInputError: The kernel has no variables.
    """
    callback = _Cheirality(kernel, min_depth, sum(kernel.dims))
    return guarded_factor("cheirality", 1.0, kernel.keys, kernel.dims, 1, callback, allow_infinite=True)


def check_in_front(kernel: ProjectionKernel, values: gtsam.Values, min_depth: float = SHALLOWEST) -> None:
    """Refuse a start with keypoints behind the camera, from where no step is ever accepted.

    Raises:
        DegenerateProblemError: A keypoint is not deeper than `min_depth`, or a depth is NaN.
    """
    pose = kernel.pose(values)
    depths = kernel.shape.points(values) @ pose[2, :3] + pose[2, 3]  # of the whole projection nothing else is wanted
    if not depths.min() > min_depth:
        raise DegenerateProblemError(
            "start",
            f"keypoints {np.flatnonzero(~(depths > min_depth)).tolist()} behind the camera",
            f"Move the start forward until every keypoint is deeper than {min_depth:g} m.",
        )


@dataclass(frozen=True, slots=True)
class _Cheirality:
    kernel: ProjectionKernel
    min_depth: float
    columns: int

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        shallowest = self.kernel.evaluate(values, want_jacobian).depths.min()
        residual = np.zeros(1) if not shallowest <= self.min_depth else np.full(1, np.inf)
        return residual, np.zeros((1, self.columns)) if want_jacobian else None
