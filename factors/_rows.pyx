# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""Rows of many factors linearised in one call, and the rows of motion and contact (`factors.motion`, `factors.contact`).

A `Source` has the rows of one factor; `Rows` evaluates any number of them and adds up what a linear factor needs. What
a variable is handed over as: a pose as R row by row and t (12 numbers), a vector as it is, a plane as normal, distance
and the tangent basis of its normal row by row (10 numbers).
"""

from libc.math cimport INFINITY, NAN, cos, fabs, isnan, sin, sqrt
from libc.string cimport memcpy, memset

import numpy as np

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`

cdef extern from *:
    """
    #if defined(__GNUC__)
    typedef double fgrecon_two __attribute__((vector_size(16), aligned(8), may_alias));
    #define FGRECON_TWO(p) (*(const fgrecon_two *)(p))
    #endif

    /* a . b, in four sums that need not wait for one another. */
    static double fgrecon_inner(const double *a, const double *b, Py_ssize_t n) {
        double s = 0.0, t = 0.0, u = 0.0, v = 0.0;
        Py_ssize_t i = 0;
    #if defined(__GNUC__)
        fgrecon_two st = {0.0, 0.0}, uv = {0.0, 0.0};
        for (; i + 4 <= n; i += 4) {
            st += FGRECON_TWO(a + i) * FGRECON_TWO(b + i);
            uv += FGRECON_TWO(a + i + 2) * FGRECON_TWO(b + i + 2);
        }
        s = st[0], t = st[1], u = uv[0], v = uv[1];
    #else
        for (; i + 4 <= n; i += 4) {
            s += a[i] * b[i], t += a[i + 1] * b[i + 1], u += a[i + 2] * b[i + 2], v += a[i + 3] * b[i + 3];
        }
    #endif
        for (; i < n; i++) s += a[i] * b[i];
        return (s + t) + (u + v);
    }

    /* a . c and b . c, each as fgrecon_inner has it. */
    static void fgrecon_inner_of_two(
        const double *a, const double *b, const double *c, Py_ssize_t n, double *found
    ) {
    #if defined(__GNUC__)
        fgrecon_two st = {0.0, 0.0}, uv = {0.0, 0.0}, wx = {0.0, 0.0}, yz = {0.0, 0.0};
        Py_ssize_t i = 0;
        double s, w;
        for (; i + 4 <= n; i += 4) {
            const fgrecon_two first = FGRECON_TWO(c + i), second = FGRECON_TWO(c + i + 2);
            st += FGRECON_TWO(a + i) * first;
            uv += FGRECON_TWO(a + i + 2) * second;
            wx += FGRECON_TWO(b + i) * first;
            yz += FGRECON_TWO(b + i + 2) * second;
        }
        s = st[0], w = wx[0];
        for (; i < n; i++) s += a[i] * c[i], w += b[i] * c[i];
        found[0] = (s + st[1]) + (uv[0] + uv[1]);
        found[1] = (w + wx[1]) + (yz[0] + yz[1]);
    #else
        found[0] = fgrecon_inner(a, c, n);
        found[1] = fgrecon_inner(b, c, n);
    #endif
    }
    """
    double inner "fgrecon_inner"(const double *a, const double *b, Py_ssize_t n) nogil
    void inner_of_two "fgrecon_inner_of_two"(
        const double *a, const double *b, const double *c, Py_ssize_t n, double *found
    ) nogil


cdef double SINGULAR = 1e-15  # share of a number of the diagonal that rounding may leave of none


cdef class Source:
    """Rows of a factor.

    Attributes:
        rows: Number of rows.
        columns: Of the Jacobian, for one variable after the other.
        takes: Of each variable the numbers that it is handed over as, its dimension, and whether it must be there.
        judged: How many numbers it finds out of a state beside; see `judge`.
    """

    def __reduce__(self):
        """Pointers into arrays are not copied.

        Raises:
            TypeError: Always; who holds it makes another.
        """
        raise TypeError(f"a compiled {type(self).__name__} cannot be copied or pickled")

    cdef int take(self, list takes) except -1:
        """Set what it takes: (numbers, dimension, whether it must be there) of each of up to eight variables."""
        if not 0 < len(takes) <= 8:
            raise ValueError("up to eight variables are expected")
        self.takes = tuple(takes)
        self.columns = sum(dim for _, dim, _ in takes)
        return 0

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        """Fill residual (rows,) and, unless it is NULL, the Jacobian (rows, columns), which is zero on entry.

        Returns:
            The energy; NaN where it is half the sum of the squares.
        """
        return NAN

    cdef void judge(self, const double **at, bint look, double *found) noexcept nogil:
        """Find (judged,) numbers out of a state, which the rows depend on from then on; with `look` all anew."""

    def evaluate(self, variables, double[::1] residual, double[:, ::1] jacobian):
        """The same from Python: variables as arrays, None for one that there is not; a Jacobian of None is not wanted."""
        cdef const double *at[8]
        cdef const double[::1] one
        cdef int i
        if len(variables) != len(self.takes) or residual.shape[0] != self.rows:
            raise ValueError(f"{len(self.takes)} variables and a residual ({self.rows},) are expected")
        if jacobian is not None and (jacobian.shape[0] != self.rows or jacobian.shape[1] != self.columns):
            raise ValueError(f"a Jacobian ({self.rows}, {self.columns}) is expected")
        for i, (variable, (size, _, needed)) in enumerate(zip(variables, self.takes)):
            at[i] = NULL
            if variable is None and not needed:
                continue
            one = variable
            if one.shape[0] != size:
                raise ValueError(f"variable {i} of {size} numbers is expected, not of {one.shape[0]}")
            if size:
                at[i] = &one[0]
        if jacobian is None:
            return self.fill(at, &residual[0], NULL)
        jacobian[:] = 0.0
        return self.fill(at, &residual[0], &jacobian[0, 0])


cdef class Change(Source):
    """r = y - x of two vectors (n,), or r = x of one: what a random walk, or a prior about zero, is about."""

    cdef bint walks

    def __init__(self, int count, bint walks):
        """Bind the size, and whether there are two."""
        self.rows, self.walks = count, walks
        self.take([(count, count, True)] * (2 if walks else 1))

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef int i
        for i in range(self.rows):
            r[i] = at[1][i] - at[0][i] if self.walks else at[0][i]
            if J != NULL:
                J[i * self.columns + i] = -1.0 if self.walks else 1.0
                if self.walks:
                    J[i * self.columns + self.rows + i] = 1.0
        return NAN


cdef class Drive(Source):
    """`factors.motion.drive_factor`: of the velocity (3,); the least radius may be NaN for none."""

    cdef double radius, crawl

    def __init__(self, double radius, double crawl):
        """Bind the radius and the speed by which its limit is rounded off."""
        self.radius, self.crawl, self.rows = radius, crawl, 3
        self.take([(3, 3, True)])

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *v = at[0]
        cdef double speed = 1.0, share = 1.0
        cdef int a
        for a in range(3):
            r[a] = v[a]
        if not isnan(self.radius):
            speed = sqrt(v[0] * v[0] + self.crawl * self.crawl)
            share = self.radius / speed
            r[2] = v[2] * share
        if J != NULL:
            J[0] = J[4] = 1.0
            J[8] = share
            J[6] = 0.0 if isnan(self.radius) else -r[2] * v[0] / (speed * speed)
        return NAN


cdef class Contact(Source):
    """`factors.contact.contact_factor`: of a pose and the change (3,) of the ground."""

    cdef double normal[3]
    cdef double across[6]
    cdef double distance

    def __init__(self, const double[::1] normal, double distance, const double[:, ::1] across):
        """Bind the nominal plane (3,), its distance and the directions (2, 3) in which it turns."""
        cdef int a
        if normal.shape[0] != 3 or across.shape[0] != 2 or across.shape[1] != 3:
            raise ValueError("a normal (3,) and two directions (2, 3) are expected")
        for a in range(3):
            self.normal[a], self.across[a], self.across[3 + a] = normal[a], across[0, a], across[1, a]
        self.distance, self.rows = distance, 4
        self.take([(12, 6, True), (3, 3, True)])

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        cdef const double *R = at[0]
        cdef const double *t = at[0] + 9
        cdef const double *change = at[1]
        cdef double n[3]
        cdef double by[6]
        cdef double length = 0.0, along
        cdef int a, b
        for a in range(3):
            n[a] = self.normal[a] + change[1] * self.across[a] + change[2] * self.across[3 + a]
            length += n[a] * n[a]
        length = sqrt(length)
        for a in range(3):
            n[a] /= length
        r[0] = -self.distance - change[0]
        for a in range(3):
            r[0] += n[a] * t[a]
            r[1 + a] = R[3 * a + 1] - n[a]
        if J == NULL:
            return NAN
        for b in range(2):
            along = 0.0
            for a in range(3):
                along += n[a] * self.across[3 * b + a]
            for a in range(3):
                by[3 * b + a] = (self.across[3 * b + a] - n[a] * along) / length
        for a in range(3):
            J[3 + a] = n[0] * R[a] + n[1] * R[3 + a] + n[2] * R[6 + a]
            J[9 * (1 + a)] = R[3 * a + 2]
            J[9 * (1 + a) + 2] = -R[3 * a]
            for b in range(2):
                J[9 * (1 + a) + 7 + b] = -by[3 * b + a]
        J[6] = -1.0
        for b in range(2):
            J[7 + b] = t[0] * by[3 * b] + t[1] * by[3 * b + 1] + t[2] * by[3 * b + 2]
        return NAN


cdef inline void multiply(const double *A, const double *B, int n, int m, int k, double *C) noexcept nogil:
    """C (n, k) = A (n, m) B (m, k)."""
    cdef int i, j, l
    cdef double s
    for i in range(n):
        for j in range(k):
            s = 0.0
            for l in range(m):
                s += A[i * m + l] * B[l * k + j]
            C[i * k + j] = s


cdef inline void hat(const double *w, double *W) noexcept nogil:
    """The matrix (3, 3) of the cross product with w."""
    W[0] = W[4] = W[8] = 0.0
    W[1], W[2], W[5] = -w[2], w[1], -w[0]
    W[3], W[6], W[7] = w[2], -w[1], w[0]


cdef double series(double square, int first) noexcept nogil:
    """sum_k (-1)^k square^k / (first + 2 k)!: of a function of an angle near zero."""
    cdef double term = 1.0, total
    cdef int k
    for k in range(2, first + 1):
        term /= k
    total = term
    for k in range(1, 12):
        term *= -square / ((first + 2 * k - 1) * (first + 2 * k))
        total += term
    return total


cdef struct Shares:  # of an angle a: sin a / a, (1 - cos a) / a^2, (a - sin a) / a^3, and the next two
    double one, two, three, four, five


cdef Shares shares(double square) noexcept nogil:
    cdef Shares s
    cdef double a = sqrt(square)
    if square < 1.0:
        s.one, s.two, s.three = series(square, 1), series(square, 2), series(square, 3)
        s.four, s.five = series(square, 4), series(square, 5)
    else:
        s.one, s.two, s.three = sin(a) / a, (1.0 - cos(a)) / square, (a - sin(a)) / (square * a)
        s.four, s.five = (0.5 - s.two) / square, (1.0 / 6.0 - s.three) / square
    return s


cdef void turn_and_slide(const double *xi, Shares s, double *R, double *V) noexcept nogil:
    """R = exp(w) and V (3, 3), the left Jacobian there, of a twist (w, v)."""
    cdef double W[9]
    cdef double WW[9]
    cdef int i
    hat(xi, W)
    multiply(W, W, 3, 3, 3, WW)
    for i in range(9):
        R[i] = (1.0 if i % 4 == 0 else 0.0) + s.one * W[i] + s.two * WW[i]
        V[i] = (1.0 if i % 4 == 0 else 0.0) + s.two * W[i] + s.three * WW[i]


cdef void coupling(const double *w, const double *v, Shares s, double *Q) noexcept nogil:
    """How the left Jacobian's lower left block (3, 3) depends on the slide (Barfoot and Furgale 2014, eq. 102)."""
    cdef double W[9]
    cdef double U[9]
    cdef double WU[9]
    cdef double UW[9]
    cdef double WUW[9]
    cdef double WWU[9]
    cdef double UWW[9]
    cdef double WUWW[9]
    cdef double WWUW[9]
    cdef double last = 0.5 * (s.four - 3.0 * s.five)
    cdef int i
    hat(w, W)
    hat(v, U)
    multiply(W, U, 3, 3, 3, WU)
    multiply(U, W, 3, 3, 3, UW)
    multiply(WU, W, 3, 3, 3, WUW)
    multiply(W, WU, 3, 3, 3, WWU)
    multiply(UW, W, 3, 3, 3, UWW)
    multiply(WUW, W, 3, 3, 3, WUWW)
    multiply(W, WUW, 3, 3, 3, WWUW)
    for i in range(9):
        Q[i] = 0.5 * U[i] + s.three * (WU[i] + UW[i] + WUW[i]) + s.four * (WWU[i] + UWW[i] - 3.0 * WUW[i])
        Q[i] += last * (WUWW[i] + WWUW[i])


cdef void logarithm(const double *R, const double *t, double *xi, double *inverse) noexcept nogil:
    """The twist (w, v) whose exponential is (R, t), less than half a turn; and J^-1 (3, 3) of its left Jacobian."""
    cdef double w[3]
    cdef double W[9]
    cdef double WW[9]
    cdef double size, cosine = 0.5 * (R[0] + R[4] + R[8] - 1.0), angle, share, square
    cdef int i, most
    w[0], w[1], w[2] = 0.5 * (R[7] - R[5]), 0.5 * (R[2] - R[6]), 0.5 * (R[3] - R[1])
    size = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    angle = arctangent(size, cosine)
    if cosine > -0.9:
        share = 1.0 + size * size / 6.0 if size < 1e-5 else angle / size
        for i in range(3):
            xi[i] = share * w[i]
    else:  # near half a turn the axis is in the symmetric part
        most = 0 if R[0] >= R[4] and R[0] >= R[8] else (1 if R[4] >= R[8] else 2)
        for i in range(3):
            xi[i] = 0.5 * (R[3 * i + most] + R[3 * most + i])
        xi[most] -= cosine
        size = sqrt(xi[0] * xi[0] + xi[1] * xi[1] + xi[2] * xi[2])
        share = angle / size
        if xi[0] * w[0] + xi[1] * w[1] + xi[2] * w[2] < 0.0:
            share = -share
        for i in range(3):
            xi[i] *= share
    square = angle * angle
    share = 1.0 / 12.0 + square / 720.0 + square * square / 30240.0
    if square > 1e-3:
        share = (1.0 - 0.5 * angle * sin(angle) / (1.0 - cos(angle))) / square
    hat(xi, W)
    multiply(W, W, 3, 3, 3, WW)
    for i in range(9):
        inverse[i] = (1.0 if i % 4 == 0 else 0.0) - 0.5 * W[i] + share * WW[i]
    multiply(inverse, t, 3, 3, 1, xi + 3)


cdef extern from "math.h" nogil:
    double arctangent "atan2"(double y, double x)


cdef class Motion(Source):
    """`factors.motion.motion_factor`: of a pose, a velocity (3,) and the next pose."""

    cdef double seconds
    cdef double turn[9]
    cdef double shift[3]

    def __init__(self, double seconds, const double[:, :] camera):
        """Bind the time and the camera's motion (4, 4)."""
        cdef int a, b
        if camera.shape[0] != 4 or camera.shape[1] != 4:
            raise ValueError("the camera's motion (4, 4) is expected")
        for a in range(3):
            self.shift[a] = camera[a, 3]
            for b in range(3):
                self.turn[3 * a + b] = camera[a, b]
        self.seconds, self.rows = seconds, 6
        self.take([(12, 6, True), (3, 3, True), (12, 6, True)])

    cdef double fill(self, const double **at, double *r, double *J) noexcept nogil:
        """off = exp(-twist) (X^-1 C X'), r = log(off); see `factors.motion._Motion`."""
        cdef const double *R = at[0]
        cdef const double *t = at[0] + 9
        cdef const double *v = at[1]
        cdef double A[9]  # of C X', then between X and it
        cdef double a[3]
        cdef double B[9]
        cdef double b[3]
        cdef double E[9]  # exp(-twist), and its left Jacobian
        cdef double V[9]
        cdef double O[9]
        cdef double o[3]
        cdef double inverse[9]
        cdef double twist[6]
        cdef Shares s
        cdef int i, j
        multiply(self.turn, at[2], 3, 3, 3, A)
        multiply(self.turn, at[2] + 9, 3, 3, 1, a)
        for i in range(3):
            a[i] += self.shift[i] - t[i]
        for i in range(3):
            b[i] = R[i] * a[0] + R[3 + i] * a[1] + R[6 + i] * a[2]
            for j in range(3):
                B[3 * i + j] = R[i] * A[j] + R[3 + i] * A[3 + j] + R[6 + i] * A[6 + j]
        twist[0] = twist[2] = twist[4] = 0.0
        twist[1], twist[3], twist[5] = -self.seconds * v[2], -self.seconds * v[0], -self.seconds * v[1]
        s = shares(twist[1] * twist[1])
        turn_and_slide(twist, s, E, V)
        multiply(E, B, 3, 3, 3, O)
        multiply(E, b, 3, 3, 1, o)
        multiply(V, twist + 3, 3, 3, 1, a)
        for i in range(3):
            o[i] += a[i]
        logarithm(O, o, r, inverse)
        if J != NULL:
            self.differentiate(twist, s, V, B, b, O, o, r, inverse, J)
        return NAN

    cdef void differentiate(
        self, const double *twist, Shares s, const double *V, const double *B, const double *b, const double *O,
        const double *o, const double *r, const double *inverse, double *J
    ) noexcept nogil:
        """By the next pose L = J_r(r)^-1; by the pose -L Ad(between^-1); by the velocity -s L Ad(off^-1) J_r(twist)."""
        cdef double L[36]
        cdef double M[36]
        cdef double N[36]
        cdef double P[9]
        cdef double Q[9]
        cdef double u[3]
        cdef double w[3]
        cdef double square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        cdef int i, j
        # J_r(r)^-1 = J_l(-r)^-1: (T, 0; -T Q T, T) with T = J_l(-r)^-1 of the turn, the transpose of J_l(r)^-1.
        for i in range(3):
            u[i], w[i] = -r[i], -r[3 + i]
        for i in range(3):
            for j in range(3):
                P[3 * i + j] = inverse[3 * j + i]
        coupling(u, w, shares(square), Q)
        multiply(P, Q, 3, 3, 3, M)
        multiply(M, P, 3, 3, 3, Q)
        memset(L, 0, 36 * sizeof(double))
        for i in range(3):
            for j in range(3):
                L[6 * i + j] = L[6 * (3 + i) + 3 + j] = P[3 * i + j]
                L[6 * (3 + i) + j] = -Q[3 * i + j]
                J[15 * i + 9 + j] = J[15 * (3 + i) + 12 + j] = P[3 * i + j]
                J[15 * (3 + i) + 9 + j] = -Q[3 * i + j]
        backwards(B, b, M)
        multiply(L, M, 6, 6, 6, N)
        for i in range(6):
            for j in range(6):
                J[15 * i + j] = -N[6 * i + j]
        backwards(O, o, M)
        multiply(L, M, 6, 6, 6, N)
        # J_r(twist) = J_l(-twist): (V, 0; Q, V) of the negated twist, which `twist` here is.
        coupling(twist, twist + 3, s, Q)
        memset(M, 0, 36 * sizeof(double))
        for i in range(3):
            for j in range(3):
                M[6 * i + j] = M[6 * (3 + i) + 3 + j] = V[3 * i + j]
                M[6 * (3 + i) + j] = Q[3 * i + j]
        multiply(N, M, 6, 6, 6, L)
        for i in range(6):
            J[15 * i + 6] = -self.seconds * L[6 * i + 3]
            J[15 * i + 7] = -self.seconds * L[6 * i + 5]
            J[15 * i + 8] = -self.seconds * L[6 * i + 1]


cdef void backwards(const double *R, const double *t, double *A) noexcept nogil:
    """The adjoint (6, 6) of the inverse of (R, t): (R', 0; -R' [t], R')."""
    cdef double T[9]
    cdef double S[9]
    cdef double U[9]
    cdef int i, j
    for i in range(3):
        for j in range(3):
            S[3 * i + j] = R[3 * j + i]
    hat(t, T)
    multiply(S, T, 3, 3, 3, U)
    memset(A, 0, 36 * sizeof(double))
    for i in range(3):
        for j in range(3):
            A[6 * i + j] = A[6 * (3 + i) + 3 + j] = S[3 * i + j]
            A[6 * (3 + i) + j] = -U[3 * i + j]


cdef class _Place:
    """A source in a system: where its variables are, and its noise."""

    cdef Source source
    cdef int count, first  # of its variables; first of `Rows.columns`
    cdef int slots[8]  # where each variable is in `Rows.state`; -1 for one that there is not
    cdef const double[:, ::1] whitener
    cdef bint whitened
    cdef object robust


cdef class Rows:
    """Sources with their variables, evaluated together; the step to the minimum of what they are near a point.

    A point is the numbers of all variables, a step is local coordinates of one after the other. The quadratic form is
    kept as a lower triangle, each row from its first column that any source fills: Cholesky's factor fills no other. Its
    last row is J'(-r). So variables cost least where those that many others share come last.

    Attributes:
        size: Numbers of a step.
    """

    cdef readonly int size
    cdef list places
    cdef double[::1] state  # the variables, then constants
    cdef int numbers  # of a point
    cdef int[::1] starts, begins  # of each variable in a point and in a step, and their ends
    cdef int[::1] columns, sorted  # of all sources' Jacobians where in a step; a source's columns in that order
    cdef int[::1] heads  # (size + 1,) first column of each row of the form
    cdef Py_ssize_t[::1] lines  # (size + 2,) where column 0 of each row would be in `form` and `root`; their length
    cdef double[::1] form, root, inverses  # of the factor's diagonal
    cdef double[::1] r, J, spare
    cdef int[::1] where

    def __init__(self, list variables, list places):
        """Bind the sources.

        Args:
            variables: Numbers and dimension of each variable.
            places: Of each source: the source; for each of its variables the index, a constant (n,) or None for none;
                the whitener (rows, rows), upper triangular, or None where the rows are whitened; GTSAM's robust
                estimator or None.
        """
        cdef _Place place
        cdef Source source
        cdef int i, j, start, given, rows = 1, jacobian = 1, width = 1, total = 0, end
        cdef list constants = []
        self.starts = np.cumsum([0, *[size for size, _ in variables]]).astype(np.intc)
        self.begins = np.cumsum([0, *[dim for _, dim in variables]]).astype(np.intc)
        self.numbers = end = self.starts[len(variables)]
        self.size, self.places = self.begins[len(variables)], []
        self.columns = np.empty(sum([(<Source> each[0]).columns for each in places]) + 1, dtype=np.intc)
        for source, bound, whitener, robust in places:
            place = _Place()
            place.source, place.robust, place.count, place.first = source, robust, len(bound), total
            for i, (variable, (size, dim, needed)) in enumerate(zip(bound, source.takes, strict=True)):
                start, given = -1, size
                place.slots[i] = -1
                if isinstance(variable, int):
                    start, place.slots[i] = self.begins[variable], self.starts[variable]
                    given = self.starts[variable + 1] - place.slots[i]
                elif variable is not None:
                    given, place.slots[i] = len(variable), end
                    constants.append(variable)
                    end += given
                elif needed:
                    raise ValueError(f"variable {i} is missing")
                if given != size:
                    raise ValueError(f"variable {i} of {size} numbers is expected, not of {given}")
                for j in range(dim):
                    self.columns[total + j] = -1 if start < 0 else start + j
                total += dim
            place.whitened = whitener is None
            if whitener is not None:
                place.whitener = whitener
                if place.whitener.shape[0] != source.rows or place.whitener.shape[1] != source.rows:
                    raise ValueError("a whitener (rows, rows) is expected")
            rows, width = max(rows, source.rows), max(width, source.columns)
            jacobian = max(jacobian, source.rows * source.columns)
            self.places.append(place)
        state = np.zeros(end + 1)
        if constants:
            state[self.numbers:end] = np.concatenate(constants)
        self.state, self.r, self.J = state, np.empty(rows), np.empty(jacobian)
        self.spare, self.where = np.empty(2 * (width + 1)), np.empty(width + 1, dtype=np.intc)
        self.outline()

    def with_source(self, Source source not None):
        """The same rows with another source in the place of the first one, of the same variables.

        Raises:
            ValueError: It has other rows or takes other variables.
        """
        cdef Rows other = Rows.__new__(Rows)
        cdef _Place first = self.places[0], place = _Place()
        if source.takes != first.source.takes or source.rows != first.source.rows:
            raise ValueError("a source of the same rows and variables is expected")
        place.source, place.count, place.first = source, first.count, first.first
        memcpy(place.slots, first.slots, sizeof(place.slots))
        place.whitener, place.whitened, place.robust = first.whitener, first.whitened, first.robust
        other.size, other.numbers, other.places = self.size, self.numbers, [place, *self.places[1:]]
        other.starts, other.begins, other.columns, other.sorted = self.starts, self.begins, self.columns, self.sorted
        other.heads, other.lines, other.state = self.heads, self.lines, np.array(self.state)
        other.r, other.J = np.empty(self.r.shape[0]), np.empty(self.J.shape[0])
        other.spare, other.where = np.empty(self.spare.shape[0]), np.empty(self.where.shape[0], dtype=np.intc)
        other.form, other.root = np.empty(self.form.shape[0]), np.empty(self.form.shape[0])
        other.inverses = np.empty(self.size + 1)
        return other

    cdef int outline(self) except -1:
        """Find which numbers of the quadratic form may be filled, and the order of each source's columns."""
        cdef _Place place
        cdef int i, j, k, least, most = self.size
        cdef int *columns
        cdef int *order
        self.sorted = np.empty(self.columns.shape[0], dtype=np.intc)
        self.heads = np.arange(most + 1, dtype=np.intc)
        self.lines = np.empty(most + 2, dtype=np.intp)
        for place in self.places:
            columns, order, least = &self.columns[place.first], &self.sorted[place.first], most
            for i in range(place.source.columns):
                j = columns[i]
                least = j if 0 <= j < least else least
                k = i
                while k > 0 and columns[order[k - 1]] > j:  # few are out of order
                    order[k] = order[k - 1]
                    k -= 1
                order[k] = i
            for i in range(place.source.columns):
                j = columns[i]
                if j >= 0 and least < self.heads[j]:
                    self.heads[j] = least
        self.heads[most] = 0
        self.lines[0] = 0
        for i in range(most + 1):  # a row is moved back by its first column
            self.lines[i + 1] = self.lines[i] + i + 1 - self.heads[i]
        for i in range(most + 1):
            self.lines[i] -= self.heads[i]
        self.form, self.root = np.empty(self.lines[most + 1]), np.empty(self.lines[most + 1])
        self.inverses = np.empty(most + 1)
        return 0

    def point(self, list variables):
        """(n,) numbers of variables; a pose is (4, 4)."""
        cdef const double[:, :] pose
        cdef const double[::1] vector
        cdef int i, j, start
        found = np.empty(self.numbers)
        cdef double[::1] numbers = found
        if len(variables) != self.starts.shape[0] - 1:
            raise ValueError(f"{self.starts.shape[0] - 1} variables are expected")
        for i in range(len(variables)):
            start = self.starts[i]
            if variables[i].ndim == 2:
                pose = variables[i]
                if self.starts[i + 1] - start != 12 or pose.shape[0] != 4 or pose.shape[1] != 4:
                    raise ValueError("a variable of another size")
                for j in range(12):
                    numbers[start + j] = pose[j // 3, j % 3] if j < 9 else pose[j - 9, 3]
                continue
            vector = variables[i]
            if vector.shape[0] != self.starts[i + 1] - start:
                raise ValueError("a variable of another size")
            for j in range(vector.shape[0]):
                numbers[start + j] = vector[j]
        return found

    def moved(self, const double[::1] point, const double[::1] step):
        """The point (n,) that a step (size,) leads to."""
        cdef int i, j, start, begin, count
        cdef double[::1] there
        if point.shape[0] != self.numbers or step.shape[0] != self.size:
            raise ValueError(f"a point ({self.numbers},) and a step ({self.size},) are expected")
        found = np.empty(self.numbers)
        there = found
        for i in range(self.starts.shape[0] - 1):
            start, begin, count = self.starts[i], self.begins[i], self.begins[i + 1] - self.begins[i]
            if count == self.starts[i + 1] - start:
                for j in range(count):
                    there[start + j] = point[start + j] + step[begin + j]
            elif count == 6:
                move_pose(&point[start], &step[begin], &there[start])
            else:
                move_plane(&point[start], &step[begin], &there[start])
        return found

    cdef int go(self, const double[::1] point) except -1:
        """Take over a point's numbers."""
        if point.shape[0] != self.numbers:
            raise ValueError(f"a point ({self.numbers},) is expected")
        if self.numbers:
            memcpy(&self.state[0], &point[0], self.numbers * sizeof(double))
        return 0

    def error(self, const double[::1] point):
        """Energy at a point, nats."""
        cdef _Place place
        cdef double total = 0.0
        self.go(point)
        for place in self.places:
            total += self.evaluated(place, False)
        return total

    def error_of(self, const double[::1] point, list some):
        """Energy of some sources, by their places, at a point, nats."""
        cdef double total = 0.0
        self.go(point)
        for place in some:
            total += self.evaluated(self.places[place], False)
        return total

    def linearise(self, const double[::1] point):
        """Energy at a point, nats; the quadratic form there is what `step` and others are about from then on."""
        cdef _Place place
        cdef double total = 0.0
        self.go(point)
        memset(&self.form[0], 0, self.form.shape[0] * sizeof(double))
        for place in self.places:
            total += self.evaluated(place, True)
        return total

    def information(self):
        """(size + 1, size + 1) the quadratic form: J'J, and beside it J'(-r)."""
        cdef int i, j
        found = np.zeros((self.size + 1, self.size + 1))
        cdef double[:, ::1] full = found
        for i in range(self.size + 1):
            for j in range(self.heads[i], i + 1):
                full[i, j] = full[j, i] = self.form[self.lines[i] + j]
        return found

    def step(self):
        """(size,) to the minimum of the quadratic form; None where it has none."""
        cdef int i, k, n = self.size
        cdef double *row
        cdef double s
        cdef bint determined
        found = np.empty(n)
        cdef double[::1] x = found
        with nogil:
            determined = self.factorised(SINGULAR)
            if determined:
                row = &self.root[0] + self.lines[n]
                for i in range(n):
                    x[i] = row[i]
                for i in range(n - 1, -1, -1):
                    row = &self.root[0] + self.lines[i]
                    s = x[i] = x[i] / row[i]
                    for k in range(self.heads[i], i):
                        x[k] -= s * row[k]
        return found if determined else None

    def covariance(self, int begin, double least):
        """The inverse of the quadratic form, as far as it is where Cholesky's factor is (Takahashi et al. 1973).

        Args:
            begin: Of the rows from here on.
            least: Share of a row's information that all before it must leave.

        Returns:
            A function from indices (m,) of a step to (m, m) of the inverse; None where it has none.
        """
        cdef int i, k, n = self.size, count
        cdef double[::1] Z, shares, sums
        cdef int[::1] below
        cdef double *row
        if not 0 <= begin <= n:
            raise ValueError("a place in a step is expected")
        if not self.factorised(least):
            return None
        Z, shares, sums = np.empty(self.root.shape[0]), np.empty(n + 1), np.empty(n + 1)
        below = np.empty(n + 1, dtype=np.intc)
        with nogil:
            for i in range(n - 1, begin - 1, -1):
                count = 0
                for k in range(i + 1, n):
                    if self.heads[k] <= i:
                        below[count], shares[count] = k, self.root[self.lines[k] + i]
                        count += 1
                self.column(i, &below[0], &shares[0], count, &Z[0], &sums[0])
        return Inverse(self, begin, Z)

    cdef void column(
        self, int i, const int *below, const double *shares, int count, double *Z, double *sums
    ) noexcept nogil:
        """Column i of the inverse, from those after it; `shares` is the factor's in the rows below."""
        cdef int j, k
        cdef double pivot = self.root[self.lines[i] + i], z, total = 0.0
        cdef double *row
        memset(sums, 0, count * sizeof(double))
        for j in range(count):
            row = Z + self.lines[below[j]]
            for k in range(j):
                z = row[below[k]]
                sums[j] += z * shares[k]
                sums[k] += z * shares[j]
            sums[j] += row[below[j]] * shares[j]
        for j in range(count):
            Z[self.lines[below[j]] + i] = -sums[j] / pivot
            total += shares[j] * sums[j]
        Z[self.lines[i] + i] = (1.0 + total) / (pivot * pivot)

    cdef bint factorised(self, double least) noexcept nogil:
        """Cholesky's factor of the quadratic form; False where so small a share of a number of its diagonal is left.

        Two rows at a time, whose numbers need not wait for one another.
        """
        cdef int i, j, k, first, begin, n = self.size
        cdef double both[2]
        cdef double *row
        cdef double *next_row
        for i in range(0, n + 1, 2):
            k = i + 1
            if k > n:
                return self.finished(i, self.heads[i], least)
            row, next_row = &self.root[0] + self.lines[i], &self.root[0] + self.lines[k]
            first = max(self.heads[i], self.heads[k])
            for j in range(self.heads[i], min(first, i)):
                self.eliminate(i, j)
            for j in range(self.heads[k], min(first, i)):
                self.eliminate(k, j)
            for j in range(first, i):
                begin = max(first, self.heads[j])
                if self.heads[i] != self.heads[k] and self.heads[j] < first:  # the sums begin elsewhere
                    self.eliminate(i, j)
                    self.eliminate(k, j)
                    continue
                inner_of_two(row + begin, next_row + begin, &self.root[0] + self.lines[j] + begin, j - begin, both)
                row[j] = (self.form[self.lines[i] + j] - both[0]) * self.inverses[j]
                next_row[j] = (self.form[self.lines[k] + j] - both[1]) * self.inverses[j]
            if not self.finished(i, i, least) or not self.finished(k, max(i, self.heads[k]), least):
                return False
        return True

    cdef inline void eliminate(self, int i, int j) noexcept nogil:
        """Number j of row i of the factor, after those before it."""
        cdef int both = max(self.heads[i], self.heads[j])
        cdef double *row = &self.root[0] + self.lines[i]
        cdef double *other = &self.root[0] + self.lines[j]
        row[j] = (self.form[self.lines[i] + j] - inner(row + both, other + both, j - both)) * self.inverses[j]

    cdef bint finished(self, int i, int begin, double least) noexcept nogil:
        """Row i of the factor from some number on, and its diagonal, which the last row has not."""
        cdef int j
        cdef double s
        cdef double *row = &self.root[0] + self.lines[i]
        for j in range(begin, i):
            self.eliminate(i, j)
        if i == self.size:
            return True
        s = self.form[self.lines[i] + i]
        row[i] = s - inner(row + self.heads[i], row + self.heads[i], i - self.heads[i])
        if not least * s < row[i] < INFINITY:
            return False
        row[i] = sqrt(row[i])
        self.inverses[i] = 1.0 / row[i]
        return True

    def judge(self, const double[::1] point, looks):
        """What the sources that judge find out of a point.

        Args:
            point: (n,).
            looks: Of each of them whether all of it is made anew.

        Returns:
            (M,) numbers of each, one after the other.
        """
        cdef _Place place
        cdef const double *at[8]
        cdef double[::1] found
        cdef list own = [each for each in self.places if (<_Place> each).source.judged]
        every = [np.empty((<_Place> each).source.judged) for each in own]
        self.go(point)
        for place, found, look in zip(own, every, looks, strict=True):
            self.bound(place, at)
            place.source.judge(at, look, &found[0])
        return every

    cdef void bound(self, _Place place, const double **at):
        cdef int i
        for i in range(place.count):
            at[i] = &self.state[place.slots[i]] if place.slots[i] >= 0 else NULL

    cdef double evaluated(self, _Place place, bint want) except? -1.0:
        cdef const double *at[8]
        cdef double energy, squares = 0.0, weight = 1.0
        cdef double *J = &self.J[0] if want else NULL
        cdef double *r = &self.r[0]
        cdef int i, rows = place.source.rows, columns = place.source.columns
        self.bound(place, at)
        with nogil:
            if want:
                memset(J, 0, rows * columns * sizeof(double))
            energy = place.source.fill(at, r, J)
            if not place.whitened:
                whiten(place.whitener, r, J, rows, columns)
            if isnan(energy):
                for i in range(rows):
                    squares += r[i] * r[i]
                energy = 0.5 * squares
        if place.robust is not None:
            energy = place.robust.loss(sqrt(squares))
            if want:
                weight = place.robust.weight(sqrt(squares))
        if want:
            with nogil:
                self.add(r, J, rows, columns, &self.columns[place.first], &self.sorted[place.first], weight)
        return energy

    cdef void add(
        self, const double *r, const double *J, int rows, int columns, const int *place, const int *order, double weight
    ) noexcept nogil:
        """Add weighted rows to the quadratic form, two at a time: those of a keypoint are about the same variables."""
        cdef int i, j, k, count
        cdef double value, other
        cdef double *values = &self.spare[0]
        cdef double *others = values + columns + 1
        cdef double *line
        cdef const double *row
        cdef const double *next_row
        cdef int *where = &self.where[0]
        for i in range(0, rows, 2):
            count = 0
            row = J + i * columns
            next_row = row + columns if i + 1 < rows else NULL
            for j in range(columns):
                k = order[j]
                value, other = row[k], (next_row[k] if next_row != NULL else 0.0)
                if place[k] >= 0 and (value != 0.0 or other != 0.0):
                    values[count], others[count], where[count] = value, other, place[k]
                    count += 1
            values[count], others[count], where[count] = -r[i], (-r[i + 1] if next_row != NULL else 0.0), self.size
            count += 1
            for j in range(count):
                value, other = weight * values[j], weight * others[j]
                line = &self.form[0] + self.lines[where[j]]
                for k in range(j + 1):
                    line[where[k]] = line[where[k]] + value * values[k] + other * others[k]


cdef class Inverse:
    """Numbers of the inverse of a quadratic form: `Rows.covariance`."""

    cdef Rows rows
    cdef int begin
    cdef const double[::1] numbers

    def __init__(self, Rows rows, int begin, const double[::1] numbers):
        """Bind the numbers."""
        self.rows, self.begin, self.numbers = rows, begin, numbers

    def __call__(self, const Py_ssize_t[::1] indices):
        """(m, m) of the inverse by indices (m,) of a step.

        Raises:
            KeyError: Variables of which nothing is about both.
        """
        cdef int i, j, m = indices.shape[0]
        cdef Py_ssize_t high, low
        found = np.empty((m, m))
        cdef double[:, ::1] block = found
        for i in range(m):
            for j in range(i + 1):
                high, low = max(indices[i], indices[j]), min(indices[i], indices[j])
                if not self.begin <= low <= high < self.rows.size or low < self.rows.heads[high]:
                    raise KeyError(f"numbers {low} and {high} of a step")
                block[i, j] = block[j, i] = self.numbers[self.rows.lines[high] + low]
        return found


cdef void move_pose(const double *X, const double *xi, double *moved) noexcept nogil:
    """X exp(xi), as GTSAM's retraction."""
    cdef double E[9]
    cdef double V[9]
    cdef double shift[3]
    cdef int i
    turn_and_slide(xi, shares(xi[0] * xi[0] + xi[1] * xi[1] + xi[2] * xi[2]), E, V)
    multiply(X, E, 3, 3, 3, moved)
    multiply(V, xi + 3, 3, 3, 1, shift)
    multiply(X, shift, 3, 3, 1, moved + 9)
    for i in range(3):
        moved[9 + i] += X[9 + i]


cdef void move_plane(const double *plane, const double *xi, double *moved) noexcept nogil:
    """As GTSAM's retraction: the normal along a great circle; its new tangent basis is across its least axis."""
    cdef double slide[3]
    cdef double angle = 0.0, length = 0.0, share
    cdef double *n = moved
    cdef int a, least = 0
    for a in range(3):
        slide[a] = plane[4 + 2 * a] * xi[0] + plane[5 + 2 * a] * xi[1]
        angle += slide[a] * slide[a]
    angle = sqrt(angle)
    share = sin(angle) / angle if angle > 0.0 else 1.0
    for a in range(3):
        n[a] = cos(angle) * plane[a] + share * slide[a]
        length += n[a] * n[a]
    for a in range(3):
        n[a] /= sqrt(length)
        least = a if fabs(n[a]) < fabs(n[least]) else least
    moved[3] = plane[3] + xi[2]
    cdef int b = (least + 1) % 3, c = (least + 2) % 3
    length = sqrt(n[b] * n[b] + n[c] * n[c])
    moved[4 + 2 * least] = 0.0  # the cross product of the normal with the axis, and of the normal with that
    moved[4 + 2 * b], moved[4 + 2 * c] = n[c] / length, -n[b] / length
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        moved[5 + 2 * a] = n[b] * moved[4 + 2 * c] - n[c] * moved[4 + 2 * b]


cdef void whiten(
    const double[:, ::1] R, double *r, double *J, int rows, int columns
) noexcept nogil:
    """Rows times an upper triangular whitener."""
    cdef int i, j, k
    for i in range(rows):  # an upper triangle: what is overwritten is not needed any more
        r[i] *= R[i, i]
        for j in range(i + 1, rows):
            r[i] += R[i, j] * r[j]
        if J == NULL:
            continue
        for k in range(columns):
            J[i * columns + k] *= R[i, i]
        for j in range(i + 1, rows):
            if R[i, j] != 0.0:
                for k in range(columns):
                    J[i * columns + k] += R[i, j] * J[j * columns + k]
