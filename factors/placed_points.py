"""Measured points of a sensor with uncertain extrinsics: a factor on pose, lambda and the extrinsics' error.

    p' = E p,    E = Exp(e)

for the points p as they are given and e (6,), the turn and shift that all of the sensor's points have wrong together.
Points moved by E against a vehicle at X are points as they are against one at E^-1 X: the rows are those of
`factors.surface_points` there, and

    dr / de = - dr / dX' Ad(X'^-1) J(e),    X' = E^-1 X

with the right Jacobian J of Exp.
"""

from __future__ import annotations

import gtsam
import numpy as np

from factors.arrays import Array
from factors.guard import Evaluation
from factors.surface_points import NOTHING_SHARED, PointRows, State, SurfacePointsFactor


class PlacedPointsFactor(SurfacePointsFactor):
    """Points on pose and lambda, and on the error of their sensor's place (6,), which is its `shared`."""

    def __init__(
        self,
        rows: PointRows,
        pose: int | Array,
        coefficients: int | Array,
        shared: int | Array,
        share: float = 1.0,
        name: str = "points",
    ) -> None:
        """Bind the points to variables by their keys, or to constants; they share nothing else."""
        super().__init__(rows, pose, coefficients, shared, share, name)
        self._source = None  # compiled rows read the pose itself
        self._placed = gtsam.Pose3()

    @staticmethod
    def _more_of(rows: PointRows, shared: int | Array) -> list[tuple[int | Array, int]]:  # noqa: ARG004
        return [(shared, 6)]

    def _state(self, values: gtsam.Values) -> State:
        """The state in which the points are where they were given."""
        rotation, translation, coefficients = self.state(values)
        pose = _error(self.others(values)[0]).inverse().compose(gtsam.Pose3(gtsam.Rot3(rotation), translation))
        return pose.rotation().matrix(), pose.translation(), coefficients, NOTHING_SHARED

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Match the points at the values and weigh them; see `SurfacePointsFactor.look`."""
        super().look(values, hold=hold)
        self._placed = _error(self.others(values)[0])

    @property
    def points(self) -> Array:
        """(M, 3) the points in the camera's frame, moved by the error where they were looked at last."""
        pose = self._placed.matrix()
        return np.asarray(self.rows.points @ pose[:3, :3].T + pose[:3, 3])

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        match, state = self._match_at(values), self._state(values)
        distances, by = self.rows.distances(match, *state, want=want_jacobian)
        if by is not None:
            there = gtsam.Pose3(gtsam.Rot3(state[0]), state[1])
            change = -there.inverse().AdjointMap() @ gtsam.Pose3.ExpmapDerivative(self.others(values)[0])
            by = np.concatenate([by, by[:, :6] @ change], axis=1)
        return self._robust(self.weights, (match.right, match.wrong), distances, by, share=self._share)


def _error(variables: Array) -> gtsam.Pose3:
    return gtsam.Pose3.Expmap(variables)
