# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""The terms about a vehicle's shape alone, compiled: the rows of symmetry, rectangularity and dimensions.

The equations are those of `factors.symmetry`, `factors.rectangularity` and `factors.dimensions`.
"""

from libc.math cimport NAN, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from factors._rows cimport Source
from factors.rectangularity import SHORTEST_DIAGONAL

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef double SHORTEST = SHORTEST_DIAGONAL


cdef class Shape(Source):
    """The terms about a vehicle's shape alone: mirrored pairs, rectangles, dimensions; of x, offsets and medial plane.

    Rows, whitened: three for each pair, one for each keypoint in the middle, four for each rectangle, three for the
    dimensions.
    """

    cdef readonly int keypoints, coefficients
    cdef double[::1] points
    cdef double[:, ::1] by_point
    cdef const double[:, ::1] mean, basis, operator
    cdef const int[:, ::1] pairs, quads
    cdef const int[::1] middle
    cdef const double[::1] size, size_sigma
    cdef double pair_sigma, quad_sigma

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
        self.take([(self.coefficients, self.coefficients, True), (3 * self.keypoints, 3 * self.keypoints, False),
                   (10, 3, True)])
        self.points, self.by_point = np.empty(3 * self.keypoints), np.empty((self.rows, 3 * self.keypoints + 3))
        indices = np.concatenate([np.ravel(pairs), np.ravel(middle), np.ravel(quads)])
        sizes = [self.mean.shape[1] == 3, self.basis.shape[1] == 3 * self.keypoints, self.pairs.shape[1] == 2,
                 self.quads.shape[1] == 4, self.operator.shape[1] == 3 * self.keypoints,
                 self.size.shape[0] == len(operator), self.size_sigma.shape[0] == len(operator),
                 not len(indices) or (indices.min() >= 0 and indices.max() < self.keypoints)]
        if not all(sizes):
            raise ValueError(f"arrays that do not belong together: {sizes}")

    cdef double fill(self, const double **at, double *residual, double *jacobian) noexcept nogil:
        cdef int K = self.keypoints, N = self.coefficients, width = 3 * K + 3, a, b, i, k, n, row = 0
        cdef int left, right
        cdef const double *x = at[0]
        cdef const double *offsets = at[1]
        cdef const double *plane = at[2]
        cdef const double *tangent = at[2] + 4
        cdef double *X = &self.points[0]
        cdef double s, first, second, slide
        cdef double d[3]
        cdef double e[3]
        cdef double *J
        cdef bint want = jacobian != NULL
        memcpy(X, &self.mean[0, 0], 3 * K * sizeof(double))
        if want:
            memset(&self.by_point[0, 0], 0, self.rows * width * sizeof(double))
        for i in range(3 * K):
            if offsets != NULL:
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
                    J = &self.by_point[row + a, 0]
                    J[3 * left + a] = -1.0
                    J[3 * right + a] = 1.0
                    for b in range(3):
                        J[3 * right + b] -= 2.0 * plane[a] * plane[b]
                    for b in range(2):
                        slide = X[3 * right] * tangent[b] + X[3 * right + 1] * tangent[2 + b]
                        slide += X[3 * right + 2] * tangent[4 + b]
                        J[3 * K + b] = -2.0 * (plane[a] * slide + s * tangent[2 * a + b])
                    J[3 * K + 2] = -2.0 * plane[a]
            row += 3
        for k in range(self.middle.shape[0]):
            right = self.middle[k]
            residual[row] = plane[3]
            for a in range(3):
                residual[row] += plane[a] * X[3 * right + a]
                if want:
                    self.by_point[row, 3 * right + a] = plane[a]
                    for b in range(2):
                        self.by_point[row, 3 * K + b] += X[3 * right + a] * tangent[2 * a + b]
            if want:
                self.by_point[row, 3 * K + 2] = 1.0
            row += 1
        scale(residual, self.by_point, 0, row, self.pair_sigma, want)
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
                        self.by_point[row + a, 3 * self.quads[k, b] + a] = -1.0 if b % 2 else 1.0
            first, second = sqrt(first), sqrt(second)
            first = first if first > SHORTEST else SHORTEST
            second = second if second > SHORTEST else SHORTEST
            residual[row + 3] = first - second
            if want:
                J = &self.by_point[row + 3, 0]
                for a in range(3):
                    J[3 * self.quads[k, 0] + a] = d[a] / first
                    J[3 * self.quads[k, 2] + a] = -d[a] / first
                    J[3 * self.quads[k, 1] + a] = -e[a] / second
                    J[3 * self.quads[k, 3] + a] = e[a] / second
            scale(residual, self.by_point, row, row + 4, self.quad_sigma, want)
            row += 4
        for k in range(self.operator.shape[0]):
            residual[row] = -self.size[k]
            for i in range(3 * K):
                residual[row] += self.operator[k, i] * X[i]
                if want:
                    self.by_point[row, i] = self.operator[k, i]
            scale(residual, self.by_point, row, row + 1, self.size_sigma[k], want)
            row += 1
        if want:
            for row in range(self.rows):
                memcpy(jacobian + row * self.columns + N, &self.by_point[row, 0], width * sizeof(double))
                for i in range(3 * K):
                    s = self.by_point[row, i]
                    if s != 0.0:
                        for n in range(N):
                            jacobian[row * self.columns + n] += s * self.basis[n, i]

        return NAN

cdef void scale(double *r, double[:, ::1] J, int start, int end, double sigma, bint want) noexcept nogil:
    """Whiten rows."""
    cdef int row, i
    for row in range(start, end):
        r[row] /= sigma
        if want:
            for i in range(J.shape[1]):
                J[row, i] /= sigma
