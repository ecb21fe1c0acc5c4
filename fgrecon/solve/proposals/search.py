"""Vectorised Levenberg-Marquardt over many poses at once, which keeps the best hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.native import native
from factors.silhouette import SilhouetteRows
from factors.surface_points import PointRows
from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.geometry import exponential
from fgrecon.core.robust import StrategyName
from fgrecon.solve.proposals.mask_term import MaskTerm
from fgrecon.solve.proposals.point_term import PointTerm
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.terms import (
    BoxTerm,
    CoefficientTerm,
    DirectionTerm,
    GroundTerm,
    Hypotheses,
    KeypointTerm,
    Quadratic,
    SizeTerm,
)
from fgrecon.solve.vehicle.visibility import VisibilityTable

_Summand = PointTerm | MaskTerm | BoxTerm | SizeTerm | GroundTerm | DirectionTerm | CoefficientTerm


@dataclass(frozen=True)
class PoseEnergy:
    """What the search minimises: the terms that apply, and how visible keypoints are from a pose."""

    keypoints: KeypointTerm  # reprojection term
    visibility: Callable[[Array], Array]  # probability (H, K) of each keypoint to be visible from poses (H, 4, 4)
    box: BoxTerm | None = None  # box term, or None
    size: SizeTerm | None = None  # size term, or None
    ground: GroundTerm | None = None  # ground term, or None
    direction: DirectionTerm | None = None  # term of the direction that the vehicle is observed from, or None
    points: tuple[PointTerm, ...] = ()  # terms of measured points
    masks: tuple[MaskTerm, ...] = ()  # term of the silhouette, if there is one

    def __getstate__(self) -> dict[str, Any]:
        """What it is made of; another process compiles it again."""
        return {name: value for name, value in vars(self).items() if name != "compiled"}

    @cached_property
    def compiled(self) -> Any:
        """The same energy compiled (`factors._energy.Observation`); None where that cannot evaluate it."""
        return _compile(self)

    def visible_from(self, camera_T_object: Array) -> Array:
        """(K,) visibility of the keypoints from a pose (4, 4)."""
        if self.compiled is not None:
            return self.compiled.visible_from(camera_T_object)
        return self.visibility(camera_T_object[None])[0]

    @property
    def others(self) -> Iterator[_Summand]:
        """The terms beside the keypoints' that there are."""
        terms = self.box, self.size, self.ground, self.direction
        yield from (term for term in terms if term is not None)
        yield from self.points
        yield from self.masks
        yield CoefficientTerm()

    def evaluate(self, h: Hypotheses, progress: float = 1.0) -> tuple[Quadratic, Array]:
        """Energy, gradient and Gauss-Newton matrix at the hypotheses, and the keypoints' weights (H, K)."""
        total = Quadratic(len(h), 6 + h.coefficients.shape[1])
        weights = self.keypoints.add(total, h, self.visibility(h.matrices()), progress)
        for term in self.others:
            term.add(total, h)
        return total, weights

    def truncated(self, dimension: int) -> PoseEnergy:
        """The energy of the first `dimension` coefficients alone, the others being zero, without points and masks."""
        box, size = self.box, self.size
        return replace(
            self,
            keypoints=replace(self.keypoints, basis=self.keypoints.basis[:dimension]),
            box=None if box is None else replace(box, basis=box.basis[:dimension]),
            size=None if size is None else replace(size, jacobian=size.jacobian[:, :dimension]),
            points=(),
            masks=(),
        )

    def energies(self, h: Hypotheses) -> dict[str, Array]:
        """Energy (H,) of each term at the hypotheses, nats."""

        def none() -> Quadratic:
            return Quadratic(len(h), 6 + h.coefficients.shape[1])

        total = none()
        self.keypoints.add(total, h, self.visibility(h.matrices()), 1.0)
        result = {self.keypoints.name: total.energy}
        for term in self.others:
            total = none()
            term.add(total, h)
            result[term.name] = total.energy
        return result


def _compile(energy: PoseEnergy) -> Any:
    kernel, keypoints = native("factors._energy"), energy.keypoints
    table = getattr(energy.visibility, "__self__", None)  # a function of the caller's own is not known there
    strategy, evidence = keypoints.strategy, keypoints.evidence
    if kernel is None or strategy.name is not StrategyName.MIXTURE or not isinstance(table, VisibilityTable):
        return None
    box, ground, size = energy.box, energy.ground, energy.size
    count = len(keypoints.basis)
    compiled = kernel.Observation(
        np.ascontiguousarray(keypoints.matrix, dtype=np.float64),
        np.ascontiguousarray(keypoints.mean),
        np.ascontiguousarray(keypoints.basis).reshape(count, 3 * len(keypoints.mean)),
        np.ascontiguousarray(keypoints.rows.pixels),
        np.ascontiguousarray(keypoints.rows.whitener),
        None if box is None else box.packed,
        None if ground is None else ground.packed,
    )
    compiled.search_by(
        np.ascontiguousarray(evidence.right, dtype=np.float64),
        np.ascontiguousarray(evidence.outlier, dtype=np.float64),
        np.ascontiguousarray(evidence.measured).view(np.uint8),
        (strategy.gross, strategy.missed, strategy.false_alarm),
        *table.packed,
        None if size is None else size.packed,
        None if energy.direction is None else energy.direction.probability,
    )
    rows: list[PointRows | SilhouetteRows] = [one.rows for one in energy.points]
    rows += [one.rows for one in energy.masks]
    compiled.search_beside([one.compiled for one in rows])
    return compiled


@dataclass(frozen=True)
class SearchResult:
    """What the search ends with."""

    hypotheses: Hypotheses  # the H surviving hypotheses, best first
    energy: Array  # (H,) their energies, nats
    weights: Array  # (H, K) weights of their keypoints
    path: Hypotheses  # the best one's states from its start on, as T hypotheses
    path_weights: Array  # (T, K) weights along the path

    @property
    def poses(self) -> Array:
        """(H, 4, 4) camera_T_object of the survivors."""
        return self.hypotheses.matrices()


def search(energy: PoseEnergy, starts: Hypotheses, iterations: int, keep: Mapping[int, int]) -> SearchResult:
    """Minimise from every start at once.

    Args:
        energy: What to minimise.
        starts: Start hypotheses, in front of the camera.
        iterations: Levenberg-Marquardt iterations.
        keep: Before iteration i all but the keep[i] best distinct hypotheses are dropped.

    Returns:
        The survivors, best first.
    """
    if energy.compiled is not None:
        return _compiled_search(energy.compiled, starts, iterations, keep)
    h = starts
    damping = np.full(len(h), SETTINGS.first_damping)
    total, weights = energy.evaluate(h, 0.0)
    survivor = np.arange(len(h))  # row of each hypothesis in the snapshot before
    snapshots = [(h, weights, survivor)]
    for iteration in range(iterations):
        if iteration in keep and keep[iteration] < len(h):
            survivor = _best_distinct(h, total.energy, keep[iteration])
            h, damping, weights, total = h.take(survivor), damping[survivor], weights[survivor], total.take(survivor)
        else:
            survivor = np.arange(len(h))
        trial = _retract(h, _damped_step(total, damping))
        trial_total, trial_weights = energy.evaluate(trial, (iteration + 1) / iterations)
        with np.errstate(invalid="ignore"):  # too near the camera before and after: inf - inf, no gain
            gain = total.energy - trial_total.energy
        better = gain > 0
        damping = np.where(better, damping * SETTINGS.damping_decrease, damping * SETTINGS.damping_increase)
        h = trial.where(better, h)
        total.update(better, trial_total)
        weights = np.where(better[:, None], trial_weights, weights)
        snapshots.append((h, weights, survivor))
        if iteration > max(keep, default=0) and not (np.abs(gain) > SETTINGS.settled_nats).any():
            break
    order = np.argsort(total.energy, kind="stable")
    path, path_weights = _path(snapshots, int(order[0]))
    return SearchResult(h.take(order), total.energy[order], weights[order], path, path_weights)


def best_of(energy: PoseEnergy, starts: Hypotheses, count: int) -> Hypotheses:
    """The starts of the least energies, at most so many, best first."""
    if energy.compiled is None:
        return starts.take(np.argsort(energy.evaluate(starts, 0.0)[0].energy, kind="stable")[:count])
    kernel = native("factors._energy")
    assert kernel is not None
    h = (np.ascontiguousarray(one) for one in (starts.rotation, starts.translation, starts.coefficients))
    return starts.take(kernel.best(energy.compiled, *h, MIN_DEPTH, count))


def _compiled_search(compiled: Any, starts: Hypotheses, iterations: int, keep: Mapping[int, int]) -> SearchResult:
    kept = np.zeros(iterations, dtype=np.intc)
    for iteration, count in keep.items():
        kept[iteration : iteration + 1] = count  # beyond the last iteration there is none
    kernel = native("factors._energy")
    assert kernel is not None
    final, energy, path = kernel.search(
        compiled,
        np.ascontiguousarray(starts.rotation),
        np.ascontiguousarray(starts.translation),
        np.ascontiguousarray(starts.coefficients),
        MIN_DEPTH,
        kept,
        SETTINGS.largest_turn_radians,
        SETTINGS.settled_nats,
        np.cos(SETTINGS.alike_radians),
        SETTINGS.first_damping,
        SETTINGS.damping_decrease,
        SETTINGS.damping_increase,
        SETTINGS.ridge,
    )
    return SearchResult(Hypotheses(*final[:3]), energy, final[3], Hypotheses(*path[:3]), path[3])


def _best_distinct(h: Hypotheses, energy: Array, count: int) -> NDArray[np.intp]:
    """Rows of the best hypotheses, at most `count`; one that is turned like a better one would end where that does."""
    cosine = (np.tensordot(h.rotation, h.rotation, axes=((1, 2), (1, 2))) - 1.0) / 2.0
    alike = cosine > np.cos(SETTINGS.alike_radians)
    kept: list[int] = []
    for row in np.argsort(energy, kind="stable").tolist():
        if not alike[row, kept].any():
            kept.append(row)
            if len(kept) == count:
                break
    return np.array(kept)


def _path(snapshots: list[tuple[Hypotheses, Array, NDArray[np.intp]]], row: int) -> tuple[Hypotheses, Array]:
    """Follow one final hypothesis back to its start."""
    states: list[tuple[Array, Array, Array, Array]] = []
    for h, weights, survivor in reversed(snapshots):
        states.append((h.rotation[row], h.translation[row], h.coefficients[row], weights[row]))
        row = int(survivor[row])
    rotation, translation, coefficients, weights = (np.array(part) for part in zip(*reversed(states), strict=True))
    return Hypotheses(rotation, translation, coefficients), weights


def _damped_step(total: Quadratic, damping: Array) -> Array:
    index = np.arange(total.matrix.shape[1])
    matrix = total.matrix.copy()
    matrix[:, index, index] *= 1.0 + damping[:, None]
    matrix[:, index, index] += SETTINGS.ridge
    step = -np.linalg.solve(matrix, total.gradient[..., None])[..., 0]
    turn = np.sqrt(np.square(step[:, :3]).sum(axis=1))
    return step * np.minimum(1.0, SETTINGS.largest_turn_radians / np.maximum(turn, 1e-12))[:, None]


def _retract(h: Hypotheses, step: Array) -> Hypotheses:
    return Hypotheses(h.rotation @ exponential(step[:, :3]), h.translation + step[:, 3:6], h.coefficients + step[:, 6:])
