# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""What surrounds the solver and costs, compiled: poses from points, extents of a turned outline, a ray cast, and the
acceleration of an iteration.

Each has a numpy version beside the function that calls it, which the tests compare with.
"""

from libc.math cimport INFINITY, fabs, sqrt

import numpy as np

cdef extern from *:
    unsigned int FGRECON_SOURCES

SOURCES = FGRECON_SOURCES  # what it was compiled from, for `factors.native`


cdef double parts(const double *D, const double *L, const double *q, double *g, double *H) noexcept nogil:
    """F(q) = m(q)' S m(q) + q' L q with gradient (4,) and Hessian (4, 4); D (10, 16) are S's derivatives."""
    cdef int i, j, k, n
    cdef double m, h, l, value = 0.0
    for i in range(16):
        H[i] = 0.0
    k = 0
    for i in range(4):
        for j in range(i, 4):
            m = q[i] * q[j]
            for n in range(16):
                H[n] += m * D[16 * k + n]
            k += 1
    for i in range(4):
        h = l = 0.0
        for j in range(4):
            h += H[4 * i + j] * q[j]
            l += L[4 * i + j] * q[j]
        value += (h / 12.0 + l) * q[i]
        g[i] = h / 3.0 + 2.0 * l
    for i in range(16):
        H[i] += 2.0 * L[i]
    return value


cdef bint solve(const double *H, double damping, const double *g, double *x) noexcept nogil:
    """x = -(H + damping I)^-1 g (4,) by Cholesky; False where the matrix is not positive definite."""
    cdef double C[16]
    cdef double s
    cdef int i, j, k
    for i in range(4):
        for j in range(i + 1):
            s = H[4 * i + j] + (damping if i == j else 0.0)
            for k in range(j):
                s -= C[4 * i + k] * C[4 * j + k]
            if i != j:
                C[4 * i + j] = s / C[4 * j + j]
            elif s > 0.0:
                C[4 * i + i] = sqrt(s)
            else:
                return False
    for i in range(4):
        s = -g[i]
        for k in range(i):
            s -= C[4 * i + k] * x[k]
        x[i] = s / C[4 * i + i]
    for i in range(3, -1, -1):
        s = x[i]
        for k in range(i + 1, 4):
            s -= C[4 * k + i] * x[k]
        x[i] = s / C[4 * i + i]
    return True


cdef int descended(
    const double *D, const double *L, const double *starts, int B, int steps, double converged, double same,
    double *found, double *values
) noexcept nogil:
    """Minima (B', 4) of F, and F there, from starts (B, 4) by damped Newton steps; how many they are."""
    cdef int b, i, j, step, count = 0
    cdef double q[4]
    cdef double x[4]
    cdef double trial[4]
    cdef double g[4]
    cdef double H[16]
    cdef double trial_g[4]
    cdef double trial_H[16]
    cdef double value, trial_value, damping, size, cosine, first, second, least
    cdef bint done, known
    for b in range(B):
        for i in range(4):
            q[i] = starts[4 * b + i]
        value = parts(D, L, q, g, H)
        damping, done = 0.0, False
        for step in range(steps):
            least = 1e-3 * (fabs(H[0]) + fabs(H[5]) + fabs(H[10]) + fabs(H[15])) + 1e-12
            while damping < INFINITY and not solve(H, damping, g, x):
                damping = 4.0 * damping if damping >= least else least
            if not damping < INFINITY:
                break
            size = 0.0
            for i in range(4):
                trial[i] = q[i] + x[i]
                size = fabs(x[i]) if fabs(x[i]) > size else size
            done = size < converged
            trial_value = parts(D, L, trial, trial_g, trial_H)
            if trial_value < value or done:
                value, damping = trial_value, (0.1 * damping if damping > least else 0.0)
                for i in range(4):
                    q[i], g[i] = trial[i], trial_g[i]
                for i in range(16):
                    H[i] = trial_H[i]
            else:
                damping = 4.0 * damping if damping >= least else least
            if done:
                break
        if not done or value >= 0.0:
            continue
        known = False
        for j in range(count):
            cosine = first = second = 0.0
            for i in range(4):
                cosine += q[i] * found[4 * j + i]
                first += q[i] * q[i]
                second += found[4 * j + i] * found[4 * j + i]
            known |= fabs(cosine) > same * sqrt(first * second)
        if not known:
            values[count] = value
            for i in range(4):
                found[4 * count + i] = q[i]
            count += 1
    return count


cdef inline int pair(int i, int j) noexcept nogil:
    """Place of q_i q_j in m(q)."""
    return 4 * i - i * (i + 1) // 2 + j if i < j else 4 * j - j * (j + 1) // 2 + i


cdef void derivatives_of(const double *S, double *D) noexcept nogil:
    """D (10, 16): the Hessian of m' S m, flattened, is m(q)' D; S is (10, 10)."""
    cdef int a, b, k, x, y, twice
    for k in range(160):
        D[k] = 0.0
    for x in range(4):
        for y in range(4):
            twice = 2 if x == y else 1
            for k in range(10):
                D[16 * k + 4 * x + y] += 2.0 * twice * S[10 * k + pair(x, y)]
            for a in range(4):
                for b in range(4):
                    twice = (2 if x == a else 1) * (2 if y == b else 1)
                    D[16 * pair(a, b) + 4 * x + y] += 2.0 * twice * S[10 * pair(x, a) + pair(y, b)]


cdef double scaled(double *numbers, int count) noexcept nogil:
    """Divide by the norm, which is returned."""
    cdef int i
    cdef double norm = 0.0
    for i in range(count):
        norm += numbers[i] * numbers[i]
    norm = sqrt(norm)
    for i in range(count):
        numbers[i] /= norm
    return norm


cdef int lengthened(
    const double *D, const double *L, const double[:, ::1] seeds, double *starts
) noexcept nogil:
    """The minimum (B', 4) of F along each seed; those along which it only grows are left out. How many they are."""
    cdef int b, i, j, count = 0
    cdef double g[4]
    cdef double H[16]
    cdef double quadratic, quartic, length
    for b in range(seeds.shape[0]):
        quadratic = 0.0
        for i in range(4):
            for j in range(4):
                quadratic += seeds[b, i] * L[4 * i + j] * seeds[b, j]
        quartic = parts(D, L, &seeds[b, 0], g, H) - quadratic
        if quadratic < 0.0 < quartic:
            length = sqrt(-quadratic / (2.0 * quartic))
            for i in range(4):
                starts[4 * count + i] = seeds[b, i] * length
            count += 1
    return count


cdef void residual_rows(const double *X, double u, const double *mean, double *row) noexcept nogil:
    """Six numbers of a row that depend on a point: X, then mean - u X; the others are zero."""
    cdef int a
    for a in range(3):
        row[a], row[3 + a] = X[a], mean[a] - u * X[a]


cdef void averages(
    const double[:, ::1] X, const double[:, ::1] image_points, const double[::1] w, double *mean, double *means
) noexcept nogil:
    """Weighted means (2,) of the image points, and (2, 3) of their products with the points."""
    cdef int i, a, c
    for c in range(2):
        mean[c] = means[3 * c] = means[3 * c + 1] = means[3 * c + 2] = 0.0
    for i in range(X.shape[0]):
        for c in range(2):
            mean[c] += w[i] * image_points[i, c]
            for a in range(3):
                means[3 * c + a] += w[i] * image_points[i, c] * X[i, a]


cdef double normal_equations(
    const double[:, ::1] X, const double[:, ::1] image_points, const double[::1] w, const double *mean,
    const double *means, double *square, double *right, double *widest
) noexcept nogil:
    """A'A (9, 9) and A'b (9,) of the cost |A r - b|^2; |b|^2, and the largest deviation of an image point."""
    cdef int i, j, k, a, c
    cdef double row[6]
    cdef double full[9]
    cdef double off, spread = 0.0
    widest[0] = 0.0
    for i in range(81):
        square[i] = 0.0
    for i in range(9):
        right[i] = 0.0
    for i in range(X.shape[0]):
        for c in range(2):
            residual_rows(&X[i, 0], image_points[i, c], means + 3 * c, row)
            off = image_points[i, c] - mean[c]
            widest[0], spread = max(widest[0], fabs(off)), spread + w[i] * off * off
            for a in range(9):
                full[a] = 0.0
            for a in range(3):
                full[3 * c + a], full[6 + a] = row[a], row[3 + a]
            for j in range(9):
                right[j] += w[i] * full[j] * off
                for k in range(9):
                    square[9 * j + k] += w[i] * full[j] * full[k]
    return spread


cdef void quartic_of(
    const double *square, const double *right, const double[:, ::1] forms, double *S, double *L
) noexcept nogil:
    """S (10, 10) and L (4, 4) of F, for r = forms m(q)."""
    cdef int i, j, k, l
    cdef double half[90]
    cdef double total
    for j in range(9):
        for k in range(10):
            total = 0.0
            for l in range(9):
                total += square[9 * j + l] * forms[l, k]
            half[10 * j + k] = total
    for j in range(10):
        for k in range(10):
            total = 0.0
            for l in range(9):
                total += forms[l, j] * half[10 * l + k]
            S[10 * j + k] = total
    for i in range(4):
        for j in range(4):
            total = 0.0
            for l in range(9):
                total -= 2.0 * right[l] * forms[l, pair(i, j)]
            L[4 * i + j] = total if i == j else 0.5 * total


cdef void summary_of(
    const double[:, ::1] X, const double[:, ::1] image_points, const double[::1] w, const double *mean,
    const double *means, const double[:, ::1] forms, const double *q, double *r, double *summary
) noexcept nogil:
    """r (9,) of a minimum q; its squared length, the rms, and the share of the weight behind the camera."""
    cdef int i, k, l, a, c
    cdef double row[6]
    cdef double error
    summary[0] = summary[1] = summary[2] = 0.0
    for i in range(4):
        summary[0] += q[i] * q[i]
    for l in range(9):
        r[l] = 0.0
        for i in range(4):
            for k in range(i, 4):
                r[l] += forms[l, pair(i, k)] * q[i] * q[k]
    for i in range(X.shape[0]):
        for c in range(2):
            residual_rows(&X[i, 0], image_points[i, c], means + 3 * c, row)
            error = mean[c] - image_points[i, c]
            for a in range(3):
                error += row[a] * r[3 * c + a] + row[3 + a] * r[6 + a]
            summary[1] += w[i] * error * error
        if 1.0 + r[6] * X[i, 0] + r[7] * X[i, 1] + r[8] * X[i, 2] <= 0.0:
            summary[2] += w[i]
    summary[1] = sqrt(summary[1])


def pnp(
    const double[:, ::1] X, const double[:, ::1] image_points, const double[::1] w, const double[:, ::1] forms,
    const double[:, ::1] seeds, int steps, double converged, double same
):
    """Minima of the cost of `fgrecon.solve.proposals.aspnp` that are found by descending from seeds.

    Args:
        X: (N, 3) points from their centroid, of size one. image_points: (N, 2). w: (N,) of sum one.
        forms: (9, 10) with r = forms m(q). seeds: (B, 4).
        steps, converged, same: As `fgrecon.solve.proposals._polynomial` has them.

    Returns:
        (B', 9) r of each, and (B', 3): the squared length of q, the rms, and the share of the weight behind the camera;
        then the rms of an object at infinity, and the largest deviation of an image point from the mean.
    """
    cdef int i, j, count
    cdef double mean[2]
    cdef double means[6]
    cdef double square[81]
    cdef double right[9]
    cdef double S[100]
    cdef double L[16]
    cdef double D[160]
    cdef double spread, widest, scale
    cdef double[:, ::1] starts = np.empty((seeds.shape[0], 4))
    cdef double[:, ::1] q = np.empty((seeds.shape[0], 4))
    cdef double[::1] values = np.empty(seeds.shape[0])
    cdef double[:, ::1] r, summary
    if X.shape[1] != 3 or image_points.shape[1] != 2 or not X.shape[0] == image_points.shape[0] == w.shape[0]:
        raise ValueError("X (N, 3), image_points (N, 2) and w (N,) are wanted")
    if forms.shape[0] != 9 or forms.shape[1] != 10 or seeds.shape[1] != 4:
        raise ValueError("forms (9, 10) and seeds (B, 4) are wanted")
    with nogil:
        averages(X, image_points, w, mean, means)
        spread = normal_equations(X, image_points, w, mean, means, square, right, &widest)
        quartic_of(square, right, forms, S, L)
        scale = scaled(S, 100)
        scale = sqrt(scaled(L, 16) / scale)
        derivatives_of(S, D)
        count = lengthened(D, L, seeds, &starts[0, 0])
        count = descended(D, L, &starts[0, 0], count, steps, converged, same, &q[0, 0], &values[0])
    r, summary = np.empty((count, 9)), np.empty((count, 3))
    with nogil:
        for j in range(count):
            for i in range(4):
                q[j, i] *= scale
            summary_of(X, image_points, w, mean, means, forms, &q[j, 0], &r[j, 0], &summary[j, 0])
    return np.asarray(r), np.asarray(summary), sqrt(spread), widest


def extents(const double[:, ::1] points, const double[:, :, ::1] rotation, double u, double v):
    """Extents of turned points across a ray (u, v, 1).

    Args:
        points: (P, 3). rotation: (H, 3, 3).

    Returns:
        (H, 2) least and (H, 2) greatest x - u z and y - v z, and (H,) least z.
    """
    cdef int P = points.shape[0], H = rotation.shape[0], p, h, a, b
    cdef double turned[3]
    cdef double[:, ::1] low = np.full((H, 2), np.inf), high = np.full((H, 2), -np.inf)
    cdef double[::1] near = np.full(H, np.inf)
    cdef double x, y, z
    if points.shape[1] != 3 or rotation.shape[1] != 3 or rotation.shape[2] != 3:
        raise ValueError("points (P, 3) and rotations (H, 3, 3) are wanted")
    with nogil:
        for h in range(H):
            for p in range(P):
                for a in range(3):
                    turned[a] = 0.0
                    for b in range(3):
                        turned[a] += rotation[h, a, b] * points[p, b]
                x, y, z = turned[0], turned[1], turned[2]
                x -= u * z
                y -= v * z
                low[h, 0] = x if x < low[h, 0] else low[h, 0]
                low[h, 1] = y if y < low[h, 1] else low[h, 1]
                high[h, 0] = x if x > high[h, 0] else high[h, 0]
                high[h, 1] = y if y > high[h, 1] else high[h, 1]
                near[h] = z if z < near[h] else near[h]
    return np.asarray(low), np.asarray(high), np.asarray(near)


def nearest_hits(
    const double[::1] u, const double[::1] v, const double[::1] value, const int[:, ::1] faces,
    const double[::1] point_u, const double[::1] point_v, const double[::1] depth, double edge, bint inverse
):
    """Depth of the first triangle before each point of an image, or the point's own.

    Args:
        u, v, value: (V,) image coordinates of the vertices, and what is linear over a triangle's image.
        faces: (F, 3). point_u, point_v: (K,).
        depth: (K,) the points' own depths.
        edge: How far below zero a barycentric coordinate may be.
        inverse: Whether the values are inverse depths.

    Returns:
        (K,).
    """
    cdef int F = faces.shape[0], K = point_u.shape[0], V = u.shape[0], f, k
    cdef double[::1] nearest = np.array(depth)
    cdef double ua, va, ub, vb, uc, vc, area, left, right, top, bottom, du, dv, alpha, beta, gamma, hit
    if v.shape[0] != V or value.shape[0] != V or faces.shape[1] != 3 or point_v.shape[0] != K or depth.shape[0] != K:
        raise ValueError("arrays of different lengths")
    if F and (np.min(faces) < 0 or np.max(faces) >= V):
        raise ValueError("a face has no such vertex")
    with nogil:
        for f in range(F):
            ua, va = u[faces[f, 0]], v[faces[f, 0]]
            ub, vb = u[faces[f, 1]] - ua, v[faces[f, 1]] - va
            uc, vc = u[faces[f, 2]] - ua, v[faces[f, 2]] - va
            area = ub * vc - uc * vb
            if not area < 0.0:
                continue
            left, right = (ub if ub < uc else uc), (ub if ub > uc else uc)
            top, bottom = (vb if vb < vc else vc), (vb if vb > vc else vc)
            left, right = (left if left < 0.0 else 0.0) + ua, (right if right > 0.0 else 0.0) + ua
            top, bottom = (top if top < 0.0 else 0.0) + va, (bottom if bottom > 0.0 else 0.0) + va
            for k in range(K):
                if not (left <= point_u[k] <= right and top <= point_v[k] <= bottom):
                    continue
                du, dv = point_u[k] - ua, point_v[k] - va
                beta, gamma = (du * vc - uc * dv) / area, (ub * dv - du * vb) / area
                alpha = 1.0 - beta - gamma
                if alpha < -edge or beta < -edge or gamma < -edge:
                    continue
                hit = alpha * value[faces[f, 0]] + beta * value[faces[f, 1]] + gamma * value[faces[f, 2]]
                hit = 1.0 / hit if inverse else hit
                nearest[k] = hit if hit < nearest[k] else nearest[k]
    return np.asarray(nearest)


def accelerated(const double[:, ::1] changes, const double[:, ::1] moves, const double[::1] step, double damped):
    """The step whose change by the mixture of the remembered ones is least (`fgrecon.solve.graph.anderson`).

    Args:
        changes, moves: (n, D) of the last n <= 4 steps. step: (D,).
        damped: Added to the normal equations' diagonal, as a share of it.

    Returns:
        (D,); None where the changes are too nearly one for any mixture.
    """
    cdef int n = changes.shape[0], D = changes.shape[1], i, j, d
    cdef double H[16]
    cdef double g[4]
    cdef double share[4]
    cdef double s
    if not 1 <= n <= 4 or moves.shape[0] != n or moves.shape[1] != D or step.shape[0] != D:
        raise ValueError("changes and moves (n, D) with n from 1 to 4, and a step (D,) are wanted")
    result = np.empty(D)
    cdef double[::1] further = result
    with nogil:
        for i in range(4):
            g[i] = 0.0
            for j in range(4):
                H[4 * i + j] = 1.0 if i == j else 0.0
        for i in range(n):
            for d in range(D):
                g[i] -= changes[i, d] * step[d]
            for j in range(i + 1):
                s = 0.0
                for d in range(D):
                    s += changes[i, d] * changes[j, d]
                H[4 * i + j] = H[4 * j + i] = s * (1.0 + damped) if i == j else s
    if not solve(H, 0.0, g, share):
        return None
    with nogil:
        for d in range(D):
            further[d] = step[d]
            for i in range(n):
                further[d] -= share[i] * (moves[i, d] + changes[i, d])
    return result
