"""The shape of a vehicle as a function of the graph's variables.

    X(lambda, offsets) = mean + sum_j lambda_j basis_j + offsets        (the paper's model of X_i, section III-C)

Every shape term and the projection read the keypoints from one `LinearShape`, which evaluates them once per
linearisation point.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.checks import finite_array
from factors.errors import InvalidInputError


class LinearShape:
    """Keypoints X (K, 3) of the object frame, in metres, linear in lambda and in the free offsets.

    Each of the two is a variable of the graph (given by its key) or a constant (given by its value). The last
    evaluation is kept and found again by the bytes of the values, so that it cannot be stale; it may be shared by any
    number of factors, frames and projections.

    Attributes:
        mean: (K, 3) mean keypoints.
        basis: (N, K, 3) basis, scaled so that lambda ~ N(0, I).
        coefficients_key: Key of lambda, or None where it is a constant.
        offsets_key: Key of the offsets, or None where they are a constant.
        keys: Those of the two keys that are there, in this order.
        dims: Their dimensions N and 3K.
        derivative: (K, 3, D) constant derivative of X with respect to all variables, D = sum(dims).
    """

    def __init__(
        self,
        mean: ArrayLike,
        basis: ArrayLike,
        coefficients: int | ArrayLike,
        offsets: int | ArrayLike | None = None,
    ) -> None:
        """Bind a linear shape to variables or constants.

        Args:
            mean: (K, 3) mean keypoints.
            basis: (N, K, 3) basis; N may be 0 where the coefficients are a constant.
            coefficients: Key of lambda, or its fixed value (N,).
            offsets: Key of the offsets (one vector of 3K numbers), their fixed value (K, 3), or None for none.

        Raises:
            InvalidInputError: An array has the wrong shape or is not finite, or a key is given for an empty basis.
        """
        self.mean = finite_array("mean", mean, (None, 3))
        size = len(self.mean)
        self.basis = finite_array("basis", basis, (None, size, 3))
        count = len(self.basis)
        if not size:
            raise InvalidInputError("mean", "no keypoints", "Give at least one keypoint.")
        flat_basis = np.ascontiguousarray(self.basis.reshape(count, 3 * size).T)
        constant = self.mean.ravel().copy()
        blocks: dict[int, NDArray[np.float64]] = {}
        self.coefficients_key: int | None = None
        self.offsets_key: int | None = None
        self._coefficients: NDArray[np.float64] = np.zeros(count)
        self._offsets: NDArray[np.float64] | None = None
        if isinstance(coefficients, int):
            if not count:
                raise InvalidInputError("coefficients", "a key", "Give the value (0,) where the basis is empty.")
            self.coefficients_key = coefficients
            blocks[coefficients] = flat_basis
        else:
            self._coefficients = finite_array("coefficients", coefficients, (count,))
            constant += flat_basis @ self._coefficients
        if isinstance(offsets, int):
            self.offsets_key = offsets
            blocks[offsets] = np.eye(3 * size)
        elif offsets is not None:
            self._offsets = np.ascontiguousarray(finite_array("offsets", offsets, (size, 3))).ravel()
            constant += self._offsets
        self.keys: tuple[int, ...] = tuple(blocks)
        self.dims: tuple[int, ...] = tuple(block.shape[1] for block in blocks.values())
        derivative = np.hstack([*blocks.values(), np.zeros((3 * size, 0))])
        self.derivative: NDArray[np.float64] = derivative.reshape(size, 3, sum(self.dims))
        self.derivative.flags.writeable = False
        self._constant = constant
        self._linear = flat_basis
        # What was evaluated last: one tuple, so that another thread sees points with the stamp that they are of.
        self._last: tuple[bytes | None, NDArray[np.float64]] = None, _frozen(constant)

    @property
    def size(self) -> int:
        """Number of keypoints K."""
        return len(self.mean)

    @property
    def bound(self) -> tuple[int | NDArray[np.float64], int | NDArray[np.float64] | None]:
        """Lambda and the offsets: each by its key, or its value where it is a constant; None for no offsets."""
        coefficients = self._coefficients if self.coefficients_key is None else self.coefficients_key
        return coefficients, self._offsets if self.offsets_key is None else self.offsets_key

    def coefficients(self, values: gtsam.Values) -> NDArray[np.float64]:
        """(N,) lambda at the values."""
        if self.coefficients_key is None:
            return self._coefficients
        return values.atVector(self.coefficients_key)

    def offsets(self, values: gtsam.Values) -> NDArray[np.float64] | None:
        """(3K,) offsets at the values; None where there are none."""
        if self.offsets_key is None:
            return self._offsets
        return values.atVector(self.offsets_key)

    def chain(self, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows, D) derivative of a residual whose derivative with respect to X, flattened to (rows, 3K), is given."""
        if self.offsets_key is None:
            return gradient @ self._linear
        return gradient if self.coefficients_key is None else np.hstack([gradient @ self._linear, gradient])

    def points(self, values: gtsam.Values) -> NDArray[np.float64]:
        """(K, 3) keypoints at the values, read-only.

        The same array object is returned as long as lambda and the offsets have not changed, so that ``is`` tells
        whether what depends on it is still valid.
        """
        last, points = self._last
        if not self.keys:
            return points
        vectors = [values.atVector(key) for key in self.keys]
        stamp = b"".join(vector.tobytes() for vector in vectors)
        if stamp == last:
            return points
        flat = self._constant
        if self.coefficients_key is not None:
            flat = flat + self._linear @ vectors[0]
        if self.offsets_key is not None:
            flat = flat + vectors[-1]
        points = _frozen(flat)
        self._last = stamp, points
        return points


def _frozen(flat: NDArray[np.float64]) -> NDArray[np.float64]:
    points = flat.reshape(-1, 3)
    points.flags.writeable = False
    return points
