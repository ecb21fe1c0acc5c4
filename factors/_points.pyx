# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""Measured points on a vehicle's surface, compiled: the equations are those of `factors.surface_points`."""

from libc.math cimport INFINITY, NAN, exp, fabs, log, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from factors._rows cimport Source

from factors import surface_points as rows
from factors.mixture import STIFFEST

cdef extern from *:
    """
    #if defined(_MSC_VER)
    #define FGRECON_ALONE __restrict
    #else
    #define FGRECON_ALONE __restrict__
    #endif

    /* Four weighted rows (4, D) with residuals (4,) added to a gradient (D,) and to a lower triangle (D, D) at once. */
    static void fgrecon_add_four(
        const double *FGRECON_ALONE J, const double *w, const double *r, int D, double *FGRECON_ALONE g,
        double *FGRECON_ALONE M
    ) {
        const double *j0 = J, *j1 = J + D, *j2 = J + 2 * D, *j3 = J + 3 * D;
        for (int a = 0; a < D; a++) {
            const double c0 = w[0] * j0[a], c1 = w[1] * j1[a], c2 = w[2] * j2[a], c3 = w[3] * j3[a];
            double *m = M + a * D;
            g[a] += (c0 * r[0] + c1 * r[1]) + (c2 * r[2] + c3 * r[3]);
            for (int b = 0; b <= a; b++) m[b] += (c0 * j0[b] + c1 * j1[b]) + (c2 * j2[b] + c3 * j3[b]);
        }
    }
    """
    void add_four "fgrecon_add_four"(
        const double *J, const double *w, const double *r, int D, double *g, double *M
    ) nogil
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef double PI = 3.14159265358979323846, STIFF = STIFFEST, SPREAD = rows.SPREAD, LEAST_COSINE = rows.LEAST_COSINE
cdef double LONGEST_STEP = rows.LONGEST_STEP, SOFTNESS = rows.SOFTNESS, LEAST_RATIO = rows.LEAST_RATIO
cdef double FARTHEST = rows.FARTHEST, OUTSIDE = rows.OUTSIDE
cdef double ON_SIDE = rows.ON_SIDE, CLEAR = rows.CLEAR, LOW = rows.LOW
cdef double NEAR = rows.NEAR, NEARER = rows.NEARER, NEAREST = rows.NEAREST
cdef int STEPS = rows.STEPS
cdef double NOTHING[2]  # zeros: what points share where nothing is known of it
cdef double NOT_THERE = 80.0  # squared deviations from which on a density is none
cdef double ROUNDED = 1e-4  # product of densities from which on its logarithm is taken

cdef enum Shared:  # as `factors.surface_points.Shared`
    NONE = 0
    DEPTH = 1
    INVERSE = 2


cdef void mixed(
    int form, double right, double wrong, double weight, double square, double *stretch, double *bend, double *loss
) noexcept nogil:
    """Factors on a residual and on its derivative, and its loss (`factors.mixture.robust_rows`).

    Args:
        weight: What `Form.WEIGHTED` has.
        square: The squared residual.
    """
    cdef double inlier = right * exp(-0.5 * square), rest, own = inlier / (inlier + wrong)
    loss[0] = log((right + wrong) / (inlier + wrong))
    if form == WEIGHTED:
        stretch[0] = bend[0] = sqrt(weight)
    elif form == LOSS:
        stretch[0] = bend[0] = sqrt(2.0 * loss[0] / square) if square > 0.0 else sqrt(own)
    elif form == MAJORISED:
        stretch[0] = bend[0] = sqrt(own)
    else:
        rest = sqrt(max(1.0 - (1.0 - own) * square, STIFF))
        stretch[0], bend[0] = sqrt(own) / rest, sqrt(own) * rest


cdef class Term:
    """What beside the keypoints has a share in the energy that the search minimises.

    Attributes:
        coefficients: Number of the vehicle's.
    """

    def __reduce__(self):
        """Pointers into arrays are not copied.

        Raises:
            TypeError: Always; who holds it makes another.
        """
        raise TypeError(f"a compiled {type(self).__name__} cannot be copied or pickled")

    cdef double add(
        self, const double *R, const double *t, const double *x, double most, double *g, double *M, double *J
    ) noexcept nogil:
        """Energy, or infinity once it is above the most that counts.

        Unless J (4, 6 + N), which is for work, is NULL, gradient and the lower triangle of the matrix are added, by turn,
        camera's axes, coefficients.
        """
        return 0.0


cdef inline double apart(const double *a, const double *b, int count) noexcept nogil:
    """Squared distance of two vectors."""
    cdef int i
    cdef double total = 0.0
    for i in range(count):
        total += (a[i] - b[i]) * (a[i] - b[i])
    return total


cdef class Points(Term):
    """The points of an observation, bound to the patches that they may be on."""

    def __init__(
        self, points, sigma, along, origin, patches, basis, along_normal, neighbours, first, grid, double spacing,
        size, size_basis, odds, double share, int shared
    ):
        """Bind the arrays.

        Args:
            points: (M, 3). sigma: (M,). along: (M,). origin: (3,).
            patches: (P, 8), of each its centre, its normal, the centre along that, and nothing. basis: (P, 3 N), of
                each patch its N vectors. along_normal: (P, N), of these along the normal. neighbours: (P, m).
            first: (3,). grid: (X, Y, Z). spacing: of the grid.
            size: (3,). size_basis: (3, N).
            odds: (10,) numbers of `factors.surface_points.PointOdds` in their order.
            share: Factor on the energy.
            shared: What the variables are that all points share.
        """
        cdef int i
        cdef double peak
        self.points, self.sigma, self.along, self.origin, self.basis = points, sigma, along, origin, basis
        self.patches, self.shared, self.along_normal = patches, shared, along_normal
        self.neighbours, self.first, self.grid = neighbours, first, grid
        self.size, self.size_basis, self.odds = size, size_basis, odds
        self.spacing, self.share, self.vehicle = spacing, share, odds[0]
        self.count, self.coefficients = points.shape[0], size_basis.shape[1]
        self.elsewhere_peak, self.inverse_best = np.empty(self.count), np.empty(self.count)
        for i in range(self.count):
            peak = sqrt(2.0 * PI * (self.sigma[i] * self.sigma[i] + self.along[i] * self.along[i]))
            peak *= (1.0 - self.vehicle) / max(self.odds[1], SPREAD * self.along[i])
            self.elsewhere_peak[i], self.inverse_best[i] = peak, 1.0 / (self.vehicle + peak)

    cdef void prepare(self, const double *R, const double *t, const double *x, View *view) noexcept nogil:
        """How a vehicle is seen at a state."""
        cdef int a, b, n
        cdef double size
        for a in range(3):
            b = a if a == 0 else 3 - a  # length, height, width
            size = self.size[b]
            for n in range(self.coefficients):
                size += self.size_basis[b, n] * x[n]
            view.half[a] = 0.5 * size
            view.scale[a] = self.size[b] / max(size, 0.1 * self.size[b])
            view.sensor[a] = 0.0
            for b in range(3):
                view.sensor[a] += (self.origin[b] - t[b]) * R[3 * b + a]
            view.scaled[a] = view.sensor[a] * view.scale[a]
        view.middle = -view.half[1]

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
        cdef int a
        cdef double ratio = self.ratio(i, shared)
        cdef double x = ratio * self.points[i, 0] - t[0]
        cdef double y = ratio * self.points[i, 1] - t[1]
        cdef double z = ratio * self.points[i, 2] - t[2]
        for a in range(3):
            local[a] = x * R[a] + y * R[3 + a] + z * R[6 + a]

    cdef int nearest(self, const double *local, const View *view, bint *facing) noexcept nogil:
        """The patch next to a point in the object frame, of those that face the sensor, and whether it does."""
        cdef int a, j, best = -1
        cdef int place[3]
        cdef double d, x, y, z, square, least = INFINITY
        cdef double q[3]
        cdef const double *s = view.scaled
        cdef const double *p
        cdef const int *near
        for a in range(3):
            q[a] = local[a] * view.scale[a]
            d = (q[a] - self.first[a]) / self.spacing
            place[a] = 0 if not d > 0.0 else (
                <int> self.grid.shape[a] - 1 if d > self.grid.shape[a] - 1 else <int> (d + 0.5)
            )
        near = &self.neighbours[self.grid[place[0], place[1], place[2]], 0]
        for j in range(self.neighbours.shape[1]):
            p = &self.patches[near[j], 0]
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            square = x * x + y * y + z * z
            if square < least and s[0] * p[3] + s[1] * p[4] + s[2] * p[5] > p[6]:
                least, best = square, near[j]
        facing[0] = best >= 0
        return best if best >= 0 else near[0]

    cdef double off(self, int k, const double *local, const double *x) noexcept nogil:
        """Distance of a point in the object frame from the plane of a patch, metres."""
        cdef int n
        cdef const double *p = &self.patches[k, 0]
        cdef double found = local[0] * p[3] + local[1] * p[4] + local[2] * p[5] - p[6]
        for n in range(self.coefficients):
            found -= self.along_normal[k, n] * x[n]
        return found

    cdef void trace(self, const double *x, const View *view, const double *unit, double *met) noexcept nogil:
        """Where a ray meets the surface, object frame; of one that misses it, where it is near."""
        cdef int a, k, step
        cdef double middle, one, other, ray, enters = -INFINITY, leaves = INFINITY, at = 0.0, slope, moved
        cdef const double *p
        cdef bint facing
        for a in range(3):
            middle = view.middle if a == 1 else 0.0
            ray = unit[a] if fabs(unit[a]) > 1e-9 else 1e-9
            one = (middle - view.half[a] - view.sensor[a]) / ray
            other = (middle + view.half[a] - view.sensor[a]) / ray
            enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
            at += unit[a] * (middle - view.sensor[a])
        if leaves > max(enters, 0.0):
            at = max(enters, 0.0)
        for step in range(STEPS):
            for a in range(3):
                met[a] = view.sensor[a] + at * unit[a]
            k = self.nearest(met, view, &facing)
            p = &self.patches[k, 0]
            slope = p[3] * unit[0] + p[4] * unit[1] + p[5] * unit[2]
            if facing and slope < -LEAST_COSINE:
                moved = -self.off(k, met, x) / slope
                at += min(max(moved, -LONGEST_STEP), LONGEST_STEP)
        for a in range(3):
            met[a] = view.sensor[a] + at * unit[a]

    cdef double elsewhere(self, int i, const double *local, const View *view, double far) noexcept nogil:
        """How dense points that are anything else are, by the ray through a cuboid in the vehicle."""
        cdef int a
        cdef double half, middle, inverse, inside, noise, past, before, deep
        cdef double enters = -INFINITY, leaves = INFINITY
        for a in range(3):
            inverse = local[a] - view.sensor[a]
            inverse = 1.0 / (inverse if fabs(inverse) > 1e-9 else 1e-9)
            middle = ((view.middle if a == 1 else 0.0) - view.sensor[a]) * inverse
            half = self.odds[5] * view.half[a] * fabs(inverse)
            enters, leaves = max(enters, middle - half), min(leaves, middle + half)
        if not leaves > max(enters, 0.0):
            return self.odds[8] if self.along[i] == 0.0 and self.goes_on(local, view) else 1.0
        if self.along[i] > 0.0:
            noise, past = self.along[i] / SOFTNESS, (1.0 - enters) * far
            before = 1.0 / (1.0 + exp(min(max(past / noise, -50.0), 50.0)))
            deep = 1.0 / (1.0 + exp(min(max((self.odds[4] - past) / noise, -50.0), 50.0)))
            return 1.0 + before * (self.odds[2] - 1.0) + deep * (self.odds[3] - 1.0)
        inside = (min(leaves, 1.0) - max(enters, 0.0)) * far
        if inside > self.odds[4]:
            return self.odds[3]
        return self.odds[2] if enters >= 1.0 else 1.0

    cdef bint goes_on(self, const double *local, const View *view) noexcept nogil:
        """Whether a point is on the plane of a side that the sensor sees, just beyond that side's edges."""
        cdef int side, other
        cdef double past, height = -local[1], tall = 2.0 * view.half[1]
        if not (height > LOW and height < tall + self.odds[9]):
            return False
        for side in range(0, 3, 2):
            other = 2 - side
            if fabs(view.sensor[side]) <= view.half[side]:
                continue
            past = view.half[side] if view.sensor[side] > 0.0 else -view.half[side]
            if fabs(local[side] - past) >= ON_SIDE:
                continue
            past = fabs(local[other]) - view.half[other]
            if past < self.odds[9] and (past > CLEAR or height > tall + CLEAR):
                return True
        return False

    cdef int measure(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const View *view,
        double *local, double *gain, double *beyond, double *wrong, double *sigma, double *off
    ) noexcept nogil:
        """The patch next to a point, the point in the object frame, and its distance from the patch's plane, metres.

        The density of a right point there is vehicle * gain * exp(-beyond / 2); it is none where the gain is zero.
        Then the density of a wrong one, and the deviation of the distance.
        """
        cdef int a, n, k
        cdef double unit[3]
        cdef double met[3]
        cdef double d, square = 0.0, along = 0.0, tangent, far = 0.0, cosine, across, reach
        cdef const double *p
        cdef bint facing, deep = self.along[i] > 0.0
        self.place(i, R, t, shared, local)
        for a in range(3):
            unit[a], met[a] = local[a] - view.sensor[a], local[a]
            far += unit[a] * unit[a]
        far = sqrt(far)
        wrong[0] = self.elsewhere_peak[i] * self.elsewhere(i, local, view, far)
        gain[0], beyond[0], sigma[0], off[0] = 0.0, 0.0, self.sigma[i], 0.0
        if deep:
            for a in range(3):
                unit[a] /= max(far, 1e-9)
            self.trace(x, view, unit, met)
        else:  # far from the vehicle's cuboid it is on no patch
            reach = self.odds[6] + FARTHEST * self.odds[7] + OUTSIDE
            if (
                fabs(local[0]) > view.half[0] + reach
                or fabs(local[1] - view.middle) > view.half[1] + reach
                or fabs(local[2]) > view.half[2] + reach
            ):
                return 0
        k = self.nearest(met, view, &facing)
        p = &self.patches[k, 0]
        for a in range(3):
            d = met[a] - p[a]
            for n in range(self.coefficients):
                d -= self.basis[k, 3 * n + a] * x[n]
            along += d * p[3 + a]
            square += d * d
        off[0] = along
        if deep:
            off[0] = self.off(k, local, x)
            cosine = fabs(unit[0] * p[3] + unit[1] * p[4] + unit[2] * p[5])
            across = self.along[i] * cosine
            sigma[0] = sqrt(self.sigma[i] * self.sigma[i] + across * across)
        if not facing:
            return k
        tangent = sqrt(max(square - along * along, 0.0))
        tangent = max(tangent - self.odds[6], 0.0) / self.odds[7]
        beyond[0], gain[0] = tangent * tangent, 1.0
        if deep:
            gain[0] = cosine * sqrt(self.sigma[i] * self.sigma[i] + self.along[i] * self.along[i]) / sigma[0]
        return k

    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const View *view,
        double *local, double *right, double *wrong, double *sigma
    ) noexcept nogil:
        """The patch next to a point, the point in the object frame, the densities, and the deviation of its distance."""
        cdef double gain, beyond, off
        cdef int k = self.measure(i, R, t, x, shared, view, local, &gain, &beyond, wrong, sigma, &off)
        right[0] = self.vehicle * gain * exp(-0.5 * beyond) if gain > 0.0 else 0.0
        return k

    cdef double add(
        self, const double *R, const double *t, const double *x, double most, double *g, double *M, double *J
    ) noexcept nogil:
        cdef int i, k, a, count = 0, D = 6 + self.coefficients
        cdef View view
        cdef double weights[4]
        cdef double off[4]
        cdef double *row
        cdef double local[3]
        cdef double gain, beyond, wrong, sigma, r, inlier, density, scale, product = 1.0, energy = 0.0
        cdef const double *n
        most /= self.share
        self.prepare(R, t, x, &view)
        for i in range(self.count):
            k = self.measure(i, R, t, x, &NOTHING[0], &view, local, &gain, &beyond, &wrong, &sigma, &r)
            r, inlier = r / sigma, 0.0
            if gain > 0.0 and beyond + r * r < NOT_THERE:
                inlier = self.vehicle * gain * exp(-0.5 * (beyond + r * r))
            density = inlier + wrong
            product *= density * self.inverse_best[i]
            if product < ROUNDED or i == self.count - 1:  # one logarithm for many points
                energy -= log(product)
                product = 1.0
                if energy > most:
                    return INFINITY
            if J == NULL or inlier <= 1e-6 * density:
                continue
            weights[count], off[count], row, n = inlier / density * self.share, r, J + count * D, &self.patches[k, 3]
            scale = 1.0 / sigma
            row[0] = scale * (n[1] * local[2] - n[2] * local[1])
            row[1] = scale * (n[2] * local[0] - n[0] * local[2])
            row[2] = scale * (n[0] * local[1] - n[1] * local[0])
            for a in range(3):
                row[3 + a] = -scale * (R[3 * a] * n[0] + R[3 * a + 1] * n[1] + R[3 * a + 2] * n[2])
            for a in range(self.coefficients):
                row[6 + a] = -scale * self.along_normal[k, a]
            count += 1
            if count == 4:
                add_four(J, weights, off, D, g, M)
                count = 0
        if count:
            memset(J + count * D, 0, (4 - count) * D * sizeof(double))
            for a in range(count, 4):
                weights[a] = off[a] = 0.0
            add_four(J, weights, off, D, g, M)
        return self.share * energy

    def match(
        self, const double[:, :] rotation, const double[:] translation, const double[:] coefficients,
        const double[::1] shared
    ):
        """Patches (M,), densities of right points (M,) and of wrong ones (M,), and deviations (M,) at a state."""
        cdef double R[9]
        cdef double t[3]
        cdef View view
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
        self.prepare(R, t, at, &view)
        for i in range(self.count):
            patches[i] = self.match_one(i, R, t, at, &shared[0], &view, local, &r[i], &w[i], &s[i])
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
            energy -= log(self.inverse_best[i] * (inlier + wrong[i]))
        return weights, self.share * energy

    cdef void row(
        self, int i, int k, const double *R, const double *local, const double *shared, double factor, double *J
    ) noexcept nogil:
        """A derivative times a factor: by turn, object's axes, coefficients, and what the points share."""
        cdef int a, b, N = self.coefficients
        cdef double ratio, along = 0.0, scale
        cdef const double *n = &self.patches[k, 3]
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

    It judges the weights (M,) of the points, and keeps what they share (2,) where it did.

    Attributes:
        points: The points.
        form: How the mixture is handed to the solver, as `factors.mixture.Form`; without a Jacobian it is the loss.
        share: Factor on the energy.
    """

    cdef readonly Points points
    cdef public int form
    cdef public double share, common
    cdef int matches  # how often points were matched
    cdef double[::1] matched_at  # pose (12,), coefficients and what points share (2,), where that was last
    cdef Py_ssize_t[::1] patch
    cdef double[::1] right, wrong, sigma, weights

    def __init__(self, Points points, double share):
        """Bind the points."""
        cdef int M = points.count, N = points.coefficients
        self.points, self.share, self.common, self.form, self.rows, self.matches = points, share, 1.0, NEWTON, M, 0
        self.judged, self.matched_at = M + 2, np.zeros(14 + N)
        self.patch, self.right, self.wrong = np.zeros(M, dtype=np.intp), np.zeros(M), np.ones(M)
        self.sigma, self.weights = np.ones(M), np.zeros(M)
        self.take([(12, 6, True), (N, N, True)] + ([] if points.shared == NONE else [(2, 2, True)]))

    @property
    def matched(self):
        """Patches (M,), densities of right points (M,) and of wrong ones (M,), and deviations (M,), as they are set."""
        return np.array(self.patch), np.array(self.right), np.array(self.wrong), np.array(self.sigma)

    def look(self, const double[::1] pose, const double[::1] x, const double[::1] shared, bint look):
        """The same as `judge` at a pose (12,), coefficients (N,), and what the points share (2,)."""
        cdef const double *at[8]
        cdef double[::1] found = np.empty(self.judged)
        if pose.shape[0] != 12 or x.shape[0] != self.points.coefficients or shared.shape[0] != 2:
            raise ValueError("a pose (12,), coefficients (N,) and two numbers are expected")
        at[0], at[1], at[2] = &pose[0], &x[0] if x.shape[0] else NULL, &shared[0]
        self.judge(at, look, &found[0])
        return np.asarray(found)

    cdef const double *shared_of(self, const double **at) noexcept nogil:
        return &NOTHING[0] if self.points.shared == NONE else at[2]

    cdef bint is_near(self, const double *pose, const double *x, const double *shared) noexcept nogil:
        """Whether that is so near to where points were matched that they keep their patches."""
        cdef double near = min(NEAR * NEARER ** self.matches, NEAREST), most = near * near
        cdef const double *there = &self.matched_at[0]
        cdef int N = self.points.coefficients
        return (
            apart(pose, there, 9) < most
            and apart(pose + 9, there + 9, 3) < most
            and 0.01 * apart(x, there + 12, N) < most
            and apart(shared, there + 12 + N, 2) < most
        )

    cdef void match(self, const double *pose, const double *x, const double *shared) noexcept nogil:
        """Match the points at a state."""
        cdef int i, N = self.points.coefficients
        cdef View view
        cdef double local[3]
        self.points.prepare(pose, pose + 9, x, &view)
        for i in range(self.rows):
            self.patch[i] = self.points.match_one(
                i, pose, pose + 9, x, shared, &view, local, &self.right[i], &self.wrong[i], &self.sigma[i]
            )
        memcpy(&self.matched_at[0], pose, 12 * sizeof(double))
        if N:
            memcpy(&self.matched_at[12], x, N * sizeof(double))
        memcpy(&self.matched_at[12 + N], shared, 2 * sizeof(double))
        self.matches += 1

    cdef void weigh(self, const double **at) noexcept nogil:
        """Weigh the points, as they are matched."""
        cdef int i
        cdef double local[3]
        cdef double d, inlier
        for i in range(self.rows):
            self.weights[i] = 0.0
            if self.right[i] > 0.0:
                self.points.place(i, at[0], at[0] + 9, self.shared_of(at), local)
                d = self.points.off(self.patch[i], local, at[1]) / self.sigma[i]
                inlier = self.right[i] * exp(-0.5 * d * d)
                self.weights[i] = inlier / (inlier + self.wrong[i])

    cdef void judge(self, const double **at, bint look, double *found) noexcept nogil:
        if self.matches == 0 or (look and not self.is_near(at[0], at[1], self.shared_of(at))):
            self.match(at[0], at[1], self.shared_of(at))
        self.weigh(at)
        memcpy(found, &self.weights[0], self.rows * sizeof(double))
        memcpy(found + self.rows, &self.matched_at[12 + self.points.coefficients], 2 * sizeof(double))

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *R = at[0]
        cdef const double *t = at[0] + 9
        cdef const double *x = at[1]
        cdef const double *shared = self.shared_of(at)
        cdef int i, k
        cdef double local[3]
        cdef double d, loss, stretch, bend, energy = 0.0, root = sqrt(self.share)
        cdef int form = self.form if J != NULL or self.form == WEIGHTED else LOSS
        if self.matches == 0:
            self.match(R, x, shared)
            self.weigh(at)
        for i in range(self.rows):
            self.points.place(i, R, t, shared, local)
            k = self.patch[i]
            d = self.points.off(k, local, x) / self.sigma[i]
            mixed(form, self.right[i], self.wrong[i], self.weights[i] / self.common, d * d, &stretch, &bend, &loss)
            energy += loss
            r[i] = root * stretch * d
            if J != NULL and bend != 0.0:
                self.points.row(i, k, R, local, shared, bend * root / self.sigma[i], J + i * self.columns)
        return NAN if self.form == WEIGHTED else self.share * energy
