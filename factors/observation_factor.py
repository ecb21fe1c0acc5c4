"""Everything that an image says of a vehicle in one factor: keypoints, box, ground and the barrier at the camera.

The same terms as `stacked_reprojection_factor`, `box_factor`, `ground_height_factor`, `upright_factor` and
`cheirality_factor`, at the price of one callback; and keypoints and edges that may be wrong are so inside it
(`factors.mixture`), so that one minimisation finds the minimum of the robust energy, where re-weighting needs many.
The rows come from the compiled kernel where it is there, else from numpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.box import OUTWARD, crease_rows, projected_extents
from factors.ground import ground_rows
from factors.guard import Evaluation, guarded_factor
from factors.kernel import ProjectionKernel
from factors.mixture import Form, robust_rows
from factors.projection import SHALLOWEST

__all__ = ["BoxRows", "GroundRows", "ObservationRows", "observation_factor"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoxRows:
    """The box's edges.

    Attributes:
        kernel: Projects the points whose extents the box encloses; of the same pose and lambda.
        edges: (4,) x1, y1, x2, y2.
        used: (4,) which edges count.
        sigma: Standard deviation of an edge, pixels.
        wrong: Density of a wrong edge relative to a right one's peak, times the odds of being wrong.
        softness: Pixels over which one outermost point hands over to the next.
    """

    kernel: ProjectionKernel
    edges: Array
    used: NDArray[np.bool_]
    sigma: float
    wrong: float
    softness: float


@dataclass(frozen=True)
class GroundRows:
    """The ground plane: unit normal (3,), distance of the camera in metres, standard deviation of the lean, radians."""

    normal: Array
    distance: float
    tilt_sigma: float


@dataclass(eq=False)
class ObservationRows:
    """The callback of an observation factor; what changes between solves is set on it.

    Attributes:
        kernel: Projects the keypoints.
        pixels: (K, 2) where they were seen; any finite number where they were not.
        whitener: (K, 3) entries a, b, c of lower triangular whiteners [[a, 0], [b, c]].
        box: The box, or None.
        ground: The ground, or None.
        compiled: The same as `factors._observation.Observation`, or None; it knows one focal length.
        share: Factor on the energy of all rows.
        form: How the mixtures are handed to the solver.
        right: (K,) densities of right points, or their weights (`Form.WEIGHTED`); 0 for points that were not seen.
        wrong: (K,) densities of wrong points.
        edge_weights: (4,) weights of the edges, for `Form.WEIGHTED`.
        height_sigma: Standard deviation of the origin's height over the ground, metres.
    """

    kernel: ProjectionKernel
    pixels: Array
    whitener: Array
    box: BoxRows | None = None
    ground: GroundRows | None = None
    compiled: Any = None
    share: float = 1.0
    form: Form = Form.NEWTON
    right: Array = None  # type: ignore[assignment]  # set before the first evaluation
    wrong: Array = None  # type: ignore[assignment]
    edge_weights: Array = None  # type: ignore[assignment]
    height_sigma: float = 1.0

    def __post_init__(self) -> None:
        """Prepare what does not change."""
        size = len(self.pixels)
        self.right, self.wrong, self.edge_weights = np.zeros(size), np.ones(size), np.ones(4)
        shape = self.kernel.shape
        count, width = len(shape.basis), 6 + len(shape.basis) + 3 * size
        wanted = np.zeros(width, dtype=bool)
        wanted[:6] = self.kernel.pose_key is not None
        wanted[6 : 6 + count] = shape.coefficients_key is not None
        wanted[6 + count :] = shape.offsets_key is not None
        self._width, self._columns = width, None if wanted.all() else np.flatnonzero(wanted)

    @property
    def rows(self) -> int:
        """Number of rows: two for each keypoint, four for the box, four for the ground, four for the box's creases."""
        return 2 * len(self.pixels) + 12

    def __call__(self, values: gtsam.Values, want_jacobian: bool) -> Evaluation:
        """The rows at the values; an infinite residual where a keypoint is behind the camera, or infinitely far."""
        form = self.form if want_jacobian or self.form is Form.WEIGHTED else Form.LOSS
        evaluate = self._by_numpy if self.compiled is None else self._by_kernel
        nearest, residual, jacobian = evaluate(values, form, want_jacobian)
        if not SHALLOWEST < nearest < np.inf:
            return np.full(self.rows, np.inf), None if jacobian is None else np.zeros_like(jacobian)
        if self.share != 1.0:
            residual *= self.share**0.5
            if jacobian is not None:
                jacobian *= self.share**0.5
        return residual, jacobian

    def _by_kernel(self, values: gtsam.Values, form: Form, want: bool) -> tuple[float, Array, Array | None]:
        shape, pose = self.kernel.shape, self.kernel.pose(values)
        residual = np.empty(self.rows)
        jacobian = np.empty((self.rows, self._width)) if want else None
        nearest = self.compiled.rows_at(
            pose,
            shape.coefficients(values),
            shape.offsets(values),
            self.right,
            self.wrong,
            self.edge_weights,
            self.height_sigma,
            int(form),
            residual,
            jacobian,
        )
        if self.ground is None:  # or a constant: nothing is said of it at a fixed pose
            residual[-8:-4] = 0.0
        if jacobian is not None and self._columns is not None:
            jacobian = jacobian[:, self._columns]
        return nearest, residual, jacobian

    @np.errstate(invalid="ignore")  # infinitely far there is no direction
    def _by_numpy(self, values: gtsam.Values, form: Form, want: bool) -> tuple[float, Array, Array | None]:
        at = self.kernel.evaluate(values, want)
        size, columns = len(self.pixels), sum(self.kernel.dims)
        a, b, c = self.whitener.T
        away = at.pixels - self.pixels
        white = np.stack([a * away[:, 0], b * away[:, 0] + c * away[:, 1]], axis=1)
        by = at.jacobian if want else None
        if by is not None:
            u, v = by[:, 0], by[:, 1]
            by = np.stack([a[:, None] * u, b[:, None] * u + c[:, None] * v], axis=1)
        residual = np.zeros(self.rows)
        jacobian = np.zeros((self.rows, columns)) if want else None
        rows, by = robust_rows(form, self.right, self.wrong, white, by)
        residual[: 2 * size] = rows.ravel()
        if jacobian is not None and by is not None:
            jacobian[: 2 * size] = by.reshape(2 * size, columns)
        self._box(values, form, residual[2 * size :], None if jacobian is None else jacobian[2 * size :])
        ground = slice(2 * size + 4, 2 * size + 8)
        self._ground(values, residual[ground], None if jacobian is None else jacobian[ground])
        return float(at.depths.min()), residual, jacobian

    def _box(self, values: gtsam.Values, form: Form, residual: Array, jacobian: Array | None) -> None:
        box = self.box
        if box is None:
            return
        extents, slope = projected_extents(box.kernel, values, box.softness, want_jacobian=jacobian is not None)
        white = (extents - box.edges) / box.sigma
        residuals, by = white[:, None], None if slope is None else slope[:, None] / box.sigma
        if by is not None and form is Form.MAJORISED:  # a crease is as right or wrong as its edge, and no residual
            beyond = np.where(box.used, white * OUTWARD, 0.0) / box.sigma
            creases = crease_rows(box.kernel, values, box.softness, beyond)
            residuals, by = np.stack([white, np.zeros(4)], axis=1), np.concatenate([by, creases[:, None]], axis=1)
        right = np.where(box.used, self.edge_weights if form is Form.WEIGHTED else 1.0, 0.0)
        rows, by = robust_rows(form, right, np.full(4, box.wrong), residuals, by)
        residual[:4] = rows[:, 0]
        if jacobian is None or by is None:
            return
        _put(jacobian[:4], by[:, 0], box.kernel)
        if form is Form.MAJORISED:
            _put(jacobian[8:12], by[:, 1], box.kernel)

    def _ground(self, values: gtsam.Values, residual: Array, jacobian: Array | None) -> None:
        ground = self.ground
        if ground is None:
            return
        pose = self.kernel.pose(values)
        rows, by_turn = ground_rows(ground.normal, ground.distance, pose[:3, :3], pose[:3, 3])
        scale = 1.0 / np.array([self.height_sigma, *[ground.tilt_sigma] * 3])
        residual[:] = rows * scale
        if jacobian is not None and self.kernel.pose_key is not None:
            jacobian[:, :3] = by_turn * scale[:, None]
            jacobian[0, 3:6] = (ground.normal @ pose[:3, :3]) * scale[0]


def _put(jacobian: Array, by: Array, kernel: ProjectionKernel) -> None:
    """Derivatives by the outline's variables as those by the keypoints', whose offsets do not move the outline."""
    own = by.shape[-1] - (kernel.focal_key is not None)
    jacobian[:, :own] = by[:, :own]
    if kernel.focal_key is not None:
        jacobian[:, -1] = by[:, -1]


def observation_factor(rows: ObservationRows) -> gtsam.CustomFactor:
    """The factor of an observation, on the pose, lambda and the offsets, as far as they are variables.

    Its unit noise is that of whitened rows. The rows that do not apply are zero.

    Raises:
        InvalidInputError: Pose and shape are both constants.
    """
    kernel = rows.kernel
    return guarded_factor("observation", 1.0, kernel.keys, kernel.dims, rows.rows, rows, allow_infinite=True)
