# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""The iterations of `fgrecon.video.egomotion._Problem.solve`, compiled; that has a numpy version, and says what is what."""

from libc.math cimport cos, fabs, fmax, sin, sqrt

import numpy as np

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`


cdef bint solved(double *A, double *x) noexcept nogil:
    """x = A^-1 x (9,) by elimination with pivots; A is lost. False where it is singular."""
    cdef int i, j, k, best
    cdef double factor, swap
    for k in range(9):
        best = k
        for i in range(k + 1, 9):
            if fabs(A[9 * i + k]) > fabs(A[9 * best + k]):
                best = i
        if A[9 * best + k] == 0.0:
            return False
        if best != k:
            for j in range(9):
                swap = A[9 * k + j]
                A[9 * k + j] = A[9 * best + j]
                A[9 * best + j] = swap
            swap = x[k]
            x[k] = x[best]
            x[best] = swap
        for i in range(k + 1, 9):
            factor = A[9 * i + k] / A[9 * k + k]
            for j in range(k + 1, 9):
                A[9 * i + j] -= factor * A[9 * k + j]
            x[i] -= factor * x[k]
    for k in range(8, -1, -1):
        for j in range(k + 1, 9):
            x[k] -= A[9 * k + j] * x[j]
        x[k] /= A[9 * k + k]
    return True


cdef void turned(const double *w, double *turn, double *shift) noexcept nogil:
    """Turn and shift, turned by a rotation vector."""
    cdef double angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    cdef double a = 1.0 - angle * angle / 6.0, b = 0.5 - angle * angle / 24.0
    cdef double R[9]
    cdef double moved[12]
    cdef int i, j, k
    if angle > 1e-4:
        a, b = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    for i in range(3):
        for j in range(3):
            R[3 * i + j] = b * w[i] * w[j] + (1.0 - b * angle * angle if i == j else 0.0)
    R[1] -= a * w[2]
    R[2] += a * w[1]
    R[3] += a * w[2]
    R[5] -= a * w[0]
    R[6] -= a * w[1]
    R[7] += a * w[0]
    for i in range(3):
        for j in range(4):
            moved[4 * i + j] = 0.0
            for k in range(3):
                moved[4 * i + j] += R[3 * i + k] * (turn[3 * k + j] if j < 3 else shift[k])
    for i in range(3):
        for j in range(3):
            turn[3 * i + j] = moved[4 * i + j]
        shift[i] = moved[4 * i + 3]


cdef class Points:
    """Points as rays, and which may be the road's: the fields of `_Problem`, and what `EgomotionSettings` says of them."""

    cdef const double[:, ::1] before, after, slopes
    cdef const double[::1] known, spread, prior
    cdef const unsigned char[::1] road
    cdef double sigma, inlier, elsewhere

    def __init__(self, problem, settings):
        self.before, self.after = (np.ascontiguousarray(each) for each in (problem.before, problem.after))
        self.slopes, self.known = np.ascontiguousarray(problem.slopes), problem.depth
        self.spread, self.prior = problem.spread, problem.prior
        self.road = problem.road.view(np.uint8)
        self.sigma, self.inlier = problem.sigma, settings.inlier_sigmas
        self.elsewhere = settings.other_inverse_depth_sigma_per_m

    def iterate(
        self,
        double[:, ::1] turn,
        double[::1] shift,
        double[::1] plane,
        double[::1] depth,
        double[::1] trust,
        double[::1] weight,
        double[:, ::1] hessian,
        double standing,
        int most,
        int least,
        double small,
    ):
        """Change what is given up to the end; False where it leads nowhere.

        The Hessian gets the standing camera's information, and there are more than `least` iterations, until a step
        is below `small`.
        """
        cdef int i, iteration, behind, count = self.before.shape[0]
        cdef bint leads = True
        cdef double largest
        cdef double gradient[9]
        cdef double matrix[81]
        cdef double[:, ::1] rows = np.empty((count, 11))  # motion and ground beside the depth, its square, its missing
        with nogil:
            for iteration in range(most):
                behind = self.linearise(turn, shift, plane, depth, trust, weight, hessian, gradient, rows)
                leads = behind <= 0.2 * count
                if not leads:
                    break
                for i in range(3):
                    hessian[6 + i, 6 + i] += self.prior[i]
                    gradient[6 + i] -= self.prior[i] * plane[i]
                    hessian[3 + i, 3 + i] += standing
                for i in range(81):
                    matrix[i] = hessian[i // 9, i % 9] + (1e-9 if i % 10 == 0 else 0.0)
                leads = solved(matrix, gradient)
                if not leads:
                    break
                self.advance(gradient, rows, turn, shift, plane, depth, trust)
                largest = 0.0
                for i in range(6):
                    largest = fmax(largest, fabs(gradient[i]))
                if iteration > least and largest < small:
                    break
        return leads

    cdef int linearise(
        self, double[:, ::1] turn, double[::1] shift, double[::1] plane, double[::1] depth, double[::1] trust,
        double[::1] weight, double[:, ::1] hessian, double *gradient, double[:, ::1] rows,
    ) noexcept nogil:
        """Hessian and gradient, depths eliminated; how many points are behind the camera."""
        cdef int p, i, j, behind = 0
        cdef double x, y, z, inverse, u, v, root, far, cross, tight, known, du, dv, short, square, along, d
        cdef double U[9]
        cdef double V[9]
        cdef double G[9]
        cdef double C[9]
        hessian[:, :] = 0.0
        for i in range(9):
            gradient[i] = U[i] = V[i] = G[i] = 0.0
        for p in range(self.before.shape[0]):
            d = depth[p]
            x = d * shift[0]
            y = d * shift[1]
            z = d * shift[2]
            for i in range(3):
                x += turn[0, i] * self.before[p, i]
                y += turn[1, i] * self.before[p, i]
                z += turn[2, i] * self.before[p, i]
            if z < 0.05:
                behind += 1
                z = 0.05
            inverse = 1.0 / z
            x *= inverse
            y *= inverse
            u = (self.after[p, 0] - x) / self.sigma
            v = (self.after[p, 1] - y) / self.sigma
            weight[p] = 1.0 / (1.0 + (u * u + v * v) / (self.inlier * self.inlier))
            root = sqrt(weight[p]) / self.sigma
            far = root * inverse
            cross = root * x * y
            tight = 1.0
            if self.road[p]:
                tight = sqrt(fmax(trust[p], (self.spread[p] / self.elsewhere) ** 2))
            known = tight / (self.spread[p] if trust[p] > 0.0 else self.elsewhere)
            U[0], V[0] = -cross, -root * (1.0 + y * y)
            U[1], V[1] = root * (1.0 + x * x), cross
            U[2], V[2] = -root * y, root * x
            U[3], V[4] = d * far, d * far
            U[5], V[5] = -x * d * far, -y * d * far
            short = self.known[p] - d
            for i in range(3):
                short += self.slopes[p, i] * plane[i]
                G[6 + i] = -known * self.slopes[p, i]
            short *= known
            du = far * (shift[0] - x * shift[2])
            dv = far * (shift[1] - y * shift[2])
            u *= root * self.sigma
            v *= root * self.sigma
            square = du * du + dv * dv + known * known
            along = du * u + dv * v + known * short
            for i in range(9):
                C[i] = U[i] * du + V[i] * dv + G[i] * known
                rows[p, i] = C[i]
                gradient[i] += U[i] * u + V[i] * v + G[i] * short - C[i] * along / square
            rows[p, 9] = square
            rows[p, 10] = along
            for i in range(9):
                for j in range(i + 1):
                    hessian[i, j] += U[i] * U[j] + V[i] * V[j] + G[i] * G[j] - C[i] * C[j] / square
        for i in range(9):
            for j in range(i):
                hessian[j, i] = hessian[i, j]
        return behind

    cdef void advance(
        self, const double *step, double[:, ::1] rows, double[:, ::1] turn, double[::1] shift, double[::1] plane,
        double[::1] depth, double[::1] trust,
    ) noexcept nogil:
        """Take a step."""
        cdef int p, i
        cdef double change, off, share
        for i in range(3):
            plane[i] += step[6 + i]
        turned(step, &turn[0, 0], &shift[0])
        for i in range(3):
            shift[i] += step[3 + i]
        for p in range(self.before.shape[0]):
            change = rows[p, 10]
            for i in range(9):
                change -= step[i] * rows[p, i]
            depth[p] += change / rows[p, 9]
            if self.road[p]:
                off = depth[p] - self.known[p]
                for i in range(3):
                    off -= self.slopes[p, i] * plane[i]
                share = 1.0 + (off / self.spread[p] / self.inlier) ** 2
                trust[p] = 1.0 / (share * share)
