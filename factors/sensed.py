"""Measurements of one vehicle in one image by other sensors than the camera: a factor on pose and lambda.

    X(v,t) ----+---- points, mask or range ---- L(v)
               +---- depth map ---- D(t,n)

Each may be a constant. What is matched anew between steps (which patch a point is next to, which vertex is on the
outline) is set by `look`; how the mixture is handed to the solver by `tell`, as with an observation's own rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import gtsam
import numpy as np

from factors.arrays import Array
from factors.guard import CompiledRows, Evaluation, guarded_factor
from factors.mixture import Form, robust_rows


class SensedFactor:
    """The callback of such a factor.

    It holds no factor, since GTSAM's hold it: neither would ever be freed.

    Attributes:
        name: Of its energy term.
        keys: Of its variables.
        form: How the mixture is handed to the solver.
        common_factor: By how much less it says of covariances, with `Form.WEIGHTED`; infinite where it is silent.
    """

    name: str

    def __init__(
        self,
        pose: int | Array,
        coefficients: int | Array,
        count: int,
        rows: int,
        more: Sequence[tuple[int | Array, int]] = (),
    ) -> None:
        """Bind it to variables by their keys, or to constants.

        Args:
            pose: camera_T_object (4, 4).
            coefficients: Lambda (N,).
            count: How many coefficients there are.
            rows: How many rows it has.
            more: Further variables, or constants, with their numbers.
        """
        self._pose, self._coefficients, self._count = pose, coefficients, rows
        self._more = [variable for variable, _ in more]
        ends = [0, *accumulate((6, count, *(size for _, size in more)))]
        every = zip((pose, coefficients, *self._more), map(slice, ends, ends[1:]), strict=True)
        bound = [(key, part) for key, part in every if isinstance(key, int)]
        self.keys = tuple(key for key, _ in bound)
        self._dims = tuple(part.stop - part.start for _, part in bound)
        self._columns = np.concatenate([np.arange(part.start, part.stop) for _, part in bound] or [np.zeros(0, int)])
        self._source: Any = None
        self.form, self.common_factor = Form.NEWTON, 1.0

    def state(self, values: gtsam.Values) -> tuple[Array, Array, Array]:
        """Rotation, translation and coefficients at the values."""
        pose = values.atPose3(self._pose).matrix() if isinstance(self._pose, int) else self._pose
        key = self._coefficients
        return pose[:3, :3], pose[:3, 3], values.atVector(key) if isinstance(key, int) else key

    def others(self, values: gtsam.Values) -> list[Array]:
        """What its further variables are at the values."""
        return [values.atVector(one) if isinstance(one, int) else one for one in self._more]

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Match anew at the values what is matched; `hold` keeps it."""

    @property
    def judges(self) -> bool:
        """Whether the compiled rows match and weigh themselves."""
        return self._source is not None and self._source.judged > 0

    def judged(self, found: Array) -> None:
        """Take over what the compiled rows found (`factors._rows.Source.judge`)."""

    def tell(self, form: Form, common_factor: float = 1.0) -> None:
        """Set the form, and by how much less it says with `Form.WEIGHTED`."""
        self.form, self.common_factor = form, common_factor
        if self._source is not None:
            self._source.form, self._source.common = int(form), common_factor

    def energy(self, values: gtsam.Values) -> float:
        """The energy at the values, nats; what is set stays as it is."""
        raise NotImplementedError

    def error(self, values: gtsam.Values) -> float:
        """What a step is judged by: half the squared rows at the values, with what is set, nats."""
        rows, _ = self(values, want_jacobian=False)
        return 0.5 * float(rows @ rows)

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values."""
        raise NotImplementedError

    def factor(self) -> gtsam.CustomFactor:
        """A factor of these rows; of unit noise, since they are whitened."""
        pose = self._pose
        packed = pose if isinstance(pose, int) else np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])
        variables = packed, self._coefficients, *self._more
        compiled = None if self._source is None else CompiledRows(self._source, variables)
        return guarded_factor(self.name, 1.0, self.keys, self._dims, self._count, self, compiled=compiled)

    def _robust(
        self, weights: Array, densities: tuple[Array, Array], residual: Array, jacobian: Array | None, *, share: float
    ) -> Evaluation:
        """The rows of a mixture, in the form that is set.

        Args:
            weights: (M,) weights, which `Form.WEIGHTED` has.
            densities: (M,) of right ones and of wrong ones.
            residual: (M,) whitened.
            jacobian: (M, D) its derivative by all variables, or None.
            share: Share of the energy that counts.
        """
        form = self.form if jacobian is not None or self.form is Form.WEIGHTED else Form.LOSS
        right = weights / self.common_factor if form is Form.WEIGHTED else densities[0]
        by = None if jacobian is None else jacobian[:, None, self._columns]
        rows, by = robust_rows(form, right, densities[1], residual[:, None], by)
        root = share**0.5
        return root * rows[:, 0], None if by is None else root * by[:, 0]
