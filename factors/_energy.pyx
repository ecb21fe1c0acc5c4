# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""The energy that an image makes of a vehicle, compiled: rows for the graph, assessments of a state, the search.

The equations are those of `factors.projection`, `factors.keypoint_rows`, `factors.box`, `factors.ground` and
`factors.mixture`, and of `fgrecon.solve.proposals.search`; what costs in their numpy versions is a call for every few
numbers, not the arithmetic. Arrays are checked where they come in, inside nothing is. Poses come as R (9,), row by row,
and t (3,); lambda as x (N,).
"""

from libc.math cimport INFINITY, atan2, cos, exp, fabs, floor, log, sin, sqrt
from libc.string cimport memcpy, memset

import numpy as np

from factors._points cimport Term
from factors._rows cimport Source
from factors.box import FARTHEST_SHARE, NEAREST_KINK
from factors.mixture import STIFFEST
from factors.projection import LEAST_DEPTH, SHALLOWEST

cdef extern from *:
    """
    /* Without fused products, which round otherwise. */
    #if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
    #define FGRECON_WIDE __attribute__((target_clones("avx2", "default")))
    #else
    #define FGRECON_WIDE
    #endif
    #if defined(_MSC_VER)
    #define restrict __restrict
    #endif

    /* `project` of points (P, 3): pixels (2, P), their derivatives G (6, P) unless it is NULL, and depths (P,). */
    FGRECON_WIDE static void fgrecon_pixels(
        const double *restrict C, const double *restrict R, const double *restrict t, const double *restrict X, int P,
        double least, double *restrict U, double *restrict G, double *restrict depths
    ) {
        for (int p = 0; p < P; p++) {
            const double *at = X + 3 * p;
            double x = R[0] * at[0] + R[1] * at[1] + R[2] * at[2] + t[0];
            double y = R[3] * at[0] + R[4] * at[1] + R[5] * at[2] + t[1];
            const double depth = R[6] * at[0] + R[7] * at[1] + R[8] * at[2] + t[2];
            const double inverse = 1.0 / (depth > least ? depth : least);
            x *= inverse;
            y *= inverse;
            U[p] = C[0] * x + C[1] * y + C[2];
            U[P + p] = C[4] * y + C[5];
            depths[p] = depth;
            if (G != NULL) {
                G[p] = C[0] * inverse;
                G[P + p] = C[1] * inverse;
                G[2 * P + p] = -(C[0] * x + C[1] * y) * inverse;
                G[3 * P + p] = 0.0;
                G[4 * P + p] = C[4] * inverse;
                G[5 * P + p] = -C[4] * y * inverse;
            }
        }
    }

    /* Add to a row (N,) the product of h (3,) and a basis (3, N). */
    static inline void fgrecon_along(const double *h, const double *restrict basis, int N, double *restrict row) {
        const double a = h[0], b = h[1], c = h[2];
        for (int n = 0; n < N; n++) row[n] = row[n] + a * basis[n] + b * basis[N + n] + c * basis[2 * N + n];
    }
    """
    void along "fgrecon_along"(const double *h, const double *basis, int N, double *row) nogil
    void pixels "fgrecon_pixels"(
        const double *C, const double *R, const double *t, const double *X, int P, double least, double *U, double *G,
        double *depths
    ) nogil
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef double PI = 3.14159265358979323846
cdef double LEAST = LEAST_DEPTH, FARTHEST = FARTHEST_SHARE, NEAREST = NEAREST_KINK, STIFF = STIFFEST, SHALLOW = SHALLOWEST

cdef enum Form:  # as `factors.mixture.Form`
    WEIGHTED = 0
    LOSS = 1
    NEWTON = 2
    MAJORISED = 3


cdef inline double project(
    const double *C, const double *R, const double *t, const double *X, double least, double *uv, double *G
) noexcept nogil:
    """Pixel of an object point X, and in G (2, 3), unless it is NULL, its derivative by the camera point; returns the
    true depth."""
    cdef double x = R[0] * X[0] + R[1] * X[1] + R[2] * X[2] + t[0]
    cdef double y = R[3] * X[0] + R[4] * X[1] + R[5] * X[2] + t[1]
    cdef double depth = R[6] * X[0] + R[7] * X[1] + R[8] * X[2] + t[2]
    cdef double inverse = 1.0 / (depth if depth > least else least)
    x *= inverse
    y *= inverse
    uv[0] = C[0] * x + C[1] * y + C[2]
    uv[1] = C[4] * y + C[5]
    if G != NULL:
        G[0] = C[0] * inverse
        G[1] = C[1] * inverse
        G[2] = -(C[0] * x + C[1] * y) * inverse
        G[3] = 0.0
        G[4] = C[4] * inverse
        G[5] = -C[4] * y * inverse
    return depth


cdef inline void turned(const double *g, const double *R, double *h) noexcept nogil:
    """h = g R: a derivative by the camera point as one by the object point."""
    cdef int a
    for a in range(3):
        h[a] = g[0] * R[a] + g[1] * R[3 + a] + g[2] * R[6 + a]


cdef inline void cross(const double *a, const double *b, double *c) noexcept nogil:
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]


cdef inline void mixture(double right, double wrong, double s, double *weight, double *loss) noexcept nogil:
    """Weight and loss of a squared distance s among points that are right or wrong (`factors.mixture`)."""
    cdef double e
    if right <= 0.0:
        weight[0] = 0.0
        loss[0] = 0.0
        return
    if wrong <= 0.0:
        weight[0] = 1.0
        loss[0] = 0.5 * s
        return
    e = right * exp(-0.5 * s)
    weight[0] = e / (e + wrong)
    loss[0] = log((right + wrong) / (e + wrong))


cdef inline void robust(
    int form, double right, double wrong, double s, double *stretch, double *weight, double *bend, double *loss
) noexcept nogil:
    """Factor on a residual of squared length s, root of its weight, what is taken off along it (`factors.mixture`); and
    its loss."""
    cdef double w, rest
    bend[0] = 0.0
    if form == WEIGHTED:
        stretch[0] = weight[0] = sqrt(right)
        loss[0] = 0.5 * right * s
        return
    mixture(right, wrong, s, &w, loss)
    weight[0] = sqrt(w)
    if form == LOSS:
        stretch[0] = sqrt(2.0 * loss[0] / s) if s > 0.0 else weight[0]
        return
    if form == MAJORISED:
        stretch[0] = weight[0]
        return
    rest = 1.0 - (1.0 - w) * s
    rest = sqrt(rest if rest > STIFF else STIFF)
    bend[0] = 1.0 - rest
    stretch[0] = weight[0] / rest


cdef inline void add(const double *J, int width, double r, double weight, double *g, double *M, int D) noexcept nogil:
    """Add a row of `width` columns to gradient and lower triangle."""
    cdef int a, b
    cdef double j
    for a in range(width):
        j = weight * J[a]
        g[a] += j * r
        for b in range(a + 1):
            M[a * D + b] += j * J[b]


cdef inline double kink(double behind, double softness) noexcept nogil:
    """Curvature of the parabola that touches a soft maximum here and lies nowhere below it (`factors.box.kink`)."""
    cdef double e
    behind /= softness
    behind = behind if behind > NEAREST else NEAREST
    e = exp(-behind)
    return (0.5 * (1.0 - e) / (1.0 + e) + behind * e / ((1.0 + e) * (1.0 + e))) / (behind * softness)


cdef inline void lever(const double *X, const double *g, const double *R, double *h, double *turn) noexcept nogil:
    """A derivative g by the camera point of X as one by the object point, h, and by a turn about the object's axes."""
    turned(g, R, h)
    cross(X, h, turn)


cdef inline void placed(const double *by, double weight, const double *R, int N, double *J) noexcept nogil:
    """A weighted row J (6 + N) of a derivative whose shift is along the camera's axes: along the object's."""
    cdef int a, n
    cdef double along[3]
    turned(by + 3, R, along)
    for a in range(3):
        J[a] = weight * by[a]
        J[3 + a] = weight * along[a]
    for n in range(N):
        J[6 + n] = weight * by[6 + n]


cdef inline void shaped(
    const double *mean, const double[:, ::1] basis, int k, const double *x, const double *offsets, double *X
) noexcept nogil:
    """Point k of a linear shape (P, 3), (N, 3P) at coefficients x (N,), with its offset where there are any."""
    cdef int a, n
    for a in range(3):
        X[a] = mean[3 * k + a]
        if offsets != NULL:
            X[a] += offsets[3 * k + a]
    for n in range(basis.shape[0]):
        for a in range(3):
            X[a] += x[n] * basis[n, 3 * k + a]


cdef void unpack(const double[:, :] pose, double *R, double *t) noexcept:
    cdef int i  # R (9,) and t (3,) of a pose (4, 4)
    for i in range(9):
        R[i] = pose[i // 3, i % 3]
    for i in range(3):
        t[i] = pose[i, 3]


cdef class Measured:
    """What one sensor beside the keypoints measured, and what others did."""

    cdef Term term
    cdef Measured others

    def __init__(self, Term term not None, Measured others):
        """Bind a term, and others or None."""
        self.term, self.others = term, others

    cdef double add(
        self, const double *R, const double *t, const double *x, double most, double *g, double *M, double *J
    ) noexcept nogil:
        """As `Term.add` has it, of all of them."""
        cdef double energy = self.term.add(R, t, x, most, g, M, J)
        if self.others is not None and energy < most:
            energy += self.others.add(R, t, x, most - energy, g, M, J)
        return energy


cdef class Observation:
    """What is observed of a vehicle in an image, and how its residuals follow from pose and shape.

    Rows are, in this order: two for each of the K keypoints, four for the box's edges, one for the height over the
    ground, three for the lean, four for creases of the outline. What does not apply is zero.
    """

    cdef readonly int keypoints, coefficients, points, rows
    cdef const double[:, ::1] camera, mean, basis, pixels, whitener, outline, outline_basis
    cdef const double[:, :, ::1] outline_by_point  # (P, 3, N) the basis again
    cdef const double[::1] edges, normal, direction
    cdef const unsigned char[::1] used
    cdef double box_sigma, box_wrong, softness, distance, height_sigma, slope_sigma, tilt_sigma
    cdef bint has_box, has_ground
    cdef const double[:, :, ::1] table
    cdef const double[:, ::1] seen_from
    cdef const double[::1] elevations
    cdef const double[::1] right, outlier
    cdef const unsigned char[::1] measured
    cdef double gross, missed, false_alarm
    cdef const double[:, ::1] size_basis
    cdef const double[::1] size_mean
    cdef const double[::1] size_sigma
    cdef bint has_size, has_direction, is_bound
    cdef Measured measured_beside

    def __reduce__(self):
        """Pointers into arrays are not copied.

        Raises:
            TypeError: Always; who holds it makes another.
        """
        raise TypeError("a compiled Observation cannot be copied or pickled")

    def __init__(self, camera, mean, basis, pixels, whitener, box, ground):
        """Bind the arrays; `factors.observation_rows.ObservationRows` says what they are.

        Args:
            camera: (3, 3). mean: (K, 3). basis: (N, 3K). pixels: (K, 2). whitener: (K, 3) lower triangular.
            box: None, or (points (P, 3), basis (N, 3P), the same as (P, 3, N), edges (4,), used (4,), sigma, wrong,
                softness).
            ground: None, or (normal (3,), distance, height sigma, slope sigma, tilt sigma).
        """
        self.camera, self.mean, self.basis, self.pixels, self.whitener = camera, mean, basis, pixels, whitener
        self.keypoints, self.coefficients = len(mean), len(basis)
        self.rows = 2 * self.keypoints + 12
        self.has_box, self.has_ground = box is not None, ground is not None
        self.has_size = self.has_direction = self.is_bound = False
        if box is not None:
            self.outline, self.outline_basis, self.outline_by_point, self.edges, self.used = box[:5]
            self.box_sigma, self.box_wrong, self.softness = box[5], box[6], box[7]
            self.points = len(box[0])
        if ground is not None:
            self.normal = ground[0]
            self.distance, self.height_sigma, self.slope_sigma, self.tilt_sigma = ground[1:]
        sizes = [self.camera.shape[0] == 3, self.camera.shape[1] == 3, self.mean.shape[1] == 3,
                 self.basis.shape[1] == 3 * self.keypoints, self.pixels.shape[0] == self.keypoints,
                 self.pixels.shape[1] == 2, self.whitener.shape[0] == self.keypoints, self.whitener.shape[1] == 3]
        if box is not None:
            sizes += [self.outline.shape[1] == 3, self.outline_basis.shape[0] == self.coefficients,
                      self.outline_basis.shape[1] == 3 * self.points, self.edges.shape[0] == 4,
                      self.outline_by_point.shape[0] == self.points, self.outline_by_point.shape[1] == 3,
                      self.outline_by_point.shape[2] == self.coefficients,
                      self.used.shape[0] == 4]
        if ground is not None:
            sizes += [self.normal.shape[0] == 3]
        if not all(sizes):
            raise ValueError(f"arrays that do not belong together: {sizes}")

    def search_by(self, right, outlier, measured, mix, table, seen_from, elevations, size, direction):
        """Bind what the search needs beside: evidence, visibility, size and direction.

        Args:
            right: (K,). outlier: (K,). measured: (K,) bytes. mix: gross, missed, false_alarm.
            table: (K, A, E) visibility. seen_from: (K, 3). elevations: (E,).
            size: None, or (mean (3,), basis (3, N), prior's sigma (3,)), the mean relative to the prior's.
            direction: None, or (A,) energies in nats of directions evenly spaced over the circle.
        """
        self.right, self.outlier, self.measured = right, outlier, measured
        self.gross, self.missed, self.false_alarm = mix
        self.table, self.seen_from, self.elevations = table, seen_from, elevations
        self.has_size = size is not None
        if size is not None:
            self.size_mean, self.size_basis, self.size_sigma = size
        self.has_direction = direction is not None
        if direction is not None:
            self.direction = direction
        sizes = [self.right.shape[0] == self.keypoints, self.outlier.shape[0] == self.keypoints,
                 self.measured.shape[0] == self.keypoints, self.table.shape[0] == self.keypoints,
                 self.seen_from.shape[0] == self.keypoints, self.seen_from.shape[1] == 3, self.table.shape[1] > 1,
                 self.elevations.shape[0] == self.table.shape[2], self.table.shape[2] > 1]
        if direction is not None:
            sizes += [self.direction.shape[0] > 0]
        if size is not None:
            sizes += [self.size_mean.shape[0] == 3, self.size_basis.shape[0] == 3, self.size_sigma.shape[0] == 3,
                      self.size_basis.shape[1] == self.coefficients]
        if not all(sizes):
            raise ValueError(f"arrays that do not belong together: {sizes}")
        self.is_bound = True

    def search_beside(self, terms):
        """Bind terms of other sensors, a list of `factors._points.Term`, which the search has as well."""
        for one in terms:
            self.measured_beside = Measured(one, self.measured_beside)

    cdef double keypoint(
        self, int k, const double *R, const double *t, const double *x, const double *offsets, double least,
        double *r, double *X, double *camera, double *body
    ) noexcept nogil:
        """Whitened residual r (2,) of keypoint k, and its derivatives (2, 3) by camera and object point; the depth."""
        cdef double uv[2]
        cdef double G[6]
        cdef double a = self.whitener[k, 0], b = self.whitener[k, 1], c = self.whitener[k, 2], depth
        cdef int i
        shaped(&self.mean[0, 0], self.basis, k, x, offsets, X)
        depth = project(&self.camera[0, 0], R, t, X, least, uv, G)
        uv[0] -= self.pixels[k, 0]
        uv[1] -= self.pixels[k, 1]
        r[0] = a * uv[0]
        r[1] = b * uv[0] + c * uv[1]
        for i in range(3):
            camera[i] = a * G[i]
            camera[3 + i] = b * G[i] + c * G[3 + i]
        turned(camera, R, body)
        turned(camera + 3, R, body + 3)
        return depth

    cdef double box(
        self, const double *R, const double *t, const double *x, double least, double *r, double *J, double *crease,
        double *work
    ) noexcept nogil:
        """Whitened residuals (4,) of the box's edges, and where J is given their derivatives (4, 6 + N) by a turn about
        the object's axes, a shift along the camera's, and the coefficients; likewise the rows (4, 6 + N) of creases
        (`factors.box.crease_rows`); the least depth."""
        cdef int e, i, p, n, a, b, count, N = self.coefficients, P = self.points, D = 6 + self.coefficients
        cdef double *U = work  # (2, P) pixels, (6, P) their derivatives, (P, 3) object points
        cdef double *G = U + 2 * P
        cdef double *X = G + 6 * P
        cdef double *share = X + 3 * P  # of the points that have a share in an extent; how far they are
        cdef double *away = share + P  # from the outermost one, in softnesses; and which they are
        cdef int *which = <int *> (away + P)
        cdef double extreme[4]
        cdef double g[3]
        cdef double h[3]
        cdef double moment[9]
        cdef double sign, total, mean, behind, farthest = -FARTHEST * self.softness, nearest = INFINITY
        for e in range(4):
            extreme[e] = -INFINITY
        memcpy(X, &self.outline[0, 0], 3 * P * sizeof(double))
        for n in range(N):
            for i in range(3 * P):
                X[i] += x[n] * self.outline_basis[n, i]
        pixels(&self.camera[0, 0], R, t, X, P, least, U, G if J != NULL else NULL, share)
        for p in range(P):
            nearest = share[p] if share[p] < nearest else nearest
            for a in range(2):
                extreme[a] = -U[a * P + p] if -U[a * P + p] > extreme[a] else extreme[a]
                extreme[2 + a] = U[a * P + p] if U[a * P + p] > extreme[2 + a] else extreme[2 + a]
        for e in range(4):
            sign = -1.0 if e < 2 else 1.0
            count = 0
            for p in range(P):
                behind = sign * U[(e % 2) * P + p] - extreme[e]
                if behind > farthest:
                    away[count], which[count] = behind, p
                    count += 1
            total = mean = 0.0
            for i in range(count):
                away[i] /= self.softness
                share[i] = exp(away[i])
                total += share[i]
                mean += share[i] * away[i]
            mean /= total
            r[e] = (sign * (extreme[e] + self.softness * mean) - self.edges[e]) / self.box_sigma
            if J == NULL:
                continue
            memset(J + e * D, 0, D * sizeof(double))
            memset(moment, 0, 9 * sizeof(double))
            for i in range(count):
                p = which[i]
                share[i] *= (1.0 + away[i] - mean) / (total * self.box_sigma)
                for a in range(3):
                    g[a] = share[i] * G[(3 * (e % 2) + a) * P + p]
                    J[e * D + 3 + a] += g[a]
                    for b in range(3):
                        moment[3 * b + a] += X[3 * p + b] * g[a]
                if N:
                    turned(g, R, h)
                    along(h, &self.outline_by_point[p, 0, 0], N, J + e * D + 6)
            for a in range(3):  # sum of X x (g R), from the sums of X g'
                turned(moment + 3 * a, R, h)
                J[e * D + (a + 2) % 3] += h[(a + 1) % 3]
                J[e * D + (a + 1) % 3] -= h[(a + 2) % 3]
            if crease != NULL:
                memset(crease + e * D, 0, D * sizeof(double))
                if sign * r[e] > 0.0:
                    self.crease(e, sign * r[e], R, U, G, X, crease + e * D)
        return nearest

    cdef void crease(
        self, int e, double beyond, const double *R, const double *U, const double *G, const double *X, double *row
    ) noexcept nogil:
        """The row (6 + N,) of an edge that the outline is beyond by so many sigmas."""
        cdef int p, a, n, first = 0, second = -1, P = self.points
        cdef double sign = -1.0 if e < 2 else 1.0, share, stiff, length, most = 0.0, stiffness = 0.0
        cdef double first_h[3]
        cdef double first_turn[3]
        cdef double h[3]
        cdef double turn[3]
        cdef double g[3]
        cdef double first_g[3]
        U += (e % 2) * P  # of the edge's axis
        G += 3 * (e % 2) * P
        for p in range(P):
            first = p if sign * U[p] > sign * U[first] else first
        for a in range(3):
            g[a] = first_g[a] = G[a * P + first]
        lever(X + 3 * first, g, R, first_h, first_turn)
        for p in range(P):
            for a in range(3):
                g[a] = G[a * P + p]
            lever(X + 3 * p, g, R, h, turn)
            length = 0.0
            for a in range(3):
                length += (turn[a] - first_turn[a]) * (turn[a] - first_turn[a])
            stiff = kink(sign * U[first] - sign * U[p], self.softness)
            if stiff * length > most:
                most, stiffness, second = stiff * length, stiff, p
        if second < 0:
            return
        for a in range(3):
            g[a] = G[a * P + second]
        lever(X + 3 * second, g, R, h, turn)
        share = sqrt(beyond / self.box_sigma * stiffness)
        for a in range(3):
            row[a] = share * (first_turn[a] - turn[a])
            row[3 + a] = share * (first_g[a] - g[a])
            for n in range(self.coefficients):
                row[6 + n] += share * (
                    first_h[a] * self.outline_basis[n, 3 * first + a] - h[a] * self.outline_basis[n, 3 * second + a]
                )

    cdef void ground(
        self, const double *R, const double *t, double height_sigma, double *r, double *turn, double *shift
    ) noexcept nogil:
        """Whitened residuals (4,) of height and lean, their derivatives (4, 3) by the turn, and (3,) of the first by
        the shift along the camera's axes."""
        cdef int a
        r[0] = -self.distance
        for a in range(3):
            r[0] += self.normal[a] * t[a]
            r[1 + a] = (R[3 * a + 1] - self.normal[a]) / self.tilt_sigma
            shift[a] = self.normal[a] / height_sigma
            turn[a] = 0.0
            turn[3 + 3 * a] = R[3 * a + 2] / self.tilt_sigma
            turn[4 + 3 * a] = 0.0
            turn[5 + 3 * a] = -R[3 * a] / self.tilt_sigma
        r[0] /= height_sigma

    cdef double height_sigma_at(self, double depth) noexcept nogil:
        """Standard deviation of the ground's height at a depth, metres."""
        return sqrt(self.height_sigma * self.height_sigma + self.slope_sigma * self.slope_sigma * depth * depth)

    cdef void visible(self, const double *R, const double *t, double *visibility) noexcept nogil:
        """Visibility (K,) of the keypoints from a pose (`fgrecon.solve.vehicle.visibility.VisibilityTable`)."""
        cdef int k, a, i, j, A = self.table.shape[1], E = self.table.shape[2]
        cdef double centre[3]
        cdef double x, y, z, azimuth, elevation, e, f
        for a in range(3):
            centre[a] = -(R[a] * t[0] + R[3 + a] * t[1] + R[6 + a] * t[2])
        for k in range(self.keypoints):
            x, y = centre[0] - self.seen_from[k, 0], centre[1] - self.seen_from[k, 1]
            z = centre[2] - self.seen_from[k, 2]
            azimuth = atan2(z, x)
            azimuth = (azimuth if azimuth >= 0.0 else azimuth + 2.0 * PI) / (2.0 * PI) * (A - 1)
            elevation = atan2(-y, sqrt(x * x + z * z))
            i = <int> azimuth
            i = 0 if i < 0 else (i if i < A - 2 else A - 2)  # NaN as well
            j = 0
            while j < E - 2 and elevation >= self.elevations[j + 1]:
                j += 1
            f = azimuth - i
            e = (elevation - self.elevations[j]) / (self.elevations[j + 1] - self.elevations[j])
            e = 0.0 if e < 0.0 else (1.0 if e > 1.0 else e)
            visibility[k] = (
                (1.0 - f) * ((1.0 - e) * self.table[k, i, j] + e * self.table[k, i, j + 1])
                + f * ((1.0 - e) * self.table[k, i + 1, j] + e * self.table[k, i + 1, j + 1])
            )

    def visible_from(self, const double[:, :] pose):
        """(K,) visibility of the keypoints from a pose (4, 4)."""
        cdef double R[9]
        cdef double t[3]
        cdef double[::1] visibility = np.empty(self.keypoints)
        if not self.is_bound:
            raise ValueError("bind the observation by `search_by` first")
        if pose.shape[0] != 4 or pose.shape[1] != 4:
            raise ValueError("a pose (4, 4) is expected")
        unpack(pose, R, t)
        self.visible(R, t, &visibility[0])
        return np.asarray(visibility)

    cdef void densities(self, int k, double visibility, double *right, double *wrong) noexcept nogil:
        """Densities of a right and of a wrong point k (`fgrecon.core.robust.RobustStrategy.densities`)."""
        cdef double believed, hidden, unsure
        if not self.measured[k]:
            right[0], wrong[0] = 0.0, 1.0
            return
        believed, hidden = visibility * self.right[k], 1.0 - visibility
        unsure = (visibility * self.missed + hidden * (1.0 - self.false_alarm)) * (1.0 - self.right[k])
        right[0] = believed * (1.0 - self.gross)
        wrong[0] = (believed * self.gross + unsure + hidden * self.false_alarm * self.right[k]) * self.outlier[k]

    cdef double graph_rows(
        self, const double *R, const double *t, const double *x, const double *offsets, const double *right,
        const double *wrong, const double *edges, double height_sigma, int form, double *work, double *residual,
        double *jacobian, double *energy
    ) noexcept nogil:
        """Fill residual (rows,) and, unless it is NULL, the Jacobian (rows, 6 + N + 3K), which is zero on entry.

        Args:
            R, t, x, offsets: Pose, coefficients, and offsets or NULL.
            right: (K,) densities of right points, or their weights.
            wrong: (K,) densities of wrong points.
            edges: (4,) weights of the box's edges.
            height_sigma: Of the origin over the ground, metres; 0 where that says nothing.
            form: As `factors.mixture.Form`.
            work: (14 P + 8 (6 + N),).
            residual: To fill.
            jacobian: NULL, or to fill: columns turn and shift about and along the object's axes, coefficients, offsets.
            energy: To fill: what `Form.LOSS` makes of it, nats.

        Returns:
            The least depth in metres.
        """
        cdef int K = self.keypoints, N = self.coefficients, D = 6 + N, width = 6 + N + 3 * K, a, i, k, n, row
        cdef double r[4]
        cdef double X[3]
        cdef double camera[6]
        cdef double body[6]
        cdef double turn[12]
        cdef double shift[3]
        cdef double depth, nearest = INFINITY, s, weight, loss, stretch, bend, p
        cdef double *J
        cdef double *box = work + 14 * self.points if jacobian != NULL else NULL
        cdef double *crease = box + 4 * D if jacobian != NULL and form == MAJORISED else NULL
        energy[0] = 0.0
        for k in range(K):
            depth = self.keypoint(k, R, t, x, offsets, LEAST, r, X, camera, body)
            nearest = depth if depth < nearest else nearest
            s = r[0] * r[0] + r[1] * r[1]
            robust(form, right[k], wrong[k], s, &stretch, &weight, &bend, &loss)
            energy[0] += loss
            residual[2 * k], residual[2 * k + 1] = stretch * r[0], stretch * r[1]
            if jacobian == NULL or weight == 0.0:
                continue
            p = bend / s if s > 0.0 else 0.0
            for a in range(3):  # sqrt(w) (I - bend r r' / s) on the derivatives by the object point
                loss = p * (r[0] * body[a] + r[1] * body[3 + a])
                body[a] = weight * (body[a] - r[0] * loss)
                body[3 + a] = weight * (body[3 + a] - r[1] * loss)
            for i in range(2):
                J = jacobian + (2 * k + i) * width
                cross(X, body + 3 * i, J)
                for a in range(3):
                    J[3 + a] = body[3 * i + a]
                    J[6 + N + 3 * k + a] = body[3 * i + a]
                    for n in range(N):
                        J[6 + n] += body[3 * i + a] * self.basis[n, 3 * k + a]
        row = 2 * K
        memset(residual + row, 0, 12 * sizeof(double))
        if self.has_box:
            self.box(R, t, x, LEAST, r, box, crease, work)
            for i in range(4):
                if not self.used[i]:
                    continue
                s = r[i] * r[i]
                p = edges[i] if form == WEIGHTED else 1.0
                robust(form, p, self.box_wrong, s, &stretch, &weight, &bend, &loss)
                energy[0] += loss
                residual[row + i] = stretch * r[i]
                if jacobian == NULL:
                    continue
                weight *= 1.0 - bend
                placed(box + i * D, weight, R, N, jacobian + (row + i) * width)
                if crease != NULL:
                    placed(crease + i * D, weight, R, N, jacobian + (row + 8 + i) * width)
        row += 4
        if self.has_ground and height_sigma > 0.0:
            self.ground(R, t, height_sigma, r, turn, shift)
            for i in range(4):
                residual[row + i] = r[i]
                energy[0] += 0.5 * r[i] * r[i]
            if jacobian != NULL:
                turned(shift, R, jacobian + row * width + 3)
                for i in range(4):
                    for a in range(3):
                        jacobian[(row + i) * width + a] = turn[3 * i + a]
        return nearest

    def assess(
        self, const double[:, :] pose, const double[::1] x, const double[::1] offsets, double[::1] visibility, bint look
    ):
        """What the mixture makes of a state: weights and energies.

        Args:
            pose: (4, 4) camera_T_object. x: (N,). offsets: (3K,) or None.
            visibility: (K,) to be used, or with `look` to be filled from the pose.
            look: Whether to look the visibility up.

        Returns:
            weights (K,); densities (K,) of right and of wrong points; weights (4,) of the edges; energies of keypoints
            and box in nats.
        """
        cdef int K = self.keypoints
        cdef double R[9]
        cdef double t[3]
        cdef double energies[2]
        cdef double[::1] work = np.empty(14 * self.points + 1)
        cdef double[::1] weights = np.empty(K), right = np.empty(K), wrong = np.empty(K), edges = np.empty(4)
        if not self.is_bound:
            raise ValueError("bind the observation by `search_by` first")
        if x.shape[0] != self.coefficients or visibility.shape[0] != K or pose.shape[0] != 4 or pose.shape[1] != 4:
            raise ValueError("arrays of another number of keypoints or coefficients")
        if offsets is not None and offsets.shape[0] != 3 * K:
            raise ValueError("offsets (3K,) are expected")
        unpack(pose, R, t)
        with nogil:
            self.judge(
                R, t, &x[0] if self.coefficients else NULL, &offsets[0] if offsets is not None else NULL,
                &visibility[0], look, &weights[0], &right[0], &wrong[0], &edges[0], &work[0], energies
            )
        assessed = np.asarray(weights), np.asarray(right), np.asarray(wrong), np.asarray(edges)
        return *assessed, energies[0], energies[1]

    cdef void judge(
        self, const double *R, const double *t, const double *x, const double *offsets, double *visibility, bint look,
        double *weights, double *right, double *wrong, double *edges, double *work, double *energies
    ) noexcept nogil:
        """What the mixture makes of a state; see `assess`. The energies are of keypoints and box."""
        cdef double r[4]
        cdef double X[3]
        cdef double camera[6]
        cdef double body[6]
        cdef double loss, inlier
        cdef int i, k
        energies[0] = energies[1] = 0.0
        memset(edges, 0, 4 * sizeof(double))
        if look:
            self.visible(R, t, visibility)
        for k in range(self.keypoints):
            self.keypoint(k, R, t, x, offsets, LEAST, r, X, camera, body)
            self.densities(k, visibility[k], &right[k], &wrong[k])
            weights[k] = 0.0
            if self.measured[k]:
                mixture(right[k], wrong[k], r[0] * r[0] + r[1] * r[1], &weights[k], &loss)
                energies[0] += loss - log(right[k] + wrong[k])
        if self.has_box:
            self.box(R, t, x, LEAST, r, NULL, NULL, work)
            for i in range(4):
                if self.used[i]:
                    inlier = exp(-0.5 * r[i] * r[i])
                    edges[i] = inlier / (inlier + self.box_wrong)
                    energies[1] -= log(inlier + self.box_wrong)


cdef class ImageRows(Source):
    """Rows of an observation in a graph: of the pose, the coefficients and the offsets.

    Attributes:
        terms: What is observed.
        form: How the mixtures are handed to the solver, as `factors.mixture.Form`; without a Jacobian it is the loss.
        share: Factor on the energy of all rows.
        on_ground: Whether the ground, where one is observed, says something.
    """

    cdef readonly Observation terms
    cdef public int form
    cdef readonly double share
    cdef readonly bint on_ground
    cdef double height_sigma  # of the origin over the ground, metres; 0 where that says nothing
    cdef double[::1] visibility  # what densities and weights were made with
    cdef double[::1] right, wrong, edges, work  # as `Observation.graph_rows` has them

    def __init__(self, Observation terms, double share, bint on_ground):
        """Bind the observation."""
        cdef int K = terms.keypoints, N = terms.coefficients
        self.terms, self.share, self.form, self.rows = terms, share, NEWTON, terms.rows
        self.on_ground, self.height_sigma = on_ground and terms.has_ground, 0.0
        self.visibility, self.judged = np.ones(K), 2 * K + 7 if terms.is_bound else 0
        self.right, self.wrong, self.edges = np.zeros(K), np.ones(K), np.ones(4)
        self.work = np.empty(14 * terms.points + 8 * (6 + N))
        self.take([(12, 6, True), (N, N, True), (3 * K, 3 * K, False)])

    def tell(self, const double[::1] right, const double[::1] wrong, const double[::1] edges, double height_sigma):
        """Set densities of right points (K,), or their weights, those of wrong ones (K,), and the edges' weights (4,)."""
        if right.shape[0] != self.terms.keypoints or wrong.shape[0] != right.shape[0] or edges.shape[0] != 4:
            raise ValueError("densities (K,) and weights (4,) are expected")
        self.right[:], self.wrong[:], self.edges[:] = right, wrong, edges
        self.height_sigma = height_sigma if self.on_ground else 0.0

    def see(self, const double[::1] visibility, const double[::1] edges, double depth):
        """Set the visibility (K,) and with it all densities, the edges' weights (4,), and the depth of the ground."""
        cdef int k
        if not self.judged:
            raise ValueError("bind the observation by `search_by` first")
        if visibility.shape[0] != self.terms.keypoints or edges.shape[0] != 4:
            raise ValueError("visibility (K,) and weights (4,) are expected")
        self.visibility[:], self.edges[:] = visibility, edges
        for k in range(self.terms.keypoints):
            self.terms.densities(k, visibility[k], &self.right[k], &self.wrong[k])
        if self.on_ground:
            self.height_sigma = self.terms.height_sigma_at(depth)

    cdef void judge(self, const double **at, bint look, double *found) noexcept nogil:
        """Weights (K,), visibility (K,), weights of edges (4,), energies of keypoints and box (2,), nats, and the depth."""
        cdef int K = self.terms.keypoints
        self.terms.judge(
            at[0], at[0] + 9, at[1], at[2], &self.visibility[0], look, found, &self.right[0], &self.wrong[0],
            &self.edges[0], &self.work[0], found + 2 * K + 4
        )
        memcpy(found + K, &self.visibility[0], K * sizeof(double))
        memcpy(found + 2 * K, &self.edges[0], 4 * sizeof(double))
        found[2 * K + 6] = at[0][11]
        if look and self.on_ground:
            self.height_sigma = self.terms.height_sigma_at(at[0][11])

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef double energy, nearest, root = sqrt(self.share)
        cdef int i, form = self.form if J != NULL or self.form == WEIGHTED else LOSS
        nearest = self.terms.graph_rows(
            at[0], at[0] + 9, at[1], at[2], &self.right[0], &self.wrong[0], &self.edges[0], self.height_sigma, form,
            &self.work[0], r, J, &energy
        )
        if not (SHALLOW < nearest < INFINITY):  # behind the camera, or infinitely far, there is no residual
            for i in range(self.rows):
                r[i] = INFINITY
            if J != NULL:
                memset(J, 0, self.rows * self.columns * sizeof(double))
            return INFINITY
        if self.share != 1.0:
            for i in range(self.rows):
                r[i] *= root
            if J != NULL:
                for i in range(self.rows * self.columns):
                    J[i] *= root
        return self.share * energy


cdef double evaluate(
    Observation terms, const double *R, const double *t, const double *x, double least,
    double *g, double *M, double *weights, double *work
) noexcept nogil:
    """Robust energy of a hypothesis; gradient g (D,), lower triangle of M (D, D), and weights (K,).

    Where g is NULL the energy is without that of other sensors, and has no derivatives.
    """
    cdef int K = terms.keypoints, N = terms.coefficients, D = 6 + terms.coefficients, A, a, i, k, n
    cdef double *J = work + 14 * terms.points  # (4, D)
    cdef double *visibility = J + 4 * D
    cdef double r[4]
    cdef double X[3]
    cdef double camera[6]
    cdef double body[6]
    cdef double turn[12]
    cdef double shift[3]
    cdef double right, wrong, weight, loss, sigma, energy = 0.0, place, x_, z_
    cdef bint near = False
    cdef bint want = g != NULL
    if want:
        memset(g, 0, D * sizeof(double))
        memset(M, 0, D * D * sizeof(double))
    terms.visible(R, t, visibility)
    for k in range(K):
        near |= terms.keypoint(k, R, t, x, NULL, least, r, X, camera, body) < least
        weights[k] = 0.0
        if not terms.measured[k]:
            continue
        terms.densities(k, visibility[k], &right, &wrong)
        mixture(right, wrong, r[0] * r[0] + r[1] * r[1], &weights[k], &loss)
        energy += loss - log(right + wrong)
        if not want:
            continue
        for i in range(2):
            cross(X, body + 3 * i, J)
            for a in range(3):
                J[3 + a] = camera[3 * i + a]
            for n in range(N):
                J[6 + n] = 0.0
                for a in range(3):
                    J[6 + n] += body[3 * i + a] * terms.basis[n, 3 * k + a]
            add(J, D, r[i], weights[k], g, M, D)
    if terms.has_box:
        near |= terms.box(R, t, x, least, r, J if want else NULL, NULL, work) < least
        for i in range(4):
            if terms.used[i]:
                weight = exp(-0.5 * r[i] * r[i])
                energy -= log(weight + terms.box_wrong)
                if want:
                    add(J + i * D, D, r[i], weight / (weight + terms.box_wrong), g, M, D)
    if terms.has_size:
        for i in range(3):
            r[0] = terms.size_mean[i]
            memset(J, 0, D * sizeof(double))
            for n in range(N):
                r[0] += terms.size_basis[i, n] * x[n]
                J[6 + n] = terms.size_basis[i, n] / terms.size_sigma[i]
            r[0] /= terms.size_sigma[i]
            energy += 0.5 * r[0] * r[0]
            if want:
                add(J, D, r[0], 1.0, g, M, D)
    if terms.has_ground:
        sigma = terms.height_sigma_at(t[2])
        terms.ground(R, t, sigma, r, turn, shift)
        energy += log(sigma)
        for i in range(4):
            memset(J, 0, 6 * sizeof(double))
            for a in range(3):
                J[a] = turn[3 * i + a]
                J[3 + a] = shift[a] if i == 0 else 0.0
            energy += 0.5 * r[i] * r[i]
            if want:
                add(J, 6, r[i], 1.0, g, M, D)
    if terms.has_direction:
        A = terms.direction.shape[0]
        z_ = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
        x_ = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
        place = atan2(z_, x_) / (2.0 * PI)
        place = (place - floor(place)) * A
        i = <int> place
        i = i % A if i > 0 else 0  # NaN as well
        place -= floor(place)
        energy -= log((1.0 - place) * terms.direction[i] + place * terms.direction[(i + 1) % A])
    for n in range(N):
        energy += 0.5 * x[n] * x[n]
        if want:
            g[6 + n] += x[n]
            M[(6 + n) * D + 6 + n] += 1.0
    if want and terms.measured_beside is not None:
        energy += terms.measured_beside.add(R, t, x, INFINITY, g, M, J)
    return INFINITY if near else energy


def best(
    Observation terms, const double[:, :, ::1] rotation, const double[:, ::1] translation,
    const double[:, ::1] coefficients, double least, int count
):
    """Indices of the hypotheses of the least energies, at most so many, best first; see `search`.

    What other sensors say is asked for those first of which all else says the least, and no further than it matters.
    """
    cdef int H = rotation.shape[0], N = terms.coefficients, h, i, j, kept = 0
    cdef double energy, most
    if coefficients.shape[0] != H or coefficients.shape[1] != N or translation.shape[0] != H or not H or count < 1:
        raise ValueError("starts of different numbers, or none")
    if not terms.is_bound:
        raise ValueError("bind the observation by `search_by` first")
    cdef double[::1] energies = np.empty(count), weights = np.empty(terms.keypoints), first = np.empty(H)
    cdef double[::1] work = np.empty(14 * terms.points + 4 * (6 + N) + terms.keypoints)
    cdef const double *x = &coefficients[0, 0] if N else NULL
    for h in range(H):
        first[h] = evaluate(
            terms, &rotation[h, 0, 0], &translation[h, 0], x + h * N, least, NULL, NULL, &weights[0], &work[0]
        )
    found = np.empty(count, dtype=np.intp)
    cdef Py_ssize_t[::1] order = found, ranked = np.argsort(first, kind="stable")
    for j in range(H):
        h = ranked[j]
        energy, most = first[h], energies[kept - 1] if kept == count else INFINITY
        if terms.measured_beside is not None and energy < most:
            energy += terms.measured_beside.add(
                &rotation[h, 0, 0], &translation[h, 0], x + h * N, most - energy, NULL, NULL, NULL
            )
        if kept == count:
            if not energy < most:
                continue
            kept -= 1
        i = kept
        while i > 0 and energy < energies[i - 1]:
            energies[i], order[i] = energies[i - 1], order[i - 1]
            i -= 1
        energies[i], order[i] = energy, h
        kept += 1
    return found[:kept]


def search(
    Observation terms, const double[:, :, ::1] rotation, const double[:, ::1] translation,
    const double[:, ::1] coefficients, double least, const int[::1] keep, double largest_turn, double settled,
    double alike, double first_damping, double calmer, double bolder, double ridge
):
    """`fgrecon.solve.proposals.search.search`, compiled.

    Args:
        terms: The observation, bound by `search_by`.
        rotation: (H, 3, 3). translation: (H, 3). coefficients: (H, N): the starts.
        least: Least depth in metres.
        keep: (I,) how many hypotheses go on from iteration i; 0 for all.
        largest_turn: Radians a step may turn.
        settled: Nats: the search ends once no step changes any energy by more.
        alike: Cosine of the angle up to which hypotheses are one.
        first_damping: Share of the diagonal.
        calmer: Factor on the damping after a good step.
        bolder: Factor after a bad one.
        ridge: Added to the diagonal.

    Returns:
        rotation, translation, coefficients, energy (H',), weights (H', K) of the survivors, best first; and the
        best one's path: its rotations, translations, coefficients and weights at every iteration.
    """
    cdef int H = rotation.shape[0], N = terms.coefficients, D = 6 + N, K = terms.keypoints, I = keep.shape[0]
    cdef int h, i, j, a, n, m, iteration, count = H, done = 0
    cdef bint moved, same
    cdef double gain, energy, scale, turn, cosine
    if coefficients.shape[0] != H or coefficients.shape[1] != N or translation.shape[0] != H or not H:
        raise ValueError("starts of different numbers")
    if not terms.is_bound:
        raise ValueError("bind the observation by `search_by` first")
    # Of every iteration the state of every hypothesis: 9 + 3 + N + K numbers, which is what a history shows.
    cdef int size = 12 + N + K
    cdef double[:, :, ::1] states = np.empty((I + 1, H, size))
    cdef double[::1] energies = np.empty(H), damping = np.full(H, first_damping)
    cdef double[:, ::1] g = np.empty((H, D))
    cdef double[:, ::1] M = np.empty((H, D * D))
    cdef double[::1] trial_g = np.empty(D), trial_M = np.empty(D * D), trial = np.empty(size)
    cdef double[::1] step = np.empty(D), L = np.empty(D * D)
    cdef double[::1] work = np.empty(14 * terms.points + 4 * D + K)
    cdef Py_ssize_t[::1] alive = np.arange(H, dtype=np.intp), order
    cdef double *state
    for h in range(H):
        state = &states[0, h, 0]
        memcpy(state, &rotation[h, 0, 0], 9 * sizeof(double))
        memcpy(state + 9, &translation[h, 0], 3 * sizeof(double))
        for n in range(N):
            state[12 + n] = coefficients[h, n]
        energies[h] = evaluate(
            terms, state, state + 9, state + 12, least, &g[h, 0], &M[h, 0], state + 12 + N, &work[0]
        )
    for iteration in range(I):
        if 0 < keep[iteration] < count:
            left = np.array(alive[:count])
            order = left[np.argsort(np.asarray(energies)[left], kind="stable")]
            m = 0
            for i in range(count):
                h = order[i]
                same = False
                for j in range(m):
                    cosine = -1.0
                    for a in range(9):
                        cosine += states[iteration, h, a] * states[iteration, alive[j], a]
                    same |= cosine / 2.0 > alike
                if not same:
                    alive[m] = h
                    m += 1
                    if m == keep[iteration]:
                        break
            count = m
        moved = False
        done = iteration + 1
        with nogil:
            for i in range(count):
                h = alive[i]
                state = &states[iteration, h, 0]
                memcpy(&states[done, h, 0], state, size * sizeof(double))
                if not solve(&M[h, 0], &g[h, 0], damping[h], ridge, D, &L[0], &step[0]):
                    damping[h] *= bolder
                    moved = True
                    continue
                turn = sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
                scale = largest_turn / turn if turn > largest_turn else 1.0
                for a in range(D):
                    step[a] *= scale
                rotate(state, &step[0], &trial[0])
                for a in range(3):
                    trial[9 + a] = state[9 + a] + step[3 + a]
                for n in range(N):
                    trial[12 + n] = state[12 + n] + step[6 + n]
                energy = evaluate(
                    terms,
                    &trial[0], &trial[9], &trial[0] + 12, least, &trial_g[0], &trial_M[0], &trial[0] + 12 + N,
                    &work[0]
                )
                gain = energies[h] - energy
                moved |= fabs(gain) > settled
                if gain > 0.0:
                    damping[h] *= calmer
                    energies[h] = energy
                    memcpy(&states[done, h, 0], &trial[0], size * sizeof(double))
                    memcpy(&g[h, 0], &trial_g[0], D * sizeof(double))
                    memcpy(&M[h, 0], &trial_M[0], D * D * sizeof(double))
                else:
                    damping[h] *= bolder
        if iteration > last_cut(keep) and not moved:
            break
    chosen = np.asarray(alive)[:count]
    chosen = chosen[np.argsort(np.asarray(energies)[chosen], kind="stable")]
    final = np.asarray(states)[done, chosen]
    path = np.asarray(states)[: done + 1, chosen[0]]
    return split(final, N), np.asarray(energies)[chosen], split(path, N)


def split(states, int N):
    """Rotations (.., 3, 3), translations, coefficients and weights of packed states."""
    return states[:, :9].reshape(-1, 3, 3), states[:, 9:12], states[:, 12:12 + N], states[:, 12 + N:]


cdef int last_cut(const int[::1] keep) noexcept nogil:
    cdef int i, last = 0
    for i in range(keep.shape[0]):
        if keep[i]:
            last = i
    return last


cdef bint solve(
    const double *M, const double *g, double damping, double ridge, int D, double *L, double *x
) noexcept nogil:
    """x = -(M + damping diag(M))^-1 g by Cholesky; False where the matrix is not positive definite."""
    cdef int i, j, k
    cdef double s
    for i in range(D):
        for j in range(i + 1):
            s = M[i * D + j]
            if i == j:
                s = s * (1.0 + damping) + ridge
            for k in range(j):
                s -= L[i * D + k] * L[j * D + k]
            if i != j:
                L[i * D + j] = s / L[j * D + j]
            elif s > 0.0:
                L[i * D + i] = sqrt(s)
            else:
                return False
    for i in range(D):
        s = -g[i]
        for k in range(i):
            s -= L[i * D + k] * x[k]
        x[i] = s / L[i * D + i]
    for i in range(D - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, D):
            s -= L[k * D + i] * x[k]
        x[i] = s / L[i * D + i]
    return True


cdef void rotate(const double *R, const double *w, double *out) noexcept nogil:
    """out = R exp(w) (Rodrigues)."""
    cdef double angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), a, b
    cdef double safe = angle if angle > 1e-8 else 1e-8
    cdef double E[9]
    cdef int i, j
    a, b = sin(safe) / safe, (1.0 - cos(safe)) / (safe * safe)
    E[0], E[1], E[2] = 1.0 - b * (w[1] * w[1] + w[2] * w[2]), b * w[0] * w[1] - a * w[2], b * w[0] * w[2] + a * w[1]
    E[3], E[4], E[5] = b * w[0] * w[1] + a * w[2], 1.0 - b * (w[0] * w[0] + w[2] * w[2]), b * w[1] * w[2] - a * w[0]
    E[6], E[7], E[8] = b * w[0] * w[2] - a * w[1], b * w[1] * w[2] + a * w[0], 1.0 - b * (w[0] * w[0] + w[1] * w[1])
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = R[3 * i] * E[j] + R[3 * i + 1] * E[3 + j] + R[3 * i + 2] * E[6 + j]
