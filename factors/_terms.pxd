# cython: language_level=3, cdivision=True
"""The equations of single residuals, compiled into whatever uses them.

Those of `factors.projection` and `factors.mixture`, which keep them readable; the tests compare.
"""

from libc.math cimport exp, log, sqrt

cdef enum Form:  # as `factors.mixture.Form`
    WEIGHTED = 0
    LOSS = 1
    NEWTON = 2
    MAJORISED = 3


cdef inline double project(
    const double *C, const double *R, const double *t, const double *X, double least, double *uv, double *G
) noexcept nogil:
    """Pixel of an object point X, and in G (2, 3) its derivative by the camera point; returns the true depth."""
    cdef double x = R[0] * X[0] + R[1] * X[1] + R[2] * X[2] + t[0]
    cdef double y = R[3] * X[0] + R[4] * X[1] + R[5] * X[2] + t[1]
    cdef double depth = R[6] * X[0] + R[7] * X[1] + R[8] * X[2] + t[2]
    cdef double inverse = 1.0 / (depth if depth > least else least)
    x *= inverse
    y *= inverse
    uv[0] = C[0] * x + C[1] * y + C[2]
    uv[1] = C[4] * y + C[5]
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
    int form, double stiffest, double right, double wrong, double s, double *stretch, double *weight, double *bend
) noexcept nogil:
    """Factor on a residual of squared length s, root of its weight, what is taken off along it (`factors.mixture`)."""
    cdef double w, loss, rest
    bend[0] = 0.0
    if form == WEIGHTED:
        stretch[0] = weight[0] = sqrt(right)
        return
    mixture(right, wrong, s, &w, &loss)
    weight[0] = sqrt(w)
    if form == LOSS:
        stretch[0] = sqrt(2.0 * loss / s) if s > 0.0 else weight[0]
        return
    if form == MAJORISED:
        stretch[0] = weight[0]
        return
    rest = 1.0 - (1.0 - w) * s
    rest = sqrt(rest if rest > stiffest else stiffest)
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
