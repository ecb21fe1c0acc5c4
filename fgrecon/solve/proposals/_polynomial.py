"""Every stationary point of an even quartic in four unknowns, by one eigenvalue decomposition.

The function is F(q) = m(q)' S m(q) + q' L q, where m(q) holds the ten products q_i q_j. This is the form that a
least-squares cost over a scaled rotation takes in the components of a non-unit quaternion q, with planar points or
without, and at every rotation: no component of q is assumed to differ from zero.

At a stationary point the gradient of m' S m and L q are parallel, so the 2 x 4 matrix [L q; grad(m' S m)] has rank
one. Its six minors are homogeneous quartics with 3^3 + 3^2 + 3 + 1 = 40 common roots in projective space: the pairs
+-q, real and complex. Their multiples of degree 8 span 125 of the 165 dimensions (one per monomial) that polynomials
of this degree have. The monomial vectors of the 40 roots span the null space, and multiplication by a linear form,
seen in that space, is a 40 x 40 matrix whose eigenvectors are the roots.
The projective form needs no chart, hence no case distinction. The unknowns are first rotated by a fixed random matrix,
so that a rotation by 180 degrees or an object in a standard pose is as generic as any other.

References:
    Zheng, Kuang, Sugimoto, Astrom, Okutomi: Revisiting the PnP problem: a fast, general and optimal solution,
    ICCV 2013 (the function). Dreesen, Batselier, De Moor: Back to the roots: polynomial system solving, linear
    algebra, systems theory, SYSID 2012 (the method).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.compiled import lapack, pivots_of_qr

Index = NDArray[np.intp]

PAIRS: Index = np.array(list(combinations_with_replacement(range(4), 2)), dtype=np.intp)
"""(10, 2) which components of q the ten entries of m(q) multiply."""

_ROOTS = 40
_MONOMIALS = 165  # of degree 8: degree 7 tells all 40 roots apart (degree 6 does not), and multiplication adds one
_RANK = _MONOMIALS - _ROOTS
_TURNS = 2  # rotations of the unknowns to try at most
_RESIDUAL = 1e-5  # largest minor at a root, largest component 1, that counts as found
_REAL = 1e-3  # largest imaginary part of what may be a real root: double ones err by the square root of the rounding
_SEEDS = 48  # starts in place of roots that could not be verified
_DESCENT_STEPS = 30
_NEWTON_STEPS = 20  # at most: two or three do for a simple root
_SADDLE = 1e-3  # how negative a curvature, relative to the largest, an unpolished minimum may have
_FLAT = 1e-9  # the same for a polished one, and the smallest curvature that a Newton step divides by
_CONVERGED = 1e-8  # last Newton step; the error left is about its square
_DECREMENT = 1e-16  # how much lower F may be, where F is of size one
_SAME = 1 - 1e-7  # cosine between quaternions that are one: rotations 1e-3 rad apart


@dataclass(frozen=True)
class Minima:
    """Local minima of F, best first, one of each pair +-q."""

    q: Array  # (B, 4) where they are
    value: Array  # (B,) F there; F(0) = 0, so all are negative
    complete: bool  # whether all 40 roots were verified, that is, whether no minimum can be missing


def products(q: Array) -> Array:
    """m(q): the products q_i q_j (..., 10) of q (..., 4), in the order of `PAIRS`."""
    return q[..., PAIRS[:, 0]] * q[..., PAIRS[:, 1]]


def minima(S: Array, L: Array, *, every: bool = True) -> Minima:
    """All local minima of F(q) = m(q)' S m(q) + q' L q apart from q = 0.

    Args:
        S: (10, 10) symmetric, with m' S m > 0 for q != 0.
        L: (4, 4) symmetric.
        every: Whether to make sure that none is missing. Else those are returned to which Newton's method descends
            from 48 starts all around: a tenth of the work.
    """
    # q = scale * p brings both parts to size one: F(q) = size * F_scaled(p)
    norm_S, norm_L = float(np.linalg.norm(S)), float(np.linalg.norm(L))
    if norm_L == 0:
        return Minima(np.zeros((0, 4)), np.zeros(0), complete=True)
    S, L = S / norm_S, L / norm_L
    derivatives = _derivatives(S)
    if not every:
        p, value = _polish(derivatives, L, _descend(derivatives, L, _lengthen(derivatives, L, _tables().seeds)))
        return Minima(p * np.sqrt(norm_L / norm_S), value * (norm_L**2 / norm_S), complete=False)
    starts, complete = _stationary_directions(S, L)
    starts = _lengthen(derivatives, L, starts)
    if not complete:
        seeds = _lengthen(derivatives, L, _tables().seeds)
        starts = np.concatenate([starts, _descend(derivatives, L, seeds)])
    p, value = _polish(derivatives, L, starts)
    return Minima(p * np.sqrt(norm_L / norm_S), value * (norm_L**2 / norm_S), complete)


def descent() -> tuple[Array, int, float, float]:
    """What the compiled kernel descends by: seeds (48, 4), steps, and when it has converged, and two are one."""
    return _tables().seeds, _DESCENT_STEPS, _CONVERGED, _SAME


def _stationary_directions(S: Array, L: Array) -> tuple[Array, bool]:
    """Unit vectors (B, 4) along which F may have a stationary point, and whether all 40 complex roots were verified.

    They cannot be verified where the roots are not 40 points but fill a surface, in complex numbers at least. Far
    objects with the same spread along all axes come near to that.
    """
    table = _tables()
    real_roots: list[Array] = []
    complete = False
    for turn, turn_products in table.turns:
        minors = _minors(_gradient(turn_products.T @ S @ turn_products), turn.T @ L @ turn, table.gather_quartics)
        roots = _common_roots(minors)
        residuals = np.prod(roots[:, table.quartic_factors], axis=2) @ minors.T
        real = roots.real[np.abs(roots.imag).max(axis=1) < _REAL]
        real_roots.append(real @ turn.T)
        complete = bool(np.abs(residuals).max() < _RESIDUAL)
        if complete:
            break
    directions = np.concatenate(real_roots)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True), complete


def _derivatives(S: Array) -> Array:
    """The derivatives (10, 16) of m' S m: its Hessian, flattened, is m(q)' times them."""
    return (_gradient(S) @ _tables().differentiate).reshape(16, 10).T


def _parts(derivatives: Array, L: Array, q: Array) -> tuple[Array, Array, Array]:
    """F (B,), its gradient (B, 4) and its Hessian (B, 4, 4) at q (B, 4)."""
    # Euler: of a quartic form with Hessian H, the gradient is H q / 3 and the value q' H q / 12
    quartic = (products(q) @ derivatives).reshape(-1, 4, 4)
    by_quartic, by_L = (quartic @ q[:, :, None])[:, :, 0], q @ L
    return ((by_quartic / 12 + by_L) * q).sum(axis=1), by_quartic / 3 + 2 * by_L, quartic + 2 * L


def _lengthen(derivatives: Array, L: Array, directions: Array) -> Array:
    """The minimum of F along each direction; directions along which F only grows are left out."""
    quadratic = ((directions @ L) * directions).sum(axis=1)
    quartic = _parts(derivatives, L, directions)[0] - quadratic
    falls = (quadratic < 0) & (quartic > 0)
    length = np.sqrt(-quadratic[falls] / (2 * quartic[falls]))
    return directions[falls] * length[:, None]


def _descend(derivatives: Array, L: Array, q: Array) -> Array:
    """Damped Newton descent from far starts q (B, 4) to the neighbourhood of minima."""
    damping = np.full(len(q), 0.1)
    value, gradient, hessian = _parts(derivatives, L, q)
    for _ in range(_DESCENT_STEPS):
        eigenvalues, axes = np.linalg.eigh(hessian)
        step = _newton_step(gradient, np.abs(eigenvalues) + damping[:, None] * eigenvalues[:, 3:], axes)
        trial = q - step
        new_value, new_gradient, new_hessian = _parts(derivatives, L, trial)
        better = new_value < value
        damping = np.where(better, damping / 10, np.minimum(damping * 10, 1e6))
        q, value = np.where(better[:, None], trial, q), np.where(better, new_value, value)
        gradient = np.where(better[:, None], new_gradient, gradient)
        hessian = np.where(better[:, None, None], new_hessian, hessian)
    return q


def _polish(derivatives: Array, L: Array, q: Array) -> tuple[Array, Array]:
    """Newton's method from stationary points q (B, 4): the minima (B', 4) and F there (B',), best first, each once."""
    eigenvalues, axes = np.linalg.eigh(_parts(derivatives, L, q)[2])
    q = q[eigenvalues[:, 0] > -_SADDLE * eigenvalues[:, 3]]
    for _ in range(_NEWTON_STEPS):
        _, gradient, hessian = _parts(derivatives, L, q)
        eigenvalues, axes = np.linalg.eigh(hessian)
        step = _newton_step(gradient, np.maximum(np.abs(eigenvalues), _FLAT * eigenvalues[:, 3:]), axes)
        q = q - step
        if (np.abs(step) < _CONVERGED).all():
            break
    else:  # minima nearly meet and the steps shrink slowly: what counts is how much lower F could be
        q = q[np.abs((step * gradient).sum(axis=1)) < _DECREMENT]
    value, _, hessian = _parts(derivatives, L, q)
    eigenvalues = np.linalg.eigvalsh(hessian)
    minimal = np.flatnonzero(eigenvalues[:, 0] > -_FLAT * eigenvalues[:, 3])
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    distinct: list[int] = []
    for i in minimal[np.argsort(value[minimal])].tolist():
        if (np.abs(unit[distinct] @ unit[i]) < _SAME).all():
            distinct.append(i)
    return q[distinct], value[distinct]


def _newton_step(gradient: Array, curvature: Array, axes: Array) -> Array:
    """Steps (B, 4) to subtract, for gradients (B, 4) and curvatures (B, 4) along axes (B, 4, 4)."""
    along = (gradient[:, None, :] @ axes)[:, 0] / curvature
    return (axes @ along[:, :, None])[:, :, 0]


def _gradient(S: Array) -> Array:
    """Coefficients (4, 20) of the four cubics grad(m' S m)."""
    table = _tables()
    return 2 * (S @ table.jacobian).reshape(4, 40) @ table.gather_cubics


def _minors(cubics: Array, L: Array, gather_quartics: Array) -> Array:
    """Coefficients (6, 35) of the 2 x 2 minors of [L q; cubics(q)], with unit norm together."""
    terms = (L[:, None, :, None] * cubics[None, :, None, :]).reshape(16, 80)
    quartics = (terms @ gather_quartics).reshape(4, 4, 35)
    minors: Array = (quartics - quartics.swapaxes(0, 1))[[0, 0, 0, 1, 1, 2], [1, 2, 3, 2, 3, 3]]
    return minors / np.linalg.norm(minors)


def _common_roots(minors: Array) -> NDArray[np.complex128]:
    """The 40 common roots (40, 4) of the six quartics (6, 35), each with its largest component 1."""
    null_space = _null_space(minors)
    multiplication = _multiplication(null_space)
    if not np.isfinite(multiplication).all():  # a root on the plane q_0 = 0
        return np.full((_ROOTS, 4), np.nan + 0j)
    vectors = np.linalg.eig(multiplication)[1]
    # block k of a root: q_k^7 (q_0, q_1, q_2, q_3); take that of its largest component
    blocks = (null_space[_tables().power_shifts.ravel()] @ vectors).reshape(4, 4, _ROOTS)
    every = np.arange(_ROOTS)
    largest = np.abs(blocks.reshape(16, _ROOTS)[::5]).argmax(axis=0)
    roots = blocks[largest, :, every]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(roots / roots[every, largest][:, None], dtype=np.complex128)


def _null_space(minors: Array) -> Array:
    """Basis (165, 40) of the span of the roots' monomial vectors of degree 8: what all multiples vanish on."""
    table = _tables()
    multiples = np.zeros((_RANK, _MONOMIALS))
    multiples.ravel()[table.entries] = minors.ravel()[table.sources]
    # LU of the transpose: row pivoting picks the 125 monomials that the other 40 determine, whatever the problem
    factors, pivots, _ = lapack().dgetrf(multiples.T, overwrite_a=1)
    order = list(range(_MONOMIALS))
    for i, pivot in enumerate(pivots.tolist()):
        order[i], order[pivot] = order[pivot], order[i]
    basis = np.zeros((_MONOMIALS, _ROOTS))
    basis[order[:_RANK]] = -_solve_upper(factors[:_RANK].T, factors[_RANK:].T, unit=1)
    basis[order[_RANK:]] = np.eye(_ROOTS)
    return basis


def _multiplication(null_space: Array) -> Array:
    """The matrix (40, 40) with q_1 / q_0 of the roots as eigenvalues, their coordinates in the basis as vectors."""
    shifts = _tables().shifts
    Q, R = np.linalg.qr(null_space[shifts[0]])
    return _solve_upper(R, Q.T @ null_space[shifts[1]], unit=0)


def _solve_upper(triangle: Array, right: Array, *, unit: int) -> Array:
    """Solve with an upper triangular matrix (LAPACK, without scipy's checks)."""
    return lapack().dtrtrs(triangle, right, unitdiag=unit)[0]


@dataclass(frozen=True)
class _Tables:
    """What does not depend on the problem: how monomials multiply, and the random rotations.

    Monomials are ordered as in `_monomials`: 4, 10, 20, 35, 120 and 165 of degree 1, 2, 3, 4, 7 and 8.
    """

    turns: tuple[tuple[Array, Array], ...]  # pairs of a rotation P (4, 4) and T (10, 10) with m(P q) = T m(q)
    seeds: Array  # (48, 4) unit vectors
    jacobian: Array  # (4, 10, 4) with dm/dq_x = jacobian[x] q
    gather_cubics: Array  # (40, 20) from coefficients of m_k q_a to those of cubics
    gather_quartics: Array  # (80, 35) from coefficients of q_a times a cubic monomial to those of quartics
    differentiate: Array  # (20, 40) from a cubic to its four derivatives, each with ten coefficients
    quartic_factors: Index  # (35, 4) the components of q whose product is the monomial
    entries: Index  # flat entries of the (125, 165) matrix of multiples that are filled
    sources: Index  # flat entries of the minors (6, 35) that fill them
    shifts: Index  # (4, 120) where the monomials of degree 7, times q_i, stand among those of degree 8
    power_shifts: Index  # (4, 4) where q_k^7 q_i stands among those of degree 8


@cache
def _tables() -> _Tables:
    rng = np.random.default_rng(0)
    jacobian = np.zeros((4, 10, 4))
    for k, (i, j) in enumerate(PAIRS.tolist()):
        jacobian[i, k, j] += 1
        jacobian[j, k, i] += 1
    cubic_places, cubics = _places(2, 1), _monomials(3)
    differentiate = np.zeros((20, 4, 10))
    for k, x in np.ndindex(10, 4):
        differentiate[cubic_places[k, x], x, k] = np.count_nonzero(cubics[cubic_places[k, x]] == x)
    gather_quartics = np.eye(35)[_places(1, 3).ravel()]
    rows = _independent_multiples(gather_quartics, rng)
    shifts = _places(1, 7)
    seeds = rng.normal(size=(_SEEDS, 4))
    powers = [int(np.flatnonzero((_monomials(7) == k).all(axis=1))[0]) for k in range(4)]
    return _Tables(
        turns=tuple(_turn(jacobian, rng) for _ in range(_TURNS)),
        seeds=seeds / np.linalg.norm(seeds, axis=1, keepdims=True),
        jacobian=jacobian,
        gather_cubics=np.eye(20)[cubic_places.ravel()],
        gather_quartics=gather_quartics,
        differentiate=differentiate.reshape(20, 40),
        quartic_factors=_monomials(4),
        entries=(np.tile(_places(4, 4), (6, 1))[rows] + _MONOMIALS * np.arange(_RANK)[:, None]).ravel(),
        sources=np.repeat(np.arange(210).reshape(6, 35), 35, axis=0)[rows].ravel(),
        shifts=shifts,
        power_shifts=shifts[:, powers].T,
    )


def _independent_multiples(gather_quartics: Array, rng: np.random.Generator) -> Index:
    """125 of the 210 products minor x monomial of degree 4 (minor-major) that are independent in general."""
    minors = _minors(rng.normal(size=(4, 20)), rng.normal(size=(4, 4)), gather_quartics)
    multiples = np.zeros((210, _MONOMIALS))
    np.put_along_axis(multiples, np.tile(_places(4, 4), (6, 1)), np.repeat(minors, 35, axis=0), axis=1)
    order: Index = pivots_of_qr(multiples.T)
    return np.sort(order[:_RANK])


def _turn(jacobian: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random rotation P (4, 4) of q, and T (10, 10) with m(P q) = T m(q)."""
    P = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    # q_i q_j = q' D q with D the symmetric half of jacobian's slice; so m_k(P q) = q' (P' D_k P) q
    forms = P.T @ (jacobian.swapaxes(0, 1) / 2) @ P
    T = np.where(PAIRS[:, 0] == PAIRS[:, 1], 1.0, 2.0) * forms[:, PAIRS[:, 0], PAIRS[:, 1]]
    return P, T


def _monomials(degree: int) -> Index:
    """The monomials of a degree (M, degree), each as the ascending components of q whose product it is."""
    return np.array(list(combinations_with_replacement(range(4), degree)), dtype=np.intp)


def _places(first: int, second: int) -> Index:
    """Where each product of a monomial of one degree with one of another stands among those of the sum's degree."""
    place = {tuple(monomial): i for i, monomial in enumerate(_monomials(first + second).tolist())}
    rows, columns = _monomials(first).tolist(), _monomials(second).tolist()
    return np.array([[place[tuple(sorted(a + b))] for b in columns] for a in rows], dtype=np.intp)
