# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""A vehicle's silhouette in the image, compiled: the equations are those of `factors.silhouette`."""

from libc.math cimport INFINITY, NAN, exp, log, sqrt
from libc.stdlib cimport free, malloc

import numpy as np

from factors._points cimport LOSS, NEWTON, WEIGHTED, Term, mixed
from factors._rows cimport Source
from factors.projection import LEAST_DEPTH

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef double PI = 3.14159265358979323846, LEAST = LEAST_DEPTH


cdef class Field:
    """`factors.distance_field.DistanceField`: distances (H, W) from an outline, at least 2 x 2, and their corner (2,)."""

    cdef const double[:, ::1] distance
    cdef double corner[2]

    def __init__(self, const double[::1] corner, distance):
        """Bind the numbers."""
        self.distance = distance
        self.corner[0], self.corner[1] = corner[0], corner[1]
        if self.distance.shape[0] < 2 or self.distance.shape[1] < 2:
            raise ValueError("a field of 2 x 2 numbers at least is expected")

    cdef double at(self, const double *pixel, double *slope) noexcept nogil:
        """Distance at a pixel, and its derivative (2,)."""
        cdef int a, row, column, height = self.distance.shape[0], width = self.distance.shape[1]
        cdef double u, v, top, along_top, along_bottom, away, most, place
        cdef double inside[2]
        cdef double beyond[2]
        for a in range(2):
            place, most = pixel[a] - self.corner[a], (width if a == 0 else height) - 1.0
            inside[a] = place if place > 0.0 else 0.0  # NaN as well
            inside[a] = most if inside[a] > most else inside[a]
            beyond[a] = place - inside[a]
        column, row = min(<int> inside[0], width - 2), min(<int> inside[1], height - 2)
        u, v, top = inside[0] - column, inside[1] - row, self.distance[row, column]
        along_top = self.distance[row, column + 1] - top
        along_bottom = self.distance[row + 1, column + 1] - self.distance[row + 1, column]
        slope[0] = along_top + v * (along_bottom - along_top) if beyond[0] == 0.0 else 0.0
        top += u * along_top
        most = self.distance[row + 1, column] + u * along_bottom - top
        slope[1] = most if beyond[1] == 0.0 else 0.0
        away = sqrt(beyond[0] * beyond[0] + beyond[1] * beyond[1])
        if away > 0.0:
            slope[0] += beyond[0] / away
            slope[1] += beyond[1] / away
        return top + v * most + away


cdef struct Place:  # of a vertex
    double X[3]  # in the object frame
    double pixel[2]
    double G[6]  # (2, 3) derivative of the pixel by the camera point
    double depth


cdef class Silhouette(Term):
    """A mask, bound to the surface whose outline it has."""

    cdef readonly int directions
    cdef int vertices
    cdef Field field, hides
    cdef const double[:, ::1] matrix, mean, basis, towards, farthest
    cdef double border, width, height, sigma, right, wrong, hidden, independent
    cdef double[::1] mask_says

    def __init__(self, field, hides, matrix, image_size, mean, basis, towards, farthest, double sigma, odds):
        """Bind the arrays.

        Args:
            field: Corner and numbers of the mask's distances; hides: the same, or None.
            matrix: (3, 3). image_size: width and height, or None.
            mean: (P, 3). basis: (N, 3 P). towards: (M, 2) unit vectors. farthest: (M, 2). sigma: pixels.
            odds: (5,) numbers of `factors.silhouette.SilhouetteOdds` in their order.
        """
        cdef int m
        self.field, self.hides = Field(*field), None if hides is None else Field(*hides)
        self.matrix, self.mean, self.basis, self.towards, self.farthest = matrix, mean, basis, towards, farthest
        self.vertices, self.directions, self.coefficients = mean.shape[0], towards.shape[0], basis.shape[0]
        self.width, self.height = (-1.0, -1.0) if image_size is None else image_size
        self.sigma, self.right, self.hidden, self.border, self.independent = sigma, odds[0], odds[2], odds[3], odds[4]
        self.wrong = (1.0 - self.right) * sqrt(2.0 * PI) * sigma / odds[1]
        self.mask_says = np.empty(self.directions)
        for m in range(self.directions):
            self.mask_says[m] = self.says(&self.farthest[m, 0])

    cdef double says(self, const double *pixel) noexcept nogil:
        """Whether an outline at a pixel says something, as 1 or 0."""
        cdef double slope[2]
        if self.width >= 0.0 and not (
            self.border <= pixel[0] <= self.width - 1.0 - self.border
            and self.border <= pixel[1] <= self.height - 1.0 - self.border
        ):
            return 0.0
        return 0.0 if self.hides is not None and self.hides.at(pixel, slope) < self.hidden else 1.0

    cdef void place(self, int vertex, const double *R, const double *t, const double *x, Place *place) noexcept nogil:
        """Where a vertex is."""
        cdef int a, n
        cdef double inverse
        cdef double Y[3]
        for a in range(3):
            place.X[a] = self.mean[vertex, a]
        for n in range(self.coefficients):
            for a in range(3):
                place.X[a] += x[n] * self.basis[n, 3 * vertex + a]
        for a in range(3):
            Y[a] = R[3 * a] * place.X[0] + R[3 * a + 1] * place.X[1] + R[3 * a + 2] * place.X[2] + t[a]
        place.depth = Y[2]
        inverse = 1.0 / (Y[2] if Y[2] > LEAST else LEAST)
        Y[0] *= inverse
        Y[1] *= inverse
        place.pixel[0] = self.matrix[0, 0] * Y[0] + self.matrix[0, 1] * Y[1] + self.matrix[0, 2]
        place.pixel[1] = self.matrix[1, 1] * Y[1] + self.matrix[1, 2]
        place.G[0], place.G[1] = self.matrix[0, 0] * inverse, self.matrix[0, 1] * inverse
        place.G[2] = -(self.matrix[0, 0] * Y[0] + self.matrix[0, 1] * Y[1]) * inverse
        place.G[3], place.G[4], place.G[5] = 0.0, self.matrix[1, 1] * inverse, -self.matrix[1, 1] * Y[1] * inverse

    cdef void match_into(
        self, const double *R, const double *t, const double *x, int *farthest, double *says, double *pixels
    ) noexcept nogil:
        """The farthest vertices (M,) in the directions, and which rows (2 M,) say something, as 1 or 0.

        `pixels` is for work: columns, rows and depths (3, P) of the vertices.
        """
        cdef int m, p, k, M = self.directions, P = self.vertices
        cdef double far, most, u, v
        cdef Place place
        for p in range(P):
            self.place(p, R, t, x, &place)
            pixels[p], pixels[P + p], pixels[2 * P + p] = place.pixel[0], place.pixel[1], place.depth
        for m in range(M):
            u, v, k = self.towards[m, 0], self.towards[m, 1], 0
            most = u * pixels[0] + v * pixels[P]
            for p in range(1, P):
                far = u * pixels[p] + v * pixels[P + p]
                if far > most:
                    most, k = far, p
            farthest[m] = k
        for m in range(M):
            k = farthest[m]
            place.pixel[0], place.pixel[1] = pixels[k], pixels[P + k]
            says[m], says[M + m] = self.says(place.pixel), self.mask_says[m]
            if not pixels[2 * P + k] > LEAST:
                says[m] = says[M + m] = 0.0
            for p in range(m):
                if farthest[p] == k:  # once is enough
                    says[m] = 0.0
                    break

    cdef double share_of(self, const double *says) noexcept nogil:
        """Share of the energy that counts."""
        cdef int m
        cdef double total = 0.0
        for m in range(2 * self.directions):
            total += says[m]
        return min(1.0, self.independent / max(total, 1.0))

    cdef void off(self, int m, const Place *place, double *r, double *slope) noexcept nogil:
        """Whitened residuals (2,) of a direction, and their derivatives (2, 2) by the pixel of its vertex."""
        cdef int a
        r[0] = self.field.at(place.pixel, slope) / self.sigma
        r[1] = 0.0
        for a in range(2):
            r[1] += (place.pixel[a] - self.farthest[m, a]) * self.towards[m, a] / self.sigma
            slope[a] /= self.sigma
            slope[2 + a] = self.towards[m, a] / self.sigma

    cdef void row(
        self, int vertex, const Place *place, const double *R, const double *slope, double factor, bint of_camera,
        double *J
    ) noexcept nogil:
        """A derivative times a factor by turn, shift along the object's axes or the camera's, and coefficients."""
        cdef int a, n
        cdef double by[3]
        cdef double g[3]
        cdef const double *X = place.X
        for a in range(3):
            g[a] = factor * (slope[0] * place.G[a] + slope[1] * place.G[3 + a])
        for a in range(3):
            by[a] = g[0] * R[a] + g[1] * R[3 + a] + g[2] * R[6 + a]
            J[3 + a] = g[a]
        if not of_camera:
            for a in range(3):
                J[3 + a] = by[a]
        J[0], J[1], J[2] = X[1] * by[2] - X[2] * by[1], X[2] * by[0] - X[0] * by[2], X[0] * by[1] - X[1] * by[0]
        for n in range(self.coefficients):
            J[6 + n] = 0.0
            for a in range(3):
                J[6 + n] += by[a] * self.basis[n, 3 * vertex + a]

    cdef double add(
        self, const double *R, const double *t, const double *x, double most, double *g, double *M, double *J
    ) noexcept nogil:
        cdef int m, i, a, b, count = self.directions, D = 6 + self.coefficients
        cdef double share, inlier, weight, energy = 0.0
        cdef double r[2]
        cdef double slope[4]
        cdef Place place
        cdef double *pixels = <double *> malloc((3 * self.vertices + 3 * count) * sizeof(double))
        cdef double *says = pixels + 3 * self.vertices
        cdef int *farthest = <int *> (says + 2 * count)
        if pixels == NULL:
            return INFINITY
        self.match_into(R, t, x, farthest, says, pixels)
        share = self.share_of(says)
        for m in range(count):
            self.place(farthest[m], R, t, x, &place)
            self.off(m, &place, r, slope)
            for i in range(2):
                if says[i * count + m] == 0.0:
                    continue
                inlier = self.right * exp(-0.5 * r[i] * r[i])
                weight = inlier / (inlier + self.wrong) * share
                energy += share * log((self.right + self.wrong) / (inlier + self.wrong))
                if J == NULL or weight <= 1e-6:
                    continue
                self.row(farthest[m], &place, R, slope + 2 * i, 1.0, True, J)
                for a in range(D):
                    g[a] += weight * r[i] * J[a]
                    for b in range(a + 1):
                        M[a * D + b] += weight * J[a] * J[b]
        free(pixels)
        return energy

    def match(self, const double[:, :] rotation, const double[:] translation, const double[:] coefficients):
        """The farthest vertices (M,) in the directions, and which rows (2 M,) say something, as 1 or 0."""
        cdef double[::1] state = packed(rotation, translation, coefficients)
        cdef int m
        cdef int[::1] farthest = np.empty(self.directions, dtype=np.intc)
        cdef double[::1] says = np.empty(2 * self.directions), pixels = np.empty(3 * self.vertices)
        self.match_into(&state[0], &state[9], &state[12], &farthest[0], &says[0], &pixels[0])
        return np.asarray(farthest).astype(np.intp), np.asarray(says)

    def distances(
        self, const Py_ssize_t[::1] vertices, const double[:, :] rotation, const double[:] translation,
        const double[:] coefficients, bint want
    ):
        """Whitened residuals (2 M,) of vertices (M,), and where wanted their derivative (2 M, 6 + N).

        By a turn about the object's axes, a shift along them, and the coefficients.
        """
        cdef double[::1] state = packed(rotation, translation, coefficients)
        cdef int m, i, count = self.directions
        cdef double off[2]
        cdef double slope[4]
        cdef Place place
        residual = np.empty(2 * count)
        jacobian = np.empty((2 * count if want else 0, 6 + self.coefficients))
        cdef double[::1] r = residual
        cdef double[:, ::1] J = jacobian
        for m in range(count):
            self.place(vertices[m], &state[0], &state[9], &state[12], &place)
            self.off(m, &place, off, slope)
            for i in range(2):
                r[i * count + m] = off[i]
                if want:
                    self.row(vertices[m], &place, &state[0], slope + 2 * i, 1.0, False, &J[i * count + m, 0])
        return residual, jacobian if want else None


def packed(rotation, translation, coefficients):
    """A state as one vector: R row by row, t, and the coefficients, with nothing after them."""
    return np.concatenate([np.ravel(rotation), translation, coefficients, np.zeros(1)])


cdef class SilhouetteSource(Source):
    """Rows of a silhouette in a graph: of the pose and the coefficients. It judges the weights (2 M,).

    Attributes:
        form: How the mixture is handed to the solver, as `factors.mixture.Form`; without a Jacobian it is the loss.
        share: Factor on the energy.
        common: By how much less it says, weighted.
    """

    cdef readonly Silhouette silhouette
    cdef public int form
    cdef public double share, common
    cdef bint matched_once
    cdef int[::1] vertices
    cdef double[::1] says, weights, pixels

    def __init__(self, Silhouette silhouette, double share):
        """Bind the silhouette."""
        cdef int M = silhouette.directions, N = silhouette.coefficients
        self.silhouette, self.share, self.common, self.form, self.rows = silhouette, share, 1.0, NEWTON, 2 * M
        self.judged, self.matched_once = 2 * M, False
        self.vertices, self.says, self.weights = np.zeros(M, dtype=np.intc), np.zeros(2 * M), np.zeros(2 * M)
        self.pixels = np.empty(3 * silhouette.vertices)
        self.take([(12, 6, True), (N, N, True)])

    @property
    def matched(self):
        """Vertices (M,), and which rows (2 M,) say something, as they are set."""
        return np.array(self.vertices, dtype=np.intp), np.array(self.says)

    def look(self, const double[::1] pose, const double[::1] x, bint look):
        """The same as `judge` at a pose (12,) and coefficients (N,)."""
        cdef const double *at[8]
        cdef double[::1] found = np.empty(self.judged)
        if pose.shape[0] != 12 or x.shape[0] != self.silhouette.coefficients:
            raise ValueError("a pose (12,) and coefficients (N,) are expected")
        at[0], at[1] = &pose[0], &x[0] if x.shape[0] else NULL
        self.judge(at, look, &found[0])
        return np.asarray(found)

    cdef void judge(self, const double **at, bint look, double *found) noexcept nogil:
        cdef int m, i, M = self.silhouette.directions
        cdef double inlier
        cdef double r[2]
        cdef double slope[4]
        cdef Place place
        if look or not self.matched_once:
            self.silhouette.match_into(
                at[0], at[0] + 9, at[1], &self.vertices[0], &self.says[0], &self.pixels[0]
            )
            self.matched_once = True
        for m in range(M):
            self.silhouette.place(self.vertices[m], at[0], at[0] + 9, at[1], &place)
            self.silhouette.off(m, &place, r, slope)
            for i in range(2):
                inlier = self.silhouette.right * exp(-0.5 * r[i] * r[i]) * self.says[i * M + m]
                found[i * M + m] = self.weights[i * M + m] = inlier / (inlier + self.silhouette.wrong)

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *R = at[0]
        cdef int m, i, k, M = self.silhouette.directions
        cdef int form = self.form if J != NULL or self.form == WEIGHTED else LOSS
        cdef double loss, stretch, bend, right, energy = 0.0, share, root
        cdef double off[2]
        cdef double slope[4]
        cdef Place place
        if not self.matched_once:
            self.judge(at, True, r)
        share = self.share * self.silhouette.share_of(&self.says[0])
        root = sqrt(share)
        for m in range(M):
            self.silhouette.place(self.vertices[m], R, R + 9, at[1], &place)
            self.silhouette.off(m, &place, off, slope)
            for i in range(2):
                k = i * M + m
                right = self.silhouette.right * self.says[k]
                mixed(
                    form, right, self.silhouette.wrong, self.weights[k] / self.common, off[i] * off[i],
                    &stretch, &bend, &loss
                )
                energy += loss
                r[k] = root * stretch * off[i]
                if J != NULL and bend != 0.0:
                    self.silhouette.row(
                        self.vertices[m], &place, R, slope + 2 * i, root * bend, False, J + k * self.columns
                    )
        return NAN if self.form == WEIGHTED else share * energy
