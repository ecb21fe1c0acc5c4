"""All that an image says of a vehicle in one factor: keypoints, box, ground and the barrier at the camera.

Each term's rows are written once (`factors.keypoint_rows`, `factors.box`, `factors.ground`), and once more in the
compiled kernel, which does the work where it is there. Keypoints and edges that may be wrong are so inside the factor
(`factors.mixture`), so that one minimisation finds the minimum of the robust energy, where re-weighting needs many;
m-estimators are inside as well (`factors.losses`). One callback is what costs: GTSAM hands a copy of all values to
each. `term_factor` has the rows of one term alone.

Behind the camera the projection has no meaning, and some robust losses are finite there. So the energy is infinite
where a keypoint is not in front of the camera: Levenberg-Marquardt rejects the step and damps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.arrays import Array
from factors.box import OUTWARD, BoxRows, crease_rows, projected_extents
from factors.checks import finite_array
from factors.errors import DegenerateProblemError, InvalidInputError
from factors.ground import GroundRows
from factors.guard import CompiledRows, Evaluation, guarded_factor
from factors.keypoint_rows import SMALLEST_WEIGHT, KeypointRows, whiteners
from factors.losses import RobustLoss
from factors.mixture import Form, robust_rows
from factors.projection import SHALLOWEST
from factors.projection_kernel import ProjectionKernel
from factors.system import packed_pose


@dataclass(eq=False)
class ObservationRows:
    """The callback of an observation factor; what changes between solves is set on it.

    Rows: two for each keypoint, four for the box, four for the ground, four for the box's creases; those that do not
    apply are zero. Columns: the kernel's variables.

    Attributes:
        kernel: Projects the keypoints.
        keypoints: Where they were measured.
        box: The box, or None.
        outline: Projects the points whose extents the box encloses; of the same pose and lambda.
        ground: The ground, or None.
        compiled: The same as `factors._energy.ImageRows`, or None; it knows one focal length.
        share: Factor on the energy of all rows.
        form: How the mixtures are handed to the solver.
        right: (K,) densities of right points, or their weights (`Form.WEIGHTED`); 0 for points that were not measured.
        wrong: (K,) densities of wrong points.
        edge_weights: (4,) weights of the edges, for `Form.WEIGHTED`.
        height_sigma: Standard deviation of the origin's height over the ground, metres.
        robust: M-estimator of the keypoints, for `Form.WEIGHTED`: a loss rho(d) times the weight.
    """

    kernel: ProjectionKernel
    keypoints: KeypointRows
    box: BoxRows | None = None
    outline: ProjectionKernel | None = None
    ground: GroundRows | None = None
    compiled: Any = None
    share: float = 1.0
    form: Form = Form.NEWTON
    right: Array = None  # type: ignore[assignment]  # set before the first evaluation
    wrong: Array = None  # type: ignore[assignment]
    edge_weights: Array = None  # type: ignore[assignment]
    height_sigma: float = 1.0
    robust: RobustLoss | None = None

    def __post_init__(self) -> None:
        """Prepare what does not change."""
        size = len(self.keypoints.pixels)
        self.right, self.wrong, self.edge_weights = np.zeros(size), np.ones(size), np.ones(4)
        shape = self.kernel.shape
        count, width = len(shape.basis), 6 + len(shape.basis) + 3 * size
        variable = np.zeros(width, dtype=bool)
        variable[:6] = self.kernel.pose_key is not None
        variable[6 : 6 + count] = shape.coefficients_key is not None
        variable[6 + count :] = shape.offsets_key is not None
        self._width, self._columns = width, None if variable.all() else np.flatnonzero(variable)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return 2 * len(self.keypoints.pixels) + 12

    @property
    def terms(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Rows of each term that there is, and the keys that they depend on."""
        size, kernel = 2 * len(self.keypoints.pixels), self.kernel
        terms = {"reprojection": (slice(0, size), kernel.keys)}
        terms["cheirality"] = slice(size + 11, size + 12), kernel.keys  # zero, or infinite as all are
        if self.box is not None and self.outline is not None and self.outline.keys:
            terms["box"] = slice(size, size + 4), self.outline.keys
        if self.ground is not None and kernel.pose_key is not None:
            terms["ground"] = slice(size + 4, size + 8), (kernel.pose_key,)
        return terms

    @property
    def compiled_rows(self) -> CompiledRows | None:
        """The compiled rows with their variables."""
        if self.compiled is None:
            return None
        pose = self.kernel.bound
        return CompiledRows(
            self.compiled, (pose if isinstance(pose, int) else packed_pose(pose), *self.kernel.shape.bound)
        )

    def tell(self) -> None:
        """Set what is set here on the compiled rows, where there are any."""
        if self.compiled is not None:
            self.compiled.form = int(self.form)
            self.compiled.tell(self.right, self.wrong, self.edge_weights, self.height_sigma)

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values; an infinite residual where a keypoint is behind the camera, or infinitely far."""
        if self.compiled is not None:
            return self._by_kernel(values, want_jacobian)
        form = self.form if want_jacobian or self.form is Form.WEIGHTED else Form.LOSS
        nearest, residual, jacobian = self._by_numpy(values, form, want_jacobian)
        if not SHALLOWEST < nearest < np.inf:
            return np.full(self.rows, np.inf), None if jacobian is None else np.zeros_like(jacobian)
        if self.robust is not None:
            self._estimate(self.robust, residual, jacobian)
        if self.share != 1.0:
            residual *= self.share**0.5
            if jacobian is not None:
                jacobian *= self.share**0.5
        return residual, jacobian

    def _by_kernel(self, values: gtsam.Values, want: bool) -> Evaluation:
        shape = self.kernel.shape
        residual = np.empty(self.rows)
        jacobian = np.empty((self.rows, self._width)) if want else None
        self.tell()
        variables = (packed_pose(self.kernel.pose(values)), shape.coefficients(values), shape.offsets(values))
        self.compiled.evaluate(variables, residual, jacobian)
        if jacobian is not None and self._columns is not None:
            jacobian = jacobian[:, self._columns]
        return residual, jacobian

    @np.errstate(invalid="ignore")  # infinitely far there is no direction
    def _by_numpy(self, values: gtsam.Values, form: Form, want: bool) -> tuple[float, Array, Array | None]:
        at = self.kernel.evaluate(values, want)
        size, columns = 2 * len(self.keypoints.pixels), sum(self.kernel.dims)
        white = self.keypoints.residual(at.pixels)
        by = self.keypoints.whiten(at.jacobian) if want and at.jacobian is not None else None
        residual, jacobian = np.zeros(self.rows), np.zeros((self.rows, columns)) if want else None
        rows, by = robust_rows(form, self.right, self.wrong, white, by)
        residual[:size] = rows.ravel()
        if jacobian is not None and by is not None:
            jacobian[:size] = by.reshape(size, columns)
        self._box(values, form, residual[size:], None if jacobian is None else jacobian[size:])
        if self.ground is not None:
            pose = self.kernel.pose(values)
            rows, by_turn, by_shift = self.ground.whitened(pose[:3, :3], pose[:3, 3], self.height_sigma)
            residual[size + 4 : size + 8] = rows
            if jacobian is not None and self.kernel.pose_key is not None:
                jacobian[size + 4 : size + 8, :3] = by_turn
                jacobian[size + 4, 3:6] = by_shift @ pose[:3, :3]
        return float(at.depths.min()), residual, jacobian

    def _box(self, values: gtsam.Values, form: Form, residual: Array, jacobian: Array | None) -> None:
        box, kernel = self.box, self.outline
        if box is None or kernel is None:
            return
        extents, slope = projected_extents(kernel, values, box.softness, want_jacobian=jacobian is not None)
        white = box.residual(extents)
        residuals, by = white[:, None], None if slope is None else slope[:, None] / box.sigma
        if by is not None and form is Form.MAJORISED:  # a crease is as right or wrong as its edge, and no residual
            beyond = np.where(box.used, white * OUTWARD, 0.0) / box.sigma
            creases = crease_rows(kernel, values, box.softness, beyond)
            residuals, by = np.stack([white, np.zeros(4)], axis=1), np.concatenate([by, creases[:, None]], axis=1)
        right = np.where(box.used, self.edge_weights if form is Form.WEIGHTED else 1.0, 0.0)
        rows, by = robust_rows(form, right, np.full(4, box.wrong), residuals, by)
        residual[:4] = rows[:, 0]
        if jacobian is None or by is None:
            return
        own = by.shape[-1] - (kernel.focal_key is not None)  # offsets, which stand between, do not move the outline
        for row, put in ((0, by[:, 0]), *([(8, by[:, 1])] if form is Form.MAJORISED else [])):
            jacobian[row : row + 4, :own] = put[:, :own]
            if kernel.focal_key is not None:
                jacobian[row : row + 4, -1] = put[:, -1]

    def _estimate(self, robust: RobustLoss, residual: Array, jacobian: Array | None) -> None:
        """Make weighted rows of keypoints those of an m-estimator: of its loss, or re-weighted where it is linearised.

        GTSAM's robust noise models report the loss as the error as well, and linearise the weighted residual.
        """
        size = 2 * len(self.right)
        squares = np.square(residual[:size]).reshape(-1, 2).sum(axis=1)
        squares = np.divide(squares, self.right, out=np.zeros_like(squares), where=self.right > 0.0)
        if jacobian is not None:
            stretch = np.sqrt(robust.weights_of_squares(squares))
            jacobian[:size] *= np.repeat(stretch, 2)[:, None]
        else:
            safe = np.where(squares > 0.0, squares, 1.0)
            stretch = np.where(squares > 0.0, np.sqrt(2.0 * robust.losses_of_squares(squares) / safe), 1.0)
        residual[:size] *= np.repeat(stretch, 2)


def observation_factor(rows: ObservationRows) -> gtsam.CustomFactor:
    """The factor of an observation, on the pose, lambda and the offsets, as far as they are variables.

    Its unit noise is that of whitened rows.

    Raises:
        InvalidInputError: Pose and shape are both constants.
    """
    kernel = rows.kernel
    return guarded_factor(
        "observation",
        1.0,
        kernel.keys,
        kernel.dims,
        rows.rows,
        rows,
        allow_infinite=True,
        compiled=rows.compiled_rows,
    )


def term_factor(rows: ObservationRows, name: str) -> gtsam.CustomFactor:
    """The factor of one of the terms of an observation, on the variables that it depends on."""
    part, keys = rows.terms[name]
    dims = dict(zip(rows.kernel.keys, rows.kernel.dims, strict=True))
    starts = dict(zip(rows.kernel.keys, accumulate(rows.kernel.dims, initial=0), strict=False))
    columns = np.concatenate([np.arange(starts[key], starts[key] + dims[key]) for key in keys])

    def callback(values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        residual, jacobian = rows(values, want_jacobian)
        return residual[part], None if jacobian is None else jacobian[part][:, columns]

    own = [dims[key] for key in keys]
    return guarded_factor(name, 1.0, keys, own, part.stop - part.start, callback, allow_infinite=True)


def reprojection_factor(
    kernel: ProjectionKernel,
    pixels: ArrayLike,
    weights: ArrayLike,
    covariances: ArrayLike,
    robust: RobustLoss | None = None,
) -> gtsam.CustomFactor:
    """Reprojection errors of all keypoints in one factor, each with its own weight; see `ObservationRows`.

    Args:
        kernel: Projects all keypoints.
        pixels: (K, 2) where they were measured; NaN rows for those that were not.
        weights: (K,) weights w_i >= 0; keypoints of weight zero are left out.
        covariances: (K, 2, 2) covariance Sigma_i of each keypoint of weight 1, pixels^2.
        robust: Robust loss around every keypoint, or None.

    Raises:
        InvalidInputError: An array has the wrong shape, a weight is negative, or a covariance is not symmetric positive
            definite.
        DegenerateProblemError: No keypoint remains.
    """
    size = kernel.shape.size
    array, given = np.asarray(pixels, dtype=np.float64), finite_array("weights", weights, (size,))
    if array.shape != (size, 2) or len(np.asarray(covariances)) != size:
        raise InvalidInputError("pixels", f"shape {array.shape}", f"Give {size} pixels and covariances.")
    if given.min() < 0.0:
        raise InvalidInputError("weights", float(given.min()), "Give weights >= 0.")
    used = ~np.isnan(array).any(axis=1) & (given >= SMALLEST_WEIGHT)
    if not used.any():
        raise DegenerateProblemError("weights", "no keypoint with a pixel and a weight", "Give some weight.")
    measured = finite_array("pixels", np.where(used[:, None], array, 0.0), (None, 2))
    rows = ObservationRows(kernel, KeypointRows(measured, whiteners(covariances)), form=Form.WEIGHTED, robust=robust)
    rows.right = np.where(used, given, 0.0)
    return term_factor(rows, "reprojection")


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
