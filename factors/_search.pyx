# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
# cython: freethreading_compatible=True
"""The search over many poses, compiled: `fgrecon.solve.proposals.search`, whose numpy version it agrees with."""

from libc.math cimport INFINITY, atan2, cos, exp, fabs, floor, log, sin, sqrt
from libc.string cimport memcpy, memset

from factors._observation cimport Observation
from factors._terms cimport add, cross, mixture

import numpy as np

cdef double PI = 3.14159265358979323846


cdef double evaluate(
    Observation terms, const double *R, const double *t, const double *x, double least,
    double *g, double *M, double *weights, double *work
) noexcept nogil:
    """Robust energy of a hypothesis; gradient g (D,), lower triangle of M (D, D), and weights (K,)."""
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
        near |= terms.box(R, t, x, least, r, J, NULL, work) < least
        for i in range(4):
            if terms.used[i]:
                weight = exp(-0.5 * r[i] * r[i])
                energy -= log(weight + terms.box_wrong)
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
            add(J, D, r[0], 1.0, g, M, D)
    if terms.has_ground:
        sigma = sqrt(terms.height_sigma * terms.height_sigma + terms.slope_sigma * terms.slope_sigma * t[2] * t[2])
        terms.ground(R, t, sigma, r, turn, shift)
        energy += log(sigma)
        for i in range(4):
            memset(J, 0, 6 * sizeof(double))
            for a in range(3):
                J[a] = turn[3 * i + a]
                J[3 + a] = shift[a] if i == 0 else 0.0
            energy += 0.5 * r[i] * r[i]
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
        g[6 + n] += x[n]
        M[(6 + n) * D + 6 + n] += 1.0
    return INFINITY if near else energy


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
                    terms,
            state, state + 9, state + 12, least, &g[h, 0], &M[h, 0], state + 12 + N, &work[0]
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
