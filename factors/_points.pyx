# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""Measured points on a vehicle's surface, compiled: the equations are those of `factors.surface_points`."""

from libc.math cimport INFINITY, NAN, exp, fabs, log, sqrt

import numpy as np

from factors._rows cimport Source

from factors.mixture import STIFFEST

cdef double PI = 3.14159265358979323846, STIFF = STIFFEST

cdef enum Form:  # as `factors.mixture.Form`
    WEIGHTED = 0
    LOSS = 1
    NEWTON = 2
    MAJORISED = 3


cdef class Points:
    """The points of an observation, bound to the patches that they may be on."""

    def __reduce__(self):
        """Pointers into arrays are not copied.

        Raises:
            TypeError: Always; who holds it makes another.
        """
        raise TypeError("compiled Points cannot be copied or pickled")

    def __init__(
        self, points, sigma, origin, mean, basis, normal, off_normal, along_normal, neighbours, first, grid,
        double spacing, size, size_basis, odds, double share
    ):
        """Bind the arrays.

        Args:
            points: (M, 3). sigma: (M,). origin: (3,).
            mean: (P, 3). basis: (P, 3 N), of each patch its N vectors. normal: (P, 3). off_normal: (P,), along_normal:
                (P, N), of centres and vectors along it. neighbours: (P, m).
            first: (3,). grid: (X, Y, Z). spacing: of the grid.
            size: (3,). size_basis: (3, N).
            odds: (8,) numbers of `factors.surface_points.PointOdds` in their order.
            share: Factor on the energy.
        """
        self.points, self.sigma, self.origin, self.mean, self.basis = points, sigma, origin, mean, basis
        self.normal, self.neighbours, self.first, self.grid = normal, neighbours, first, grid
        self.size, self.size_basis, self.odds = size, size_basis, odds
        self.spacing, self.share, self.vehicle = spacing, share, odds[0]
        self.count, self.coefficients = points.shape[0], size_basis.shape[1]
        self.off_normal, self.along_normal = off_normal, along_normal

    cdef void prepare(
        self, const double *R, const double *t, const double *x, double *size, double *sensor
    ) noexcept nogil:
        """Length, width and height, and the sensor in the object frame."""
        cdef int a, b, n
        for a in range(3):
            size[a] = self.size[a]
            for n in range(self.coefficients):
                size[a] += self.size_basis[a, n] * x[n]
            sensor[a] = 0.0
            for b in range(3):
                sensor[a] += (self.origin[b] - t[b]) * R[3 * b + a]

    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *size, const double *sensor,
        double *local, double *right, double *wrong
    ) noexcept nogil:
        """The patch next to a point, the point in the object frame, and the densities."""
        cdef int a, b, j, k, n, best = -1
        cdef int place[3]
        cdef int limit[3]
        cdef double scale[3]
        cdef double q[3]
        cdef double s[3]
        cdef double half[3]
        cdef double middle[3]
        cdef double square, least = INFINITY, facing, d, off, along, enters = -INFINITY, leaves = INFINITY
        cdef double one, other, ray, length = 0.0, inside, else_, beyond
        scale[0] = self.size[0] / max(size[0], 0.1 * self.size[0])
        scale[1] = self.size[2] / max(size[2], 0.1 * self.size[2])
        scale[2] = self.size[1] / max(size[1], 0.1 * self.size[1])
        limit[0], limit[1], limit[2] = self.grid.shape[0], self.grid.shape[1], self.grid.shape[2]
        for a in range(3):
            local[a] = 0.0
            for b in range(3):
                local[a] += (self.points[i, b] - t[b]) * R[3 * b + a]
            q[a] = local[a] * scale[a]
            s[a] = sensor[a] * scale[a]
            d = (q[a] - self.first[a]) / self.spacing
            place[a] = 0 if not d > 0.0 else (limit[a] - 1 if d > limit[a] - 1 else <int> (d + 0.5))
        k = self.grid[place[0], place[1], place[2]]
        for j in range(self.neighbours.shape[1]):
            n = self.neighbours[k, j]
            facing, square = -self.off_normal[n], 0.0
            for a in range(3):
                facing += s[a] * self.normal[n, a]
                d = q[a] - self.mean[n, a]
                square += d * d
            if facing > 0.0 and square < least:
                least, best = square, n
        # Anything else, by the ray through a cuboid in the vehicle.
        half[0], half[1], half[2] = size[0], size[2], size[1]
        middle[0], middle[1], middle[2] = 0.0, -0.5 * size[2], 0.0
        for a in range(3):
            half[a] *= 0.5 * self.odds[5]
            ray = local[a] - sensor[a]
            length += ray * ray
            if fabs(ray) <= 1e-9:
                ray = 1e-9
            one, other = (middle[a] - half[a] - sensor[a]) / ray, (middle[a] + half[a] - sensor[a]) / ray
            enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
        else_ = 1.0
        if leaves > max(enters, 0.0):
            inside = (min(leaves, 1.0) - max(enters, 0.0)) * sqrt(length)
            if inside > self.odds[4]:
                else_ = self.odds[3]
            elif enters >= 1.0:
                else_ = self.odds[2]
        wrong[0] = (1.0 - self.vehicle) * sqrt(2.0 * PI) * self.sigma[i] / self.odds[1] * else_
        right[0] = 0.0
        if best < 0:
            return self.neighbours[k, 0]
        off, square = 0.0, 0.0
        for a in range(3):
            d = local[a] - self.mean[best, a]
            for n in range(self.coefficients):
                d -= self.basis[best, 3 * n + a] * x[n]
            off += d * self.normal[best, a]
            square += d * d
        along = sqrt(max(square - off * off, 0.0))
        beyond = max(along - self.odds[6], 0.0) / self.odds[7]
        right[0] = self.vehicle * exp(-0.5 * beyond * beyond)
        return best

    cdef double distance(self, int i, int k, const double *local, const double *x) noexcept nogil:
        """Whitened distance of a point in the object frame from a patch."""
        cdef int a, n
        cdef double off = -self.off_normal[k]
        for a in range(3):
            off += local[a] * self.normal[k, a]
        for n in range(self.coefficients):
            off -= self.along_normal[k, n] * x[n]
        return off / self.sigma[i]

    cdef double add(
        self, const double *R, const double *t, const double *x, double *g, double *M, double *J
    ) noexcept nogil:
        """Energy; its gradient and the lower triangle of its matrix are added, by turn, camera's axes, coefficients."""
        cdef int i, k, a, b, D = 6 + self.coefficients
        cdef double size[3]
        cdef double sensor[3]
        cdef double local[3]
        cdef double right, wrong, r, inlier, weight, best, energy = 0.0
        cdef const double *n
        self.prepare(R, t, x, size, sensor)
        for i in range(self.count):
            k = self.match_one(i, R, t, x, size, sensor, local, &right, &wrong)
            r = self.distance(i, k, local, x)
            inlier = right * exp(-0.5 * r * r)
            best = self.vehicle + (1.0 - self.vehicle) * sqrt(2.0 * PI) * self.sigma[i] / self.odds[1]
            energy += log(best / (inlier + wrong))
            weight = inlier / (inlier + wrong) * self.share
            if weight <= 1e-6:
                continue
            n = &self.normal[k, 0]
            J[0] = n[1] * local[2] - n[2] * local[1]
            J[1] = n[2] * local[0] - n[0] * local[2]
            J[2] = n[0] * local[1] - n[1] * local[0]
            for a in range(3):
                J[3 + a] = 0.0
                for b in range(3):
                    J[3 + a] -= R[3 * a + b] * n[b]
            for a in range(self.coefficients):
                J[6 + a] = -self.along_normal[k, a]
            for a in range(D):
                J[a] /= self.sigma[i]
            for a in range(D):
                g[a] += weight * r * J[a]
                for b in range(a + 1):
                    M[a * D + b] += weight * J[a] * J[b]
        return self.share * energy

    def match(self, const double[:, :] rotation, const double[:] translation, const double[:] coefficients):
        """Patches (M,), densities of right points (M,) and of wrong ones (M,) at a pose and shape."""
        cdef double R[9]
        cdef double t[3]
        cdef double size[3]
        cdef double sensor[3]
        cdef double local[3]
        cdef int a, b, i
        patch, right, wrong = np.empty(self.count, dtype=np.intp), np.empty(self.count), np.empty(self.count)
        cdef Py_ssize_t[::1] patches = patch
        cdef double[::1] r = right, w = wrong, x = np.ascontiguousarray(coefficients, dtype=np.float64)
        cdef const double *at = &x[0] if self.coefficients else NULL
        for a in range(3):
            t[a] = translation[a]
            for b in range(3):
                R[3 * a + b] = rotation[a, b]
        self.prepare(R, t, at, size, sensor)
        for i in range(self.count):
            patches[i] = self.match_one(i, R, t, at, size, sensor, local, &r[i], &w[i])
        return patch, right, wrong

    def distances(
        self, const Py_ssize_t[::1] patch, const double[:, :] rotation, const double[:] translation,
        const double[:] coefficients, bint want
    ):
        """Whitened distances (M,), and where wanted their derivative (M, 6 + N) by turn, object's axes, coefficients."""
        cdef int a, b, i, k, N = self.coefficients
        cdef double local[3]
        cdef const double *n
        cdef double[::1] x = np.ascontiguousarray(coefficients, dtype=np.float64)
        cdef const double *at = &x[0] if N else NULL
        found = np.empty(self.count)
        derivative = np.empty((self.count if want else 0, 6 + N))
        cdef double[::1] r = found
        cdef double[:, ::1] J = derivative
        for i in range(self.count):
            k = patch[i]
            for a in range(3):
                local[a] = 0.0
                for b in range(3):
                    local[a] += (self.points[i, b] - translation[b]) * rotation[b, a]
            r[i] = self.distance(i, k, local, at)
            if want:
                n = &self.normal[k, 0]
                J[i, 0] = (n[1] * local[2] - n[2] * local[1]) / self.sigma[i]
                J[i, 1] = (n[2] * local[0] - n[0] * local[2]) / self.sigma[i]
                J[i, 2] = (n[0] * local[1] - n[1] * local[0]) / self.sigma[i]
                for a in range(3):
                    J[i, 3 + a] = -n[a] / self.sigma[i]
                for a in range(N):
                    J[i, 6 + a] = -self.along_normal[k, a] / self.sigma[i]
        return found, derivative if want else None


cdef class PointSource(Source):
    """Rows of measured points in a graph: of the pose and the coefficients.

    Attributes:
        points: The points.
        form: How the mixture is handed to the solver, as `factors.mixture.Form`; without a Jacobian it is the loss.
        share: Factor on the energy.
    """

    cdef readonly Points points
    cdef public int form
    cdef public double share, common
    cdef bint told
    cdef Py_ssize_t[::1] patch
    cdef double[::1] right, wrong, weights

    def __init__(self, Points points, double share):
        """Bind the points."""
        cdef int M = points.count, N = points.coefficients
        self.points, self.share, self.common, self.form, self.rows, self.told = points, share, 1.0, NEWTON, M, False
        self.patch, self.right, self.wrong = np.zeros(M, dtype=np.intp), np.zeros(M), np.ones(M)
        self.weights = np.zeros(M)
        self.take([(12, 6, True), (N, N, True)])

    def tell(self, const Py_ssize_t[::1] patch, const double[::1] right, const double[::1] wrong, const double[::1] w):
        """Set patches (M,), densities of right and of wrong points (M,), and weights (M,)."""
        if patch.shape[0] != self.rows or right.shape[0] != self.rows or wrong.shape[0] != self.rows:
            raise ValueError("patches and densities (M,) are expected")
        self.patch[:], self.right[:], self.wrong[:], self.weights[:] = patch, right, wrong, w
        self.told = True

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *R = at[0]
        cdef const double *t = at[0] + 9
        cdef const double *x = at[1]
        cdef const double *n
        cdef double *row
        cdef int a, b, i, k, N = self.points.coefficients
        cdef double local[3]
        cdef double size[3]
        cdef double sensor[3]
        cdef double d, s, inlier, weight, loss, rest, stretch, bend, energy = 0.0, root = sqrt(self.share)
        if not self.told:
            self.points.prepare(R, t, x, size, sensor)
        for i in range(self.rows):
            if self.told:
                for a in range(3):
                    local[a] = 0.0
                    for b in range(3):
                        local[a] += (self.points.points[i, b] - t[b]) * R[3 * b + a]
            else:
                self.patch[i] = self.points.match_one(
                    i, R, t, x, size, sensor, local, &self.right[i], &self.wrong[i]
                )
            k = self.patch[i]
            d = self.points.distance(i, k, local, x)
            s = d * d
            inlier = self.right[i] * exp(-0.5 * s)
            weight = inlier / (inlier + self.wrong[i])
            if not self.told:
                self.weights[i] = weight
            loss = log((self.right[i] + self.wrong[i]) / (inlier + self.wrong[i]))
            if self.form == WEIGHTED:
                stretch = bend = sqrt(self.weights[i] / self.common)
            elif J == NULL or self.form == LOSS:
                stretch = bend = sqrt(2.0 * loss / s) if s > 0.0 else sqrt(weight)
            elif self.form == MAJORISED:
                stretch = bend = sqrt(weight)
            else:
                rest = sqrt(max(1.0 - (1.0 - weight) * s, STIFF))
                stretch, bend = sqrt(weight) / rest, sqrt(weight) * rest
            energy += loss
            r[i] = root * stretch * d
            if J == NULL or bend == 0.0:
                continue
            row, n = J + i * (6 + N), &self.points.normal[k, 0]
            bend *= root / self.points.sigma[i]
            row[0] = bend * (n[1] * local[2] - n[2] * local[1])
            row[1] = bend * (n[2] * local[0] - n[0] * local[2])
            row[2] = bend * (n[0] * local[1] - n[1] * local[0])
            for a in range(3):
                row[3 + a] = -bend * n[a]
            for a in range(N):
                row[6 + a] = -bend * self.points.along_normal[k, a]
        self.told = True
        return NAN if self.form == WEIGHTED else self.share * energy
