"""Non-rigid structure from motion: a linear 3D shape model from 2D annotations, one image per shape.

    annotations (M, K, 2), NaN where unseen
        |  rigid factorisation with missing data, several random starts      `factorisation`
        |  rigid EM, global search for each camera                           `em_acceleration`, `pose_search`
        |  where requested: image points freed from perspective              `perspective`
        |  random small basis, EM, search again, EM to convergence
        v  the restart with the best likelihood
    mean, basis, noise, cameras                                               `em_ppca`

Above `NrsfmOptions.start_images` images, the restarts run on a part, whose winner starts EM on all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.checks import as_shape
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon_research.training.priors.canonical_frame import object_axes
from fgrecon_research.training.priors.compare import align
from fgrecon_research.training.priors.em_ppca import (
    Cameras,
    Data,
    EmState,
    ShapeModel,
    em,
    search_cameras,
    start_state,
    uniform_rotations,
)
from fgrecon_research.training.priors.factorisation import SymmetricSubspace, affine_factorisation, metric_upgrade
from fgrecon_research.training.priors.perspective import estimate_nearness, without_perspective

# How sure a learnt mean shape is: learnt again from other draws of the vehicles.
#
# The Bayesian bootstrap (Rubin 1981): each draw weighs every vehicle, with all its images, by an exponential variate
# and goes on with EM from where learning ended. Images of one vehicle, drawn together, count as one witness. What all
# vehicles have alike (habits of annotators, the cameras' model) moves no draw and is not in the result.


_ITERATIONS = 60  # of EM in a draw, from where learning ended
_TOLERANCE = 5e-5  # nats per keypoint and iteration


def vehicle_numbers(vehicles: ArrayLike | None, used: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(M',) number of the vehicle that each used image shows; each its own where they are not known.

    Raises:
        InvalidInputError: There is not one vehicle for each of the M images.
    """
    if vehicles is None:
        return np.arange(int(used.sum()))
    names = np.asarray(vehicles)
    if names.shape != used.shape:
        raise InvalidInputError("vehicles", f"shape {names.shape}", f"Give one for each of {len(used)} images.")
    return np.asarray(np.unique(names[used], return_inverse=True)[1])


def bootstrapped_means(
    data: Data,
    state: EmState,
    subspace: SymmetricSubspace,
    vehicle: NDArray[np.intp],
    draws: int,
    dof: float | None,
    rng: np.random.Generator,
    progress: Callable[[int, float], None] = lambda _draw, _bound: None,
) -> Array:
    """Mean shapes of other draws of the vehicles.

    Args:
        state: Where learning from them ended.
        subspace: Where the mean lives.
        vehicle: (M,) number of the vehicle that each image shows.
        dof: Degrees of freedom of the noise, or None for Gaussian noise.
        progress: Called after each draw with its number, from 1, and its log likelihood per keypoint, nats.

    Returns:
        (draws, K, 3) each moved, turned and scaled to fit the learnt mean best, in its frame.
    """
    means = []
    for draw in range(1, draws + 1):
        weight = rng.exponential(size=int(vehicle.max()) + 1)[vehicle]
        drawn = replace(data, importance=data.importance * weight / np.average(weight, weights=data.importance))
        start = start_state(drawn, state.model, state.cameras, dof, state.posterior.weight)
        end, _, _ = em(drawn, start, subspace, dof=dof, iterations=_ITERATIONS, tolerance=_TOLERANCE)
        means.append(align(end.model.mean, state.model.mean)[0])
        progress(draw, end.bound / drawn.keypoints)
    return np.array(means).reshape(draws, *state.model.mean.shape)


_FACTORISATIONS = 4
_START_NOISE = 0.05
_START_BASIS = 0.03
_LEARNING = 0.5  # share of the work that is done when the draws of other vehicles begin, roughly
_VANISHED = 1e-3
_NEARNESS_ROUNDS = 8
_STRAIGHTENINGS = 3
_MOST_IMPORTANT = 8.0


@dataclass(frozen=True)
class NrsfmOptions:
    """How to learn."""

    basis: int = 5  # Number N of basis vectors
    # Keep mean and basis mirror-symmetric (the category's pairs); without pairs nothing is imposed
    symmetric: bool = True
    # Estimate the cameras' common distance and take perspective out of the annotations to first order; else it appears
    # as a mode that tells front from rear views
    perspective: bool = False
    # Degrees of freedom of Student's t noise, which bears wrong annotations; None for Gaussian noise
    dof: float | None = 2.0
    # Estimate noise and shape by the restricted likelihood, which allows for the fitted cameras; else by the plain
    # likelihood of Torresani et al
    restricted: bool = True
    min_visible: int = 8  # Images with fewer annotated keypoints are left out
    restarts: int = 3  # Random starts; the one that ends at the best likelihood is kept
    iterations: int = 600  # Most EM iterations of the last stage
    tolerance: float = 5e-6  # It ends when the bound rises by less, in nats per keypoint and iteration
    start_images: int = 2000  # Restarts use at most so many images
    rotations: int = 24  # Starts of the global search for each camera
    seed: int = 0  # Seed of everything random
    # Draws of the vehicles by which the mean's standard deviation is estimated; 0 for none. They change nothing else.
    bootstrap: int = 12

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A number is out of its range.
        """
        for field, lowest in (("basis", 0), ("min_visible", 4), ("restarts", 1), ("iterations", 2), ("rotations", 0)):
            if getattr(self, field) < lowest:
                raise InvalidInputError(f"options.{field}", getattr(self, field), f"Give at least {lowest}.")
        if self.bootstrap < 0 or self.bootstrap == 1:
            raise InvalidInputError("options.bootstrap", self.bootstrap, "Give 0, or 2 draws and more.")
        if self.dof is not None and not self.dof > 0:
            raise InvalidInputError("options.dof", self.dof, "Give a positive number, or None for Gaussian noise.")
        if not self.tolerance > 0:
            raise InvalidInputError("options.tolerance", self.tolerance, "Give a positive number.")


@dataclass(frozen=True)
class NrsfmProgress:
    """How far learning has come."""

    stage: str  # What is being done, in words
    fraction: float  # Share of all the work that is behind, an estimate
    iteration: int  # Iteration within the stage
    bound: float  # Log likelihood (or its lower bound) per keypoint, nats


ProgressCallback = Callable[[NrsfmProgress], None]


@dataclass(frozen=True)
class NrsfmResult:
    """What was learnt, in the object frame up to scale and origin (see `training.priors.learn` for metres)."""

    mean: Array  # (K, 3) mean shape; x forward, y down, z left; RMS distance of its keypoints from the origin 1
    basis: Array  # (N, K, 3) basis vectors for unit coefficients, orthogonal, the strongest first
    sigma: float  # noise (1 sigma per axis) in the same unit; the scale parameter of Student's t where dof is given
    # (M,) which of the given images were learnt from; the arrays below have one row for each of them
    used: NDArray[np.bool_]
    coefficients: Array  # (M', N) posterior mean of the coefficients
    cameras: Cameras  # the scaled-orthographic cameras, in the given pixels
    weights: Array  # (M', K) robust weights; 0 where unseen, 1 for Gaussian noise
    residual_sigma: Array  # (K,) root mean square of each keypoint's weighted residual per axis
    history: tuple[float, ...]  # bound after each pair of iterations of the last stage, nats; it never falls
    converged: bool  # whether the last stage ended by its tolerance
    restart_bounds: tuple[float, ...]  # bound per keypoint at the end of each restart
    nearness: float  # inverse distance of the cameras per unit of the shape; 0 for scaled orthography
    # (B, K, 3) means by other draws of the vehicles (`bootstrap`), fitted to the mean; B is 0 where none were made
    drawn: Array


def fit_nrsfm(
    category: Category,
    keypoints: ArrayLike,
    options: NrsfmOptions | None = None,
    *,
    views: ArrayLike | None = None,
    vehicles: ArrayLike | None = None,
    progress: ProgressCallback | None = None,
) -> NrsfmResult:
    """Learn mean, basis and noise of a category's keypoints from images of different instances.

    Args:
        category: Names, pairs, dimension groups and ground keypoints; nothing else is known of the shape.
        keypoints: (M, K, 2) annotated pixels (u right, v down), NaN where unseen.
        options: How to learn.
        views: (M,) class of each image's viewing direction, where known. Every class then counts alike, whatever the
            share of its images: scaled orthography errs differently from each direction, and evenly spread views
            cancel much of that (learnt from 3,000 street images, the mean shape's error falls from 1.5 to 1.15 %).
        vehicles: (M,) which vehicle each image shows, where known: how sure the mean is goes by vehicles then.
        progress: Called with the progress; it may raise to stop.

    Returns:
        The model in the object frame, up to scale and origin.

    Raises:
        InvalidInputError: Wrong shape or an infinite pixel.
        DegenerateProblemError: Too few images, a keypoint that no image shows, or no rigid shape explains the views
            (all from one direction).
    """
    options = options or NrsfmOptions()
    points = as_shape("keypoints", keypoints, (None, category.size, 2))
    used, data, centre, size = _prepare(category, points, options, views)
    subspace = SymmetricSubspace.of(category.size, category.symmetric_pairs, options.symmetric)
    tell, draws = progress or (lambda _: None), options.bootstrap
    share = _LEARNING if draws else 1.0
    learner = _Learner(category, subspace, options, lambda step: tell(replace(step, fraction=share * step.fraction)))
    learnt = learner.learn(data)
    number = vehicle_numbers(vehicles, used)

    def drew(draw: int, bound: float) -> None:
        done = share + (1.0 - share) * draw / draws
        tell(NrsfmProgress(f"other vehicles, draw {draw} of {draws}", done, draw, bound))

    rng = np.random.default_rng([options.seed, draws])
    drawn = bootstrapped_means(learnt.data, learnt.state, subspace, number, draws, options.dof, rng, progress=drew)
    return _result(category, subspace, learnt, (used, centre, size), drawn)


def _prepare(
    category: Category, points: Array, options: NrsfmOptions, views: ArrayLike | None
) -> tuple[NDArray[np.bool_], Data, Array, Array]:
    """The images to use, each centred and scaled to unit size, with the centres (M', 2) and sizes (M',)."""
    measured = np.asarray(np.isfinite(points).all(axis=2))
    if np.isinf(points).any():
        instance, keypoint, _ = np.argwhere(np.isinf(points))[0]
        name = category.keypoints[keypoint]
        raise InvalidInputError(
            f"keypoints[{instance}] {name}", "an infinite pixel", "Give finite pixels, or NaN where not seen."
        )
    count = measured.sum(axis=1)
    filled = np.where(measured[:, :, None], points, 0.0)
    centre = filled.sum(axis=1) / np.maximum(count, 1)[:, None]
    centred = (filled - centre[:, None]) * measured[:, :, None]
    size = np.sqrt(np.square(centred).sum(axis=(1, 2)) / np.maximum(count, 1))
    used = (count >= options.min_visible) & (size > 0)
    least = options.basis + 2
    if used.sum() < least:
        fix = f"Give at least {least} images, or lower options.min_visible ({options.min_visible})."
        raise DegenerateProblemError("keypoints", f"{used.sum()} images with enough seen keypoints", fix)
    rare = measured[used].sum(axis=0) < 2
    if rare.any():
        names = ", ".join(np.array(category.keypoints)[rare])
        raise DegenerateProblemError("keypoints", f"{names}: seen in fewer than two images", "Annotate more of them.")
    data = Data(
        centred[used] / size[used, None, None],
        measured[used].astype(np.float64),
        _importance(views, used),
        6.0 if options.restricted else 0.0,
    )
    return used, data, centre[used], size[used]


def _importance(views: ArrayLike | None, used: NDArray[np.bool_]) -> Array:
    """(M',) weights of mean 1 that let every class of view count alike, no image more than eight average ones."""
    if views is None:
        return np.ones(int(used.sum()))
    labels = np.asarray(views)
    if labels.shape != used.shape:
        raise InvalidInputError("views", f"shape {labels.shape}", f"Give one for each of {len(used)} images.")
    _, label, count = np.unique(labels[used], return_inverse=True, return_counts=True)
    importance = np.minimum(len(label) / (len(count) * count[label]), _MOST_IMPORTANT)
    return np.asarray(importance / importance.mean())


@dataclass(frozen=True)
class _Learnt:
    """Where learning ended: the data (without perspective where requested), the state, and how it went."""

    data: Data
    state: EmState
    history: list[float]
    converged: bool
    bounds: tuple[float, ...]
    nearness: float


@dataclass(frozen=True)
class _Learner:
    category: Category
    subspace: SymmetricSubspace
    options: NrsfmOptions
    progress: ProgressCallback

    def learn(self, data: Data) -> _Learnt:
        options = self.options
        rng = np.random.default_rng(options.seed)
        part, chosen = data, np.arange(len(data.points))
        if len(data.points) > options.start_images:
            chance = data.importance / data.importance.sum()
            chosen = np.sort(rng.choice(len(chance), options.start_images, replace=False, p=chance))
            part = replace(
                data, points=data.points[chosen], measured=data.measured[chosen], importance=np.ones(len(chosen))
            )
        nearness = 0.0
        if options.perspective:
            part, nearness = self._straightened(part, rng)
        partial = len(chosen) < len(data.points)
        share = 0.4 if partial or options.perspective else 1.0
        ends = [
            self._restart(part, generator, number, share * number / options.restarts, share / options.restarts)
            for number, generator in enumerate(rng.spawn(options.restarts))
        ]
        bounds = tuple(state.bound / part.keypoints for state, _, _ in ends)
        state, history, converged = ends[int(np.argmax(bounds))]
        if partial:
            state = self._extend(data, chosen, state, rng)
        straight, rounds = data, (_STRAIGHTENINGS if options.perspective else int(partial))
        for number in range(rounds):
            if options.perspective:
                straight = without_perspective(data, state, self._handedness(state), nearness)
                state = start_state(straight, state.model, state.cameras, options.dof, state.posterior.weight)
            begun = share + (1.0 - share) * number / rounds
            state, history, converged = self._em(
                straight, state, "all images", options.iterations, begun, (1.0 - share) / rounds
            )
            state = start_state(straight, state.model, state.cameras, options.dof, state.posterior.weight)
        return _Learnt(straight, state, history, converged, bounds, nearness)

    def _straightened(self, data: Data, rng: np.random.Generator) -> tuple[Data, float]:
        """The data without perspective, and the nearness of the cameras, from a rigid shape."""
        straight, nearness = data, 0.0
        state = self._rigid(data, rng)
        for _ in range(_NEARNESS_ROUNDS):
            state = start_state(straight, state.model, state.cameras, self.options.dof, state.posterior.weight)
            handedness = self._handedness(state)
            nearness = max(estimate_nearness(data, state, handedness), 0.0)
            straight = without_perspective(data, state, handedness, nearness)
            state = start_state(straight, state.model, state.cameras, self.options.dof, state.posterior.weight)
            state, _, _ = em(straight, state, self.subspace, dof=self.options.dof, iterations=10, tolerance=1e-4)
        return straight, nearness

    def _handedness(self, state: EmState) -> float:
        return float(np.sign(np.linalg.det(object_axes(self.category, state.model.mean))))

    def _restart(
        self, data: Data, rng: np.random.Generator, number: int, behind: float, share: float
    ) -> tuple[EmState, list[float], bool]:
        options, name = self.options, f"start {number + 1} of {self.options.restarts}"
        state = self._rigid(data, rng)
        rotations = uniform_rotations(options.rotations, rng)
        state = self._with_vectors(data, state, rng)
        state, _, _ = self._em(data, state, name, options.iterations // 4, behind, 0.3 * share)
        state = search_cameras(data, self._with_vectors(data, state, rng), rotations, options.dof)
        state, history, converged = self._em(data, state, name, options.iterations, behind + 0.3 * share, 0.7 * share)
        return start_state(data, state.model, state.cameras, options.dof, state.posterior.weight), history, converged

    def _with_vectors(self, data: Data, state: EmState, rng: np.random.Generator) -> EmState:
        """The state with small random vectors in place of those that are missing or have vanished.

        A vector of zeros is a stationary point of EM: once it vanishes it stays so, needed or not.
        """
        size, shape = state.model.mean.size, state.model.mean.shape
        _, strength, vectors = np.linalg.svd(state.model.basis.reshape(-1, size), full_matrices=False)
        kept = (strength[:, None] * vectors)[strength > _VANISHED * np.sqrt(size)]
        fresh = self.subspace.project(_START_BASIS * rng.standard_normal((self.options.basis - len(kept), *shape)))
        model = replace(state.model, basis=np.concatenate([kept.reshape(-1, *shape), fresh]))
        return start_state(data, model, state.cameras, self.options.dof, state.posterior.weight)

    def _rigid(self, data: Data, rng: np.random.Generator) -> EmState:
        """One rigid shape: factorisation, EM, global search for the cameras, EM."""
        dof = self.options.dof
        state = self._rigid_start(data, rng)
        state, _, _ = em(data, state, self.subspace, dof=dof, iterations=60, tolerance=1e-4)
        state = search_cameras(data, state, uniform_rotations(self.options.rotations, rng), dof)
        state, _, _ = em(data, state, self.subspace, dof=dof, iterations=20, tolerance=1e-4)
        return state

    def _rigid_start(self, data: Data, rng: np.random.Generator) -> EmState:
        best: tuple[float, Array, Array] | None = None
        for _ in range(_FACTORISATIONS):
            shape, affine, error = affine_factorisation(data.points, data.measured, self.subspace, rng)
            upgraded = metric_upgrade(shape, affine, self.subspace)
            if upgraded is not None and (best is None or error < best[0]):
                best = (error, *upgraded)
        if best is None:
            fix = "Give images from several directions that differ in azimuth and elevation."
            raise DegenerateProblemError("keypoints", "views that no rigid shape explains", fix)
        _, shape, rotation = best
        size = float(np.sqrt(np.square(shape).sum(axis=1).mean()))
        model = ShapeModel(shape, np.zeros((0, *shape.shape)), (_START_NOISE * size) ** 2)
        cameras = Cameras(rotation, np.full(len(rotation), size), np.zeros((len(rotation), 2)))
        return start_state(data, model, cameras, self.options.dof)

    def _extend(self, data: Data, chosen: NDArray[np.intp], state: EmState, rng: np.random.Generator) -> EmState:
        """The model of a part of the images, with cameras for all of them."""
        count = len(data.points)
        rotation = np.tile(np.eye(3)[:2], (count, 1, 1))
        scale, translation = np.full(count, np.median(state.cameras.inverse_scale)), np.zeros((count, 2))
        rotation[chosen] = state.cameras.rotation
        scale[chosen], translation[chosen] = state.cameras.inverse_scale, state.cameras.translation
        whole = start_state(data, state.model, Cameras(rotation, scale, translation), self.options.dof)
        rotations = uniform_rotations(max(self.options.rotations, 8), rng)
        return search_cameras(data, whole, rotations, self.options.dof)

    def _em(
        self, data: Data, state: EmState, stage: str, iterations: int, behind: float, share: float
    ) -> tuple[EmState, list[float], bool]:
        def report(iteration: int, value: float) -> None:
            # how long EM takes is not known: it nears the end of its share geometrically
            done = 1.0 - 0.5 ** (4.0 * iteration / iterations)
            self.progress(NrsfmProgress(stage, behind + share * done, iteration, value))

        options = self.options
        return em(
            data,
            state,
            self.subspace,
            dof=options.dof,
            iterations=max(iterations, 2),
            tolerance=options.tolerance,
            report=report,
        )


def _result(
    category: Category,
    subspace: SymmetricSubspace,
    learnt: _Learnt,
    prepared: tuple[NDArray[np.bool_], Array, Array],
    drawn: Array,
) -> NrsfmResult:
    """The state turned into the object frame, principal axes and the given pixels."""
    used, centre, size = prepared
    data = learnt.data
    model, cameras, posterior = learnt.state.model, learnt.state.cameras, learnt.state.posterior
    axes = object_axes(category, model.mean)
    count = model.basis.shape[0]
    turn, strength, vectors = np.linalg.svd(model.basis.reshape(count, category.size * 3), full_matrices=False)
    basis = (strength[:, None] * vectors).reshape(model.basis.shape) @ axes
    coefficients = posterior.mean @ turn
    change = np.tensordot(basis, category.dimension_operator, axes=([1, 2], [1, 2]))
    signs = np.array([np.sign(row[np.abs(row).argmax()]) or 1.0 for row in change])
    weighted = ((posterior.weight * posterior.squared).T @ data.importance) / (data.measured.T @ data.importance)
    total = float((posterior.weight * posterior.squared).sum(axis=1) @ data.importance)
    share = total / data.keypoints
    inverse_scale = cameras.inverse_scale / size
    return NrsfmResult(
        mean=subspace.project(model.mean @ axes),
        basis=subspace.project(basis * signs[:, None, None]),
        sigma=float(np.sqrt(model.variance)),
        used=used,
        coefficients=coefficients * signs,
        cameras=Cameras(
            cameras.rotation @ axes,
            inverse_scale,
            cameras.translation + inverse_scale[:, None] * centre,
        ),
        weights=posterior.weight,
        residual_sigma=np.sqrt(model.variance * weighted / share),
        history=tuple(learnt.history),
        converged=learnt.converged,
        restart_bounds=learnt.bounds,
        nearness=learnt.nearness,
        drawn=subspace.project(drawn @ axes),
    )
