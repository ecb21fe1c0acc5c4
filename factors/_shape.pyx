# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""The terms about a vehicle's shape alone, compiled: the rows of symmetry, rectangularity and dimensions.

The equations are those of `factors.symmetry`, `factors.rectangularity` and `factors.dimensions`.
"""

from libc.math cimport sqrt
from libc.string cimport memcpy

import numpy as np

from factors.rectangularity import SHORTEST_DIAGONAL

cdef double SHORTEST = SHORTEST_DIAGONAL


cdef class Shape:
    """The terms about a vehicle's shape alone: mirrored pairs, rectangles, dimensions.

    Rows: three for each pair, one for each keypoint in the middle, four for each rectangle, three for the dimensions.
    """

    cdef readonly int keypoints, coefficients, rows
    cdef const double[:, ::1] mean, basis, operator
    cdef const int[:, ::1] pairs, quads
    cdef const int[::1] middle
    cdef const double[::1] size, size_sigma
    cdef double pair_sigma, quad_sigma

    def __reduce__(self):
        """Pointers into arrays are not copied.

        Raises:
            TypeError: Always; who holds it makes another.
        """
        raise TypeError("a compiled Shape cannot be copied or pickled")

    def __init__(self, mean, basis, pairs, middle, double pair_sigma, quads, double quad_sigma, operator, size, sigma):
        """Bind the arrays.

        Args:
            mean: (K, 3). basis: (N, 3K). pairs: (P, 2) left and right. middle: (Q,). pair_sigma: Metres.
            quads: (F, 4) around the face. quad_sigma: Metres.
            operator: (3 or 0, 3K) from keypoints to dimensions. size, sigma: (3,), metres.
        """
        self.mean, self.basis, self.pairs, self.middle, self.quads = mean, basis, pairs, middle, quads
        self.operator, self.size, self.size_sigma = operator, size, sigma
        self.pair_sigma, self.quad_sigma = pair_sigma, quad_sigma
        self.keypoints, self.coefficients = len(mean), len(basis)
        self.rows = 3 * len(pairs) + len(middle) + 4 * len(quads) + len(operator)
        indices = np.concatenate([np.ravel(pairs), np.ravel(middle), np.ravel(quads)])
        sizes = [self.mean.shape[1] == 3, self.basis.shape[1] == 3 * self.keypoints, self.pairs.shape[1] == 2,
                 self.quads.shape[1] == 4, self.operator.shape[1] == 3 * self.keypoints,
                 self.size.shape[0] == len(operator), self.size_sigma.shape[0] == len(operator),
                 not len(indices) or (indices.min() >= 0 and indices.max() < self.keypoints)]
        if not all(sizes):
            raise ValueError(f"arrays that do not belong together: {sizes}")

    def rows_at(
        self, const double[::1] x, const double[::1] offsets, const double[::1] plane, const double[:, :] tangent,
        double[::1] residual, double[:, ::1] jacobian
    ):
        """Fill whitened residual (rows,) and, where it is given, the Jacobian (rows, N + 3K + 3).

        Args:
            x: (N,). offsets: (3K,) or None.
            plane: (4,) normal and distance of the medial plane.
            tangent: (3, 2) basis of its local coordinates.
            residual: To fill.
            jacobian: None, or to fill: columns coefficients, offsets, the plane's local coordinates.
        """
        cdef int K = self.keypoints, N = self.coefficients, width = 3 * K + 3, a, b, i, k, n, row = 0
        cdef int left, right
        cdef double[::1] X = np.empty(3 * K)
        cdef double[:, ::1] by_point = np.zeros((self.rows if jacobian is not None else 0, width))
        cdef double s, first, second, slide
        cdef double d[3]
        cdef double e[3]
        cdef double *J
        if x.shape[0] != N or residual.shape[0] != self.rows or plane.shape[0] != 4:
            raise ValueError("arrays of another number of keypoints or coefficients")
        if tangent.shape[0] != 3 or tangent.shape[1] != 2:
            raise ValueError("a tangent basis (3, 2) is expected")
        if offsets is not None and offsets.shape[0] != 3 * K:
            raise ValueError("offsets (3K,) are expected")
        if jacobian is not None and (jacobian.shape[0] != self.rows or jacobian.shape[1] != N + width):
            raise ValueError("a Jacobian (rows, N + 3K + 3) is expected")
        cdef bint want = jacobian is not None
        with nogil:
            memcpy(&X[0], &self.mean[0, 0], 3 * K * sizeof(double))
            for i in range(3 * K):
                if offsets is not None:
                    X[i] += offsets[i]
                for n in range(N):
                    X[i] += x[n] * self.basis[n, i]
            for k in range(self.pairs.shape[0]):
                left, right = self.pairs[k, 0], self.pairs[k, 1]
                s = plane[3]
                for a in range(3):
                    s += plane[a] * X[3 * right + a]
                for a in range(3):
                    residual[row + a] = X[3 * right + a] - 2.0 * s * plane[a] - X[3 * left + a]
                    if want:
                        J = &by_point[row + a, 0]
                        J[3 * left + a] = -1.0
                        J[3 * right + a] = 1.0
                        for b in range(3):
                            J[3 * right + b] -= 2.0 * plane[a] * plane[b]
                        for b in range(2):
                            slide = X[3 * right] * tangent[0, b] + X[3 * right + 1] * tangent[1, b]
                            slide += X[3 * right + 2] * tangent[2, b]
                            J[3 * K + b] = -2.0 * (plane[a] * slide + s * tangent[a, b])
                        J[3 * K + 2] = -2.0 * plane[a]
                row += 3
            for k in range(self.middle.shape[0]):
                right = self.middle[k]
                residual[row] = plane[3]
                for a in range(3):
                    residual[row] += plane[a] * X[3 * right + a]
                    if want:
                        by_point[row, 3 * right + a] = plane[a]
                        for b in range(2):
                            by_point[row, 3 * K + b] += X[3 * right + a] * tangent[a, b]
                if want:
                    by_point[row, 3 * K + 2] = 1.0
                row += 1
            scale(residual, by_point, 0, row, self.pair_sigma, want)
            for k in range(self.quads.shape[0]):
                first = second = 0.0
                for a in range(3):
                    residual[row + a] = (
                        X[3 * self.quads[k, 0] + a] - X[3 * self.quads[k, 1] + a]
                        + X[3 * self.quads[k, 2] + a] - X[3 * self.quads[k, 3] + a]
                    )
                    d[a] = X[3 * self.quads[k, 0] + a] - X[3 * self.quads[k, 2] + a]
                    e[a] = X[3 * self.quads[k, 1] + a] - X[3 * self.quads[k, 3] + a]
                    first += d[a] * d[a]
                    second += e[a] * e[a]
                    if want:
                        for b in range(4):
                            by_point[row + a, 3 * self.quads[k, b] + a] = -1.0 if b % 2 else 1.0
                first, second = sqrt(first), sqrt(second)
                first = first if first > SHORTEST else SHORTEST
                second = second if second > SHORTEST else SHORTEST
                residual[row + 3] = first - second
                if want:
                    J = &by_point[row + 3, 0]
                    for a in range(3):
                        J[3 * self.quads[k, 0] + a] = d[a] / first
                        J[3 * self.quads[k, 2] + a] = -d[a] / first
                        J[3 * self.quads[k, 1] + a] = -e[a] / second
                        J[3 * self.quads[k, 3] + a] = e[a] / second
                scale(residual, by_point, row, row + 4, self.quad_sigma, want)
                row += 4
            for k in range(self.operator.shape[0]):
                residual[row] = -self.size[k]
                for i in range(3 * K):
                    residual[row] += self.operator[k, i] * X[i]
                    if want:
                        by_point[row, i] = self.operator[k, i]
                scale(residual, by_point, row, row + 1, self.size_sigma[k], want)
                row += 1
            if want:
                for row in range(self.rows):
                    memcpy(&jacobian[row, N], &by_point[row, 0], width * sizeof(double))
                    for n in range(N):
                        jacobian[row, n] = 0.0
                    for i in range(3 * K):
                        s = by_point[row, i]
                        if s != 0.0:
                            for n in range(N):
                                jacobian[row, n] += s * self.basis[n, i]


cdef void scale(double[::1] r, double[:, ::1] J, int start, int end, double sigma, bint want) noexcept nogil:
    """Whiten rows."""
    cdef int row, i
    for row in range(start, end):
        r[row] /= sigma
        if want:
            for i in range(J.shape[1]):
                J[row, i] /= sigma
