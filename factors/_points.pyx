# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""Measured points on a vehicle's surface, compiled: the equations are those of `factors.surface_points`."""

from libc.math cimport INFINITY, NAN, exp, fabs, log, sqrt

import numpy as np

from factors._rows cimport Source

from factors import surface_points as rows
from factors.mixture import STIFFEST

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef double PI = 3.14159265358979323846, STIFF = STIFFEST, SPREAD = rows.SPREAD, LEAST_COSINE = rows.LEAST_COSINE
cdef double LONGEST_STEP = rows.LONGEST_STEP, SOFTNESS = rows.SOFTNESS, LEAST_RATIO = rows.LEAST_RATIO
cdef double FARTHEST = rows.FARTHEST, OUTSIDE = rows.OUTSIDE
cdef int STEPS = rows.STEPS
cdef double NOTHING[2]  # zeros: what points share where nothing is known of it

cdef enum Shared:  # as `factors.surface_points.Shared`
    NONE = 0
    DEPTH = 1
    INVERSE = 2

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
        self, points, sigma, along, origin, mean, basis, normal, off_normal, along_normal, neighbours, first, grid,
        double spacing, size, size_basis, odds, double share, int shared
    ):
        """Bind the arrays.

        Args:
            points: (M, 3). sigma: (M,). along: (M,). origin: (3,).
            mean: (P, 3). basis: (P, 3 N), of each patch its N vectors. normal: (P, 3). off_normal: (P,), along_normal:
                (P, N), of centres and vectors along it. neighbours: (P, m).
            first: (3,). grid: (X, Y, Z). spacing: of the grid.
            size: (3,). size_basis: (3, N).
            odds: (8,) numbers of `factors.surface_points.PointOdds` in their order.
            share: Factor on the energy.
            shared: What the variables are that all points share.
        """
        self.points, self.sigma, self.along, self.origin, self.mean, self.basis = points, sigma, along, origin, mean, basis
        self.shared = shared
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

    cdef double ratio(self, int i, const double *shared) noexcept nogil:
        """Depth of a point by what all of them share, as a share of the measured one."""
        if self.shared == NONE:
            return 1.0
        if self.shared == DEPTH:
            return max(exp(shared[0]) + shared[1] / self.points[i, 2], LEAST_RATIO)
        return 1.0 / max(exp(shared[0]) + shared[1] * self.points[i, 2], LEAST_RATIO)

    cdef void place(
        self, int i, const double *R, const double *t, const double *shared, double *local
    ) noexcept nogil:
        """A point in the object frame."""
        cdef int a, b
        cdef double ratio = self.ratio(i, shared)
        for a in range(3):
            local[a] = 0.0
            for b in range(3):
                local[a] += (ratio * self.points[i, b] - t[b]) * R[3 * b + a]

    cdef int nearest(self, const double *local, const double *sensor, const double *scale, bint *facing) noexcept nogil:
        """The patch next to a point in the object frame, of those that face the sensor, and whether it does."""
        cdef int a, j, k, n, best = -1
        cdef int place[3]
        cdef double d, towards, square, least = INFINITY
        cdef double q[3]
        for a in range(3):
            q[a] = local[a] * scale[a]
            d = (q[a] - self.first[a]) / self.spacing
            place[a] = 0 if not d > 0.0 else (
                <int> self.grid.shape[a] - 1 if d > self.grid.shape[a] - 1 else <int> (d + 0.5)
            )
        k = self.grid[place[0], place[1], place[2]]
        for j in range(self.neighbours.shape[1]):
            n = self.neighbours[k, j]
            towards, square = -self.off_normal[n], 0.0
            for a in range(3):
                towards += sensor[a] * scale[a] * self.normal[n, a]
                d = q[a] - self.mean[n, a]
                square += d * d
            if towards > 0.0 and square < least:
                least, best = square, n
        facing[0] = best >= 0
        return best if best >= 0 else self.neighbours[k, 0]

    cdef bint is_near(self, const double *local, const double *size) noexcept nogil:
        """Whether a point in the object frame is so near the vehicle's cuboid that it may be on a patch."""
        cdef double reach = self.odds[6] + FARTHEST * self.odds[7] + OUTSIDE
        return (
            fabs(local[0]) <= 0.5 * size[0] + reach
            and fabs(local[1] + 0.5 * size[2]) <= 0.5 * size[2] + reach
            and fabs(local[2]) <= 0.5 * size[1] + reach
        )

    cdef double off(self, int k, const double *local, const double *x) noexcept nogil:
        """Distance of a point in the object frame from the plane of a patch, metres."""
        cdef int a, n
        cdef double found = -self.off_normal[k]
        for a in range(3):
            found += local[a] * self.normal[k, a]
        for n in range(self.coefficients):
            found -= self.along_normal[k, n] * x[n]
        return found

    cdef void trace(
        self, const double *x, const double *size, const double *sensor, const double *scale, const double *unit,
        double *met
    ) noexcept nogil:
        """Where a ray meets the surface, object frame; of one that misses it, where it is near."""
        cdef int a, k, step
        cdef double half, middle, one, other, ray, enters = -INFINITY, leaves = INFINITY, at = 0.0, slope, moved
        cdef bint facing
        for a in range(3):
            half = 0.5 * (size[0] if a == 0 else (size[2] if a == 1 else size[1]))
            middle = -0.5 * size[2] if a == 1 else 0.0
            ray = unit[a] if fabs(unit[a]) > 1e-9 else 1e-9
            one, other = (middle - half - sensor[a]) / ray, (middle + half - sensor[a]) / ray
            enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
            at += unit[a] * (middle - sensor[a])
        if leaves > max(enters, 0.0):
            at = max(enters, 0.0)
        for step in range(STEPS):
            for a in range(3):
                met[a] = sensor[a] + at * unit[a]
            k = self.nearest(met, sensor, scale, &facing)
            slope = 0.0
            for a in range(3):
                slope += self.normal[k, a] * unit[a]
            if facing and slope < -LEAST_COSINE:
                moved = -self.off(k, met, x) / slope
                at += min(max(moved, -LONGEST_STEP), LONGEST_STEP)
        for a in range(3):
            met[a] = sensor[a] + at * unit[a]

    cdef double elsewhere(
        self, int i, const double *local, const double *size, const double *sensor, double far
    ) noexcept nogil:
        """How dense points that are anything else are, by the ray through a cuboid in the vehicle."""
        cdef int a
        cdef double half, middle, ray, one, other, inside, noise, past, before, deep
        cdef double enters = -INFINITY, leaves = INFINITY, found = 1.0
        for a in range(3):
            half = 0.5 * self.odds[5] * (size[0] if a == 0 else (size[2] if a == 1 else size[1]))
            middle = -0.5 * size[2] if a == 1 else 0.0
            ray = local[a] - sensor[a]
            if fabs(ray) <= 1e-9:
                ray = 1e-9
            one, other = (middle - half - sensor[a]) / ray, (middle + half - sensor[a]) / ray
            enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
        if not leaves > max(enters, 0.0):
            return 1.0
        if self.along[i] > 0.0:
            noise, past = self.along[i] / SOFTNESS, (1.0 - enters) * far
            before = 1.0 / (1.0 + exp(min(max(past / noise, -50.0), 50.0)))
            deep = 1.0 / (1.0 + exp(min(max((self.odds[4] - past) / noise, -50.0), 50.0)))
            return 1.0 + before * (self.odds[2] - 1.0) + deep * (self.odds[3] - 1.0)
        inside = (min(leaves, 1.0) - max(enters, 0.0)) * far
        if inside > self.odds[4]:
            found = self.odds[3]
        elif enters >= 1.0:
            found = self.odds[2]
        return found

    cdef double peak(self, int i) noexcept nogil:
        """Density of anything else, relative to the peak of a right point's."""
        cdef double spread = sqrt(self.sigma[i] * self.sigma[i] + self.along[i] * self.along[i])
        return sqrt(2.0 * PI) * spread / max(self.odds[1], SPREAD * self.along[i])

    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const double *size,
        const double *sensor, double *local, double *right, double *wrong, double *sigma
    ) noexcept nogil:
        """The patch next to a point, the point in the object frame, the densities, and the deviation of its distance."""
        cdef int a, n, k
        cdef double scale[3]
        cdef double unit[3]
        cdef double met[3]
        cdef double d, square, off, tangent, beyond, far = 0.0, cosine = 0.0, across
        cdef bint facing
        scale[0] = self.size[0] / max(size[0], 0.1 * self.size[0])
        scale[1] = self.size[2] / max(size[2], 0.1 * self.size[2])
        scale[2] = self.size[1] / max(size[1], 0.1 * self.size[1])
        self.place(i, R, t, shared, local)
        for a in range(3):
            unit[a], met[a] = local[a] - sensor[a], local[a]
            far += unit[a] * unit[a]
        far = sqrt(far)
        wrong[0] = (1.0 - self.vehicle) * self.peak(i) * self.elsewhere(i, local, size, sensor, far)
        if self.along[i] > 0.0:
            for a in range(3):
                unit[a] /= max(far, 1e-9)
            self.trace(x, size, sensor, scale, unit, met)
        right[0], sigma[0] = 0.0, self.sigma[i]
        if not (self.along[i] > 0.0 or self.is_near(local, size)):
            return 0
        k = self.nearest(met, sensor, scale, &facing)
        if self.along[i] > 0.0:
            for a in range(3):
                cosine += unit[a] * self.normal[k, a]
            cosine = fabs(cosine)
            across = self.along[i] * cosine
            sigma[0] = sqrt(self.sigma[i] * self.sigma[i] + across * across)
        if not facing:
            return k
        off, square = 0.0, 0.0
        for a in range(3):
            d = met[a] - self.mean[k, a]
            for n in range(self.coefficients):
                d -= self.basis[k, 3 * n + a] * x[n]
            off += d * self.normal[k, a]
            square += d * d
        tangent = sqrt(max(square - off * off, 0.0))
        beyond = max(tangent - self.odds[6], 0.0) / self.odds[7]
        right[0] = self.vehicle * exp(-0.5 * beyond * beyond)
        if self.along[i] > 0.0:
            right[0] *= cosine * sqrt(self.sigma[i] * self.sigma[i] + self.along[i] * self.along[i]) / sigma[0]
        return k

    cdef double add(
        self, const double *R, const double *t, const double *x, double *g, double *M, double *J
    ) noexcept nogil:
        """Energy; its gradient and the lower triangle of its matrix are added, by turn, camera's axes, coefficients."""
        cdef int i, k, a, b, D = 6 + self.coefficients
        cdef double size[3]
        cdef double sensor[3]
        cdef double local[3]
        cdef double right, wrong, sigma, r, inlier, weight, best, energy = 0.0
        cdef const double *n
        self.prepare(R, t, x, size, sensor)
        for i in range(self.count):
            k = self.match_one(i, R, t, x, &NOTHING[0], size, sensor, local, &right, &wrong, &sigma)
            r = self.off(k, local, x) / sigma
            inlier = right * exp(-0.5 * r * r)
            best = self.vehicle + (1.0 - self.vehicle) * self.peak(i)
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
                J[a] /= sigma
            for a in range(D):
                g[a] += weight * r * J[a]
                for b in range(a + 1):
                    M[a * D + b] += weight * J[a] * J[b]
        return self.share * energy

    def match(
        self, const double[:, :] rotation, const double[:] translation, const double[:] coefficients,
        const double[::1] shared
    ):
        """Patches (M,), densities of right points (M,) and of wrong ones (M,), and deviations (M,) at a state."""
        cdef double R[9]
        cdef double t[3]
        cdef double size[3]
        cdef double sensor[3]
        cdef double local[3]
        cdef int a, b, i
        patch, right, wrong = np.empty(self.count, dtype=np.intp), np.empty(self.count), np.empty(self.count)
        sigma = np.empty(self.count)
        cdef Py_ssize_t[::1] patches = patch
        cdef double[::1] r = right, w = wrong, s = sigma, x = np.ascontiguousarray(coefficients, dtype=np.float64)
        cdef const double *at = &x[0] if self.coefficients else NULL
        for a in range(3):
            t[a] = translation[a]
            for b in range(3):
                R[3 * a + b] = rotation[a, b]
        self.prepare(R, t, at, size, sensor)
        for i in range(self.count):
            patches[i] = self.match_one(i, R, t, at, &shared[0], size, sensor, local, &r[i], &w[i], &s[i])
        return patch, right, wrong, sigma

    def distances(
        self, const Py_ssize_t[::1] patch, const double[::1] sigma, const double[:, :] rotation,
        const double[:] translation, const double[:] coefficients, const double[::1] shared, bint want
    ):
        """Whitened distances (M,), and where wanted their derivative (M, 6 + N + C).

        By turn, object's axes, coefficients, and what the points share.
        """
        cdef int a, b, i, D = 6 + self.coefficients + (0 if self.shared == NONE else 2)
        cdef double R[9]
        cdef double t[3]
        cdef double local[3]
        cdef double[::1] x = np.ascontiguousarray(coefficients, dtype=np.float64)
        cdef const double *at = &x[0] if self.coefficients else NULL
        found = np.empty(self.count)
        derivative = np.empty((self.count if want else 0, D))
        cdef double[::1] r = found
        cdef double[:, ::1] J = derivative
        for a in range(3):
            t[a] = translation[a]
            for b in range(3):
                R[3 * a + b] = rotation[a, b]
        for i in range(self.count):
            self.place(i, R, t, &shared[0], local)
            r[i] = self.off(patch[i], local, at) / sigma[i]
            if want:
                self.row(i, patch[i], R, local, &shared[0], 1.0 / sigma[i], &J[i, 0])
        return found, derivative if want else None

    def assess(self, const double[::1] right, const double[::1] wrong, const double[::1] distances):
        """Weights (M,) of points by their densities (M,) and whitened distances (M,), and their energy, nats."""
        cdef int i
        cdef double inlier, energy = 0.0
        weights = np.empty(self.count)
        cdef double[::1] w = weights
        for i in range(self.count):
            inlier = right[i] * exp(-0.5 * distances[i] * distances[i])
            w[i] = inlier / (inlier + wrong[i])
            energy += log((self.vehicle + (1.0 - self.vehicle) * self.peak(i)) / (inlier + wrong[i]))
        return weights, self.share * energy

    cdef void row(
        self, int i, int k, const double *R, const double *local, const double *shared, double factor, double *J
    ) noexcept nogil:
        """A derivative times a factor: by turn, object's axes, coefficients, and what the points share."""
        cdef int a, b, N = self.coefficients
        cdef double ratio, along = 0.0, scale
        cdef const double *n = &self.normal[k, 0]
        J[0] = factor * (n[1] * local[2] - n[2] * local[1])
        J[1] = factor * (n[2] * local[0] - n[0] * local[2])
        J[2] = factor * (n[0] * local[1] - n[1] * local[0])
        for a in range(3):
            J[3 + a] = -factor * n[a]
        for a in range(N):
            J[6 + a] = -factor * self.along_normal[k, a]
        if self.shared == NONE:
            return
        for a in range(3):
            for b in range(3):
                along += n[a] * R[3 * b + a] * self.points[i, b]
        ratio, scale = self.ratio(i, shared), exp(shared[0])
        if self.shared == DEPTH:
            J[6 + N], J[7 + N] = factor * along * scale, factor * along / self.points[i, 2]
        else:
            J[6 + N] = -factor * along * ratio * ratio * scale
            J[7 + N] = -factor * along * ratio * ratio * self.points[i, 2]


cdef class PointSource(Source):
    """Rows of measured points in a graph: of the pose, the coefficients, and what the points share if they do.

    Attributes:
        points: The points.
        form: How the mixture is handed to the solver, as `factors.mixture.Form`; without a Jacobian it is the loss.
        share: Factor on the energy.
    """

    cdef readonly Points points
    cdef public int form
    cdef public double share, common
    cdef bint applied
    cdef Py_ssize_t[::1] patch
    cdef double[::1] right, wrong, sigma, weights

    def __init__(self, Points points, double share):
        """Bind the points."""
        cdef int M = points.count, N = points.coefficients
        self.points, self.share, self.common, self.form, self.rows, self.applied = points, share, 1.0, NEWTON, M, False
        self.patch, self.right, self.wrong = np.zeros(M, dtype=np.intp), np.zeros(M), np.ones(M)
        self.sigma, self.weights = np.ones(M), np.zeros(M)
        self.take([(12, 6, True), (N, N, True)] + ([] if points.shared == NONE else [(2, 2, True)]))

    def tell(
        self, const Py_ssize_t[::1] patch, const double[::1] right, const double[::1] wrong, const double[::1] sigma,
        const double[::1] w
    ):
        """Set patches (M,), densities of right and of wrong points (M,), deviations (M,), and weights (M,)."""
        if not patch.shape[0] == right.shape[0] == wrong.shape[0] == sigma.shape[0] == w.shape[0] == self.rows:
            raise ValueError("patches, densities, deviations and weights (M,) are expected")
        self.patch[:], self.right[:], self.wrong[:], self.sigma[:], self.weights[:] = patch, right, wrong, sigma, w
        self.applied = True

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *R = at[0]
        cdef const double *t = at[0] + 9
        cdef const double *x = at[1]
        cdef const double *shared = &NOTHING[0] if self.points.shared == NONE else at[2]
        cdef int i, k
        cdef double local[3]
        cdef double size[3]
        cdef double sensor[3]
        cdef double d, s, inlier, weight, loss, rest, stretch, bend, energy = 0.0, root = sqrt(self.share)
        if not self.applied:
            self.points.prepare(R, t, x, size, sensor)
        for i in range(self.rows):
            if self.applied:
                self.points.place(i, R, t, shared, local)
            else:
                self.patch[i] = self.points.match_one(
                    i, R, t, x, shared, size, sensor, local, &self.right[i], &self.wrong[i], &self.sigma[i]
                )
            k = self.patch[i]
            d = self.points.off(k, local, x) / self.sigma[i]
            s = d * d
            inlier = self.right[i] * exp(-0.5 * s)
            weight = inlier / (inlier + self.wrong[i])
            if not self.applied:
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
            if J != NULL and bend != 0.0:
                self.points.row(i, k, R, local, shared, bend * root / self.sigma[i], J + i * self.columns)
        self.applied = True
        return NAN if self.form == WEIGHTED else self.share * energy
