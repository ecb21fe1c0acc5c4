"""The steps of EM-PPCA: one probabilistic linear shape model seen through M scaled-orthographic cameras.

The model of Torresani, Hertzmann and Bregler (2008), with keypoints that may be unseen:

    a_m p_mk = R_m (mean_k + sum_j z_mj basis_jk) + t_m + n_mk,   z_m ~ N(0, I),   n_mk ~ N(0, sigma^2 I)

p_mk is the image point, R_m has two orthonormal rows, a_m = 1 / c_m is the inverse of the camera's scale. The noise is
measured in the object's units (c_m sigma in the image), so that near and far vehicles count alike whatever their size
in pixels; the change of variables adds 2 log a_m to the log density of each seen keypoint, which keeps a_m from
shrinking to zero. An unseen keypoint has no term: integrating it out is what filling it in by the E-step and counting
its conditional variance in the M-step amount to, without the slow convergence that the latter has.

*Restricted likelihood.* Six camera parameters are fitted to each image's few keypoints, so that the likelihood of
the fitted cameras takes noise for pose and shape: on street images with ten keypoints it finds less than half of the
noise, and basis vectors that fit the rest. Integrating the cameras out by Laplace's method takes the place of 6 of the
2 n residuals of an image (their curvature grows with (a / sigma)^2 each), which turns the log likelihood of an image

    2 n log(a / sigma) - sum |residual|^2 / (2 sigma^2) + const.   into   (2 n - 6) log(a / sigma) - (the same sum),

the restricted likelihood (REML) of mixed models; it has the same closed-form steps. `Data.freedom` = 0 is the plain
likelihood.

*Robust noise.* With `dof` the noise is Student's t (per keypoint, two-dimensional), a Gaussian of variance sigma^2 / u
with u ~ Gamma(dof / 2, dof / 2): wrongly marked keypoints get a small E[u]. The posterior is then factorised into
q(z) q(u), and what no step lowers is the evidence lower bound; for Gaussian noise the bound is the log likelihood.

Every step maximises the bound over its own variables: basis, mean, noise and weights in closed form; scale and
translation in closed form given the rotation; the rotation by a majorisation that cannot lower it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon_research.training.priors.factorisation import SymmetricSubspace

_POSE_SWEEPS, _SEARCH_SWEEPS = 4, 6  # of rotation and scale in a step; of steps from a start of the search
_NOISE_FLOOR = 1e-8


@dataclass(frozen=True)
class Data:
    """The annotations, ready for use."""

    points: Array  # (M, K, 2) image points; unseen ones hold zeros
    measured: Array  # (M, K) 1.0 where a keypoint was annotated, else 0.0
    importance: Array  # (M,) factor on each instance's log likelihood; ones where all count alike
    # fitted camera parameters that the noise estimate allows for: 6, or 0 for the plain likelihood
    freedom: float = 6.0

    @property
    def keypoints(self) -> float:
        """How many keypoints are annotated, each image counting by its importance."""
        return float(self.importance @ self.measured.sum(axis=1))


@dataclass(frozen=True)
class ShapeModel:
    """Mean (K, 3), basis (N, K, 3) and noise variance (scalar) in the object's units."""

    mean: Array
    basis: Array
    variance: float


@dataclass(frozen=True)
class Cameras:
    """Scaled-orthographic cameras: rotation rows (M, 2, 3), inverse scale (M,) and translation (M, 2)."""

    rotation: Array
    inverse_scale: Array
    translation: Array


@dataclass(frozen=True)
class Posterior:
    """What the E-step knows about the latent variables."""

    mean: Array  # (M, N) posterior mean of the coefficients
    covariance: Array  # (M, N, N) their posterior covariance
    weight: Array  # (M, K) expected precision factor u of each keypoint, 1 for Gaussian noise and 0 where unseen
    squared: Array  # (M, K) expected squared residual in the object's units


def expected_shapes(model: ShapeModel, coefficients: Array) -> Array:
    """(M, K, 3) shapes at the coefficients (M, N)."""
    count, size = model.basis.shape[0], model.mean.shape[0]
    return model.mean + (coefficients @ model.basis.reshape(count, size * 3)).reshape(-1, size, 3)


def _squared_residuals(data: Data, model: ShapeModel, cameras: Cameras, mean: Array, covariance: Array) -> Array:
    """(M, K) E |a p - R X - t|^2 under q(z)."""
    shapes = expected_shapes(model, mean)
    residual = (
        cameras.inverse_scale[:, None, None] * data.points
        - shapes @ cameras.rotation.transpose(0, 2, 1)
        - cameras.translation[:, None]
    )
    squared = np.square(residual).sum(axis=2)
    if model.basis.shape[0]:
        design = _design(model, cameras)  # (M, K * 2, N)
        spread = np.einsum("mrn,mrn->mr", design @ covariance, design)
        squared += spread.reshape(*squared.shape, 2).sum(axis=2)
    return np.asarray(squared * data.measured)


def _design(model: ShapeModel, cameras: Cameras) -> Array:
    """(M, K * 2, N) derivative of each projected keypoint by the coefficients."""
    count, size = model.basis.shape[0], model.mean.shape[0]
    vectors = model.basis.transpose(2, 1, 0).reshape(3, size * count)
    return (cameras.rotation @ vectors).reshape(-1, 2, size, count).swapaxes(1, 2).reshape(-1, size * 2, count)


def _weights(data: Data, squared: Array, variance: float, dof: float | None) -> Array:
    """(M, K) expected precision factors under q(u)."""
    if dof is None:
        return data.measured
    return data.measured * (dof + 2.0) / (dof + squared / variance)


def e_step(data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, weight: Array | None) -> Posterior:
    """q(z) for the given weights (one where None), then q(u) for that q(z)."""
    count = model.basis.shape[0]
    used = data.measured if weight is None else weight
    if count:
        design = _design(model, cameras)
        precision = np.repeat(used / model.variance, 2, axis=1)
        residual = (
            cameras.inverse_scale[:, None, None] * data.points
            - model.mean @ cameras.rotation.transpose(0, 2, 1)
            - cameras.translation[:, None]
        )
        weighted = (design * precision[:, :, None]).transpose(0, 2, 1)
        covariance = np.linalg.inv(np.eye(count) + weighted @ design)
        covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
        mean = (covariance @ (weighted @ residual.reshape(len(residual), -1, 1)))[:, :, 0]
    else:
        mean, covariance = np.zeros((len(used), 0)), np.zeros((len(used), 0, 0))
    squared = _squared_residuals(data, model, cameras, mean, covariance)
    return Posterior(mean, covariance, _weights(data, squared, model.variance, dof), squared)


def bound(data: Data, model: ShapeModel, cameras: Cameras, posterior: Posterior, dof: float | None) -> Array:
    """(M,) evidence lower bound of each instance (its log likelihood for Gaussian noise after an E-step), nats."""
    relative = posterior.squared / model.variance
    loss = 0.5 * relative if dof is None else (0.5 * dof + 1.0) * np.log1p(relative / dof)
    pairs = data.measured.sum(axis=1) - 0.5 * data.freedom
    total = pairs * (2.0 * np.log(cameras.inverse_scale) - np.log(2.0 * np.pi * model.variance))
    total -= (loss * data.measured).sum(axis=1)
    if model.basis.shape[0]:
        _, log_determinant = np.linalg.slogdet(posterior.covariance)
        trace = np.trace(posterior.covariance, axis1=1, axis2=2)
        total -= 0.5 * (trace + np.square(posterior.mean).sum(axis=1) - model.basis.shape[0] - log_determinant)
    return np.asarray(total * data.importance)


def pose_step(data: Data, model: ShapeModel, cameras: Cameras, posterior: Posterior) -> Cameras:
    """Raise the bound over rotation, scale and translation, the posterior held.

    With the translation eliminated, an instance's cost is a^2 P - 2 a tr(R'B) + tr(R C R') - 4 n log a. Given R the
    best a is the root of a quadratic. Given a, tr(R C R') with orthonormal rows is a constant minus a convex function
    of R, so its tangent bounds the cost from above: the polar factor of a B + R (l I - C), l the largest eigenvalue of
    C, never raises it.
    """
    weight = posterior.weight / model.variance
    total = weight.sum(axis=1)[:, None]
    shapes = expected_shapes(model, posterior.mean)
    centre_p = np.einsum("mk,mki->mi", weight, data.points) / total
    centre_x = np.einsum("mk,mki->mi", weight, shapes) / total
    p = (data.points - centre_p[:, None]) * data.measured[:, :, None]
    x = shapes - centre_x[:, None]
    wp = (weight[:, :, None] * p).transpose(0, 2, 1)
    power = (wp.transpose(0, 2, 1) * p).sum(axis=(1, 2))
    cross = wp @ x
    square = (weight[:, :, None] * x).transpose(0, 2, 1) @ x
    count, size = model.basis.shape[0], model.mean.shape[0]
    if count:  # sum_k w_k V_k phi V_k'
        outer = np.einsum("akj,bkl->kajbl", model.basis, model.basis).transpose(0, 1, 3, 2, 4).reshape(size, -1)
        spread = (weight @ outer).reshape(-1, count * count, 9)
        square += (posterior.covariance.reshape(-1, 1, count * count) @ spread).reshape(-1, 3, 3)
    slack = np.linalg.eigvalsh(square)[:, -1, None, None] * np.eye(3) - square
    pairs = data.measured.sum(axis=1) - 0.5 * data.freedom
    rotation, scale = cameras.rotation, cameras.inverse_scale
    for _ in range(_POSE_SWEEPS):
        rotation = orthonormal_rows(scale[:, None, None] * cross + rotation @ slack)
        along = (rotation * cross).sum(axis=(1, 2))
        scale = (along + np.sqrt(along**2 + 8.0 * pairs * power)) / (2.0 * power)
    translation = scale[:, None] * centre_p - (rotation @ centre_x[:, :, None])[:, :, 0]
    return Cameras(rotation, scale, translation)


def orthonormal_rows(matrices: Array) -> Array:
    """(M, 2, 3) nearest matrices with orthonormal rows, by the closed root of a 2x2 matrix."""
    gram = matrices @ matrices.transpose(0, 2, 1)
    root = np.sqrt(np.maximum(gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2, 1e-300))
    gram[:, 0, 0] += root
    gram[:, 1, 1] += root  # proportional to the square root of the Gram matrix
    norm = np.sqrt(gram[:, 0, 0] + gram[:, 1, 1])
    determinant = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2
    inverse = np.empty_like(gram)
    inverse[:, 0, 0], inverse[:, 1, 1] = gram[:, 1, 1], gram[:, 0, 0]
    inverse[:, 0, 1] = inverse[:, 1, 0] = -gram[:, 0, 1]
    return np.asarray((inverse * (norm / determinant)[:, None, None]) @ matrices)


def model_step(
    data: Data, model: ShapeModel, cameras: Cameras, posterior: Posterior, subspace: SymmetricSubspace
) -> tuple[ShapeModel, Posterior]:
    """Best mean, basis and noise for the cameras and the posterior, all in closed form.

    The basis step is parameter-expanded (Liu, Rubin and Wu 1998): the coefficients' own mean and covariance are
    estimated too and then absorbed into mean and basis, with the posterior carried along, which raises the bound
    further and makes EM converge several times faster.

    Args:
        subspace: Where the mean and basis live.

    Returns:
        The model, and the posterior in its coordinates with new squared residuals.
    """
    count, size = model.basis.shape[0], model.mean.shape[0]
    extended = np.ones((len(data.points), count + 1))
    extended[:, 1:] = posterior.mean
    moments = extended[:, :, None] * extended[:, None]
    moments[:, 1:, 1:] += posterior.covariance
    moments = moments.reshape(len(moments), -1).T
    gram = (cameras.rotation.transpose(0, 2, 1) @ cameras.rotation).reshape(-1, 9)
    target = (cameras.inverse_scale[:, None, None] * data.points - cameras.translation[:, None]) @ cameras.rotation
    weights = posterior.weight * data.importance[:, None]
    shapes = np.zeros((count + 1, size, 3))
    for orbit in subspace.orbits:
        lhs = np.zeros((count + 1, orbit.size, count + 1, orbit.size))
        rhs = np.zeros((count + 1, orbit.size))
        for k, F in zip(orbit.keypoints, orbit.maps, strict=True):
            products = ((moments * weights[:, k]) @ gram).reshape(count + 1, count + 1, 3, 3)
            lhs += np.einsum("abij,ic,jd->acbd", products, F, F)
            rhs += (extended * weights[:, k, None]).T @ target[:, k] @ F
        n = (count + 1) * orbit.size
        matrix = lhs.reshape(n, n)
        matrix[np.diag_indices(n)] += 1e-12 * np.trace(matrix) / n  # a keypoint that is hardly ever seen
        solution = np.linalg.solve(matrix, rhs.reshape(n)).reshape(count + 1, orbit.size)
        shapes[:, orbit.keypoints] = np.einsum("pic,ac->api", orbit.maps, solution)
    mean, basis, q_mean, q_covariance = _absorb(shapes[0], shapes[1:], posterior, data.importance)
    trial = ShapeModel(mean, basis, model.variance)
    squared = _squared_residuals(data, trial, cameras, q_mean, q_covariance)
    pairs = data.importance @ (data.measured.sum(axis=1) - 0.5 * data.freedom)
    variance = max(float((weights * squared).sum() / (2.0 * pairs)), _NOISE_FLOOR)
    return ShapeModel(mean, basis, variance), Posterior(q_mean, q_covariance, posterior.weight, squared)


def _absorb(mean: Array, basis: Array, posterior: Posterior, importance: Array) -> tuple[Array, Array, Array, Array]:
    """Move the coefficients' empirical mean and covariance into the shape: they are N(0, I) afterwards."""
    if not len(basis):
        return mean, basis, posterior.mean, posterior.covariance
    share = importance / importance.sum()
    centre = share @ posterior.mean
    centred = posterior.mean - centre
    spread = np.tensordot(share, posterior.covariance, axes=1) + (centred * share[:, None]).T @ centred
    root = np.linalg.cholesky(spread)
    inverse = np.linalg.inv(root)
    return (
        mean + np.tensordot(centre, basis, axes=1),
        np.tensordot(root.T, basis, axes=1),
        centred @ inverse.T,
        inverse @ posterior.covariance @ inverse.T,
    )


# EM iterations with safeguarded extrapolation: the same optimum in a fraction of the iterations.
#
# SQUAREM (Varadhan and Roland 2008): from three successive parameter vectors v0, v1, v2 of EM a longer step
# v0 + 2 s (v1 - v0) + s^2 (v2 - 2 v1 + v0) is tried, and taken only where the bound is no lower than EM's own.

Report = Callable[[int, float], None]
"""Called after each iteration with its number and the bound per seen keypoint (nats)."""

_FIRST_STEP = 4.0


@dataclass(frozen=True)
class EmState:
    """Everything that EM iterates on."""

    # the shape model, scaled so that the mean's keypoints lie at an RMS distance of 1 from the origin
    model: ShapeModel
    cameras: Cameras  # one per instance
    posterior: Posterior  # the latent variables under both
    bound: float  # the bound of all instances together, nats


def start_state(
    data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, weight: Array | None = None
) -> EmState:
    """A state from a model and cameras, scaled to unit size; the bound does not depend on that scale."""
    scale = 1.0 / float(np.sqrt(np.square(model.mean).sum(axis=1).mean()))
    model = ShapeModel(model.mean * scale, model.basis * scale, model.variance * scale**2)
    cameras = Cameras(cameras.rotation, cameras.inverse_scale * scale, cameras.translation * scale)
    return _evaluated(data, model, cameras, dof, weight)


def _evaluated(data: Data, model: ShapeModel, cameras: Cameras, dof: float | None, weight: Array | None) -> EmState:
    posterior = e_step(data, model, cameras, dof, weight if dof is not None else None)
    return EmState(model, cameras, posterior, float(bound(data, model, cameras, posterior, dof).sum()))


def em(
    data: Data,
    state: EmState,
    subspace: SymmetricSubspace,
    *,
    dof: float | None,
    iterations: int,
    tolerance: float,
    report: Report | None = None,
) -> tuple[EmState, list[float], bool]:
    """Iterate EM with extrapolation until the bound rises by less than `tolerance` nats per keypoint and iteration.

    Args:
        state: Where to start.
        subspace: Where the mean and basis live.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.

    Returns:
        The last state, the bound at the start and after each pair of iterations (never falling), and whether it
        converged.
    """
    keypoints = data.keypoints
    history, longest = [state.bound], _FIRST_STEP
    for iteration in range(2, iterations + 1, 2):
        first = _iterate(data, state, subspace, dof)
        second = _iterate(data, first, subspace, dof)
        leap, length = _extrapolate(data, state, first, second, dof, longest)
        if leap is not None and leap.bound >= second.bound:
            second = leap
            longest = 4.0 * longest if length == longest else longest
        elif length > 1.0:
            longest = max(_FIRST_STEP, longest / 4.0)
        gain = (second.bound - state.bound) / keypoints
        state = second
        history.append(state.bound)
        if report is not None:
            report(iteration, state.bound / keypoints)
        if gain < 2.0 * tolerance:
            return state, history, True
    return state, history, False


def _iterate(data: Data, state: EmState, subspace: SymmetricSubspace, dof: float | None) -> EmState:
    """One iteration of EM: cameras, model, posterior."""
    cameras = pose_step(data, state.model, state.cameras, state.posterior)
    model, posterior = model_step(data, state.model, cameras, state.posterior, subspace)
    return _evaluated(data, model, cameras, dof, posterior.weight)


def _extrapolate(
    data: Data, state: EmState, first: EmState, second: EmState, dof: float | None, longest: float
) -> tuple[EmState | None, float]:
    """The state a longer step away, or None where the step is no longer than EM's; and the step's length."""
    v0, v1, v2 = _vector(state), _vector(first), _vector(second)
    change = v1 - v0
    bend = v2 - v1 - change
    length = float(np.clip(np.linalg.norm(change) / max(float(np.linalg.norm(bend)), 1e-300), 1.0, longest))
    if length <= 1.01:
        return None, length
    model, cameras = _from_vector(v0 + 2.0 * length * change + length**2 * bend, second)
    leap = _evaluated(data, model, cameras, dof, second.posterior.weight)
    return (leap if np.isfinite(leap.bound) else None), length


def _vector(state: EmState) -> Array:
    model, cameras = state.model, state.cameras
    parts = (
        model.mean,
        model.basis,
        np.log([model.variance]),
        cameras.rotation,
        np.log(cameras.inverse_scale),
        cameras.translation,
    )
    return np.concatenate([part.ravel() for part in parts])


def _from_vector(vector: Array, like: EmState) -> tuple[ShapeModel, Cameras]:
    model, cameras = like.model, like.cameras
    shapes = (
        model.mean.shape,
        model.basis.shape,
        (1,),
        cameras.rotation.shape,
        cameras.inverse_scale.shape,
        cameras.translation.shape,
    )
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    parts = [part.reshape(shape) for part, shape in zip(np.split(vector, ends[:-1]), shapes, strict=True)]
    return (
        ShapeModel(parts[0], parts[1], max(float(np.exp(parts[2][0])), _NOISE_FLOOR)),
        Cameras(orthonormal_rows(parts[3]), np.exp(parts[4]), parts[5]),
    )


def uniform_rotations(count: int, rng: np.random.Generator) -> Array:
    """(count, 2, 3) camera rows, uniform over all rotations."""
    rows = rng.standard_normal((count, 2, 3))
    first = rows[:, 0] / np.linalg.norm(rows[:, 0], axis=1, keepdims=True)
    second = rows[:, 1] - (rows[:, 1] * first).sum(axis=1, keepdims=True) * first
    return np.stack([first, second / np.linalg.norm(second, axis=1, keepdims=True)], axis=1)


def search_cameras(data: Data, state: EmState, rotations: Array, dof: float | None) -> EmState:
    """Try every given rotation, and each camera's own depth reversal, on every instance; keep what is better.

    No instance's bound falls.

    Args:
        rotations: (Q, 2, 3) camera rows to start from.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.

    Returns:
        The same model with the best camera of each instance.
    """
    model = state.model
    rotation, scale, translation = (np.array(part) for part in vars(state.cameras).values())
    weight = state.posterior.weight.copy()
    best = bound(data, model, state.cameras, state.posterior, dof)
    everywhere = (np.broadcast_to(rows, (len(data.points), 2, 3)) for rows in rotations)
    for start in (_reversed(state), *everywhere):
        cameras, posterior = _fit(data, model, Cameras(start, state.cameras.inverse_scale, translation), dof)
        score = bound(data, model, cameras, posterior, dof)
        better = score > best
        rotation[better], scale[better] = cameras.rotation[better], cameras.inverse_scale[better]
        translation[better], weight[better] = cameras.translation[better], posterior.weight[better]
        best = np.where(better, score, best)
    return start_state(data, model, Cameras(rotation, scale, translation), dof, weight)


def _fit(data: Data, model: ShapeModel, cameras: Cameras, dof: float | None) -> tuple[Cameras, Posterior]:
    """Cameras and posterior from a start whose rotation alone means something: first the mean shape, unweighted."""
    count, instances = model.basis.shape[0], len(data.points)
    posterior = Posterior(
        np.zeros((instances, count)),
        np.tile(np.eye(count), (instances, 1, 1)),
        data.measured,
        np.zeros_like(data.measured),
    )
    for sweep in range(_SEARCH_SWEEPS):
        cameras = pose_step(data, model, cameras, posterior)
        posterior = e_step(data, model, cameras, dof, posterior.weight if dof is not None and sweep > 1 else None)
    return cameras, posterior


def _reversed(state: EmState) -> Array:
    """(M, 2, 3) each camera mirrored at the plane that fits its seen keypoints best.

    Points in one plane look the same from both sides of its mirror image (Necker's reversal), so that this is the
    likeliest wrong camera of an instance that shows one side of the vehicle.
    """
    weight = state.posterior.weight
    shapes = expected_shapes(state.model, state.posterior.mean)
    centred = shapes - ((weight[:, None] @ shapes) / weight.sum(axis=1)[:, None, None])
    scatter = (centred * weight[:, :, None]).transpose(0, 2, 1) @ centred
    normal = np.linalg.eigh(scatter)[1][:, :, :1]
    rotation = state.cameras.rotation
    return np.asarray(rotation - 2.0 * (rotation @ normal) @ normal.transpose(0, 2, 1))
