"""Pose search with measured points: poses of the picture, brought to the depths of the points.

A picture does not tell size from depth: its poses face the right way and are metres too near or too far, where no point
is on their surface and none pulls. So each of them is moved along its ray to where points begin, with the sizes of
several kinds of vehicles, and all are refined with the points, roughly at first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors.surface_points import PointRows, Shared
from fgrecon.core.arrays import Array
from fgrecon.solve.proposals.point_term import PointTerm
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import SearchResult, best_of, search
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.starts import at_azimuths, view_box
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.proposals.unsure_place import UnsurePlace

POINTS, MASKS = SETTINGS.points, SETTINGS.masks


def search_with_points(problem: Problem, pictured: Hypotheses, carrying: float) -> SearchResult:
    """Where the search ends with the points.

    Args:
        problem: With a term of points, and all coefficients.
        pictured: Poses that the picture alone leads to, with all coefficients.
        carrying: Sum of the keypoints' weights at the one of them that has the largest.
    """
    few = rests_on_few(problem, carrying)
    if few:
        pictured = Hypotheses.joined([pictured, _around(problem)])
    some = tuple(replace(one, rows=_some(_unsure(one))) for one in problem.energy.points)
    energy = replace(problem.energy, points=some, masks=problem.energy.masks if few else ())
    rough = replace(energy, points=tuple(replace(one, rows=_roughly(one.rows)) for one in some))
    starts = _starts(problem, pictured)
    best = best_of(rough, starts, POINTS.rough_starts)
    near = search(rough, best, POINTS.rough_iterations, {}).hypotheses
    return search(energy, near, POINTS.iterations, {POINTS.kept_from_iteration: POINTS.kept_hypotheses})


def rests_on_few(problem: Problem, carrying: float) -> bool:
    """Whether so few keypoints carry the picture's poses that others than these are possible."""
    return bool(problem.observation.measured.sum() < SETTINGS.least_keypoints or carrying < POINTS.least_carrying)


def search_with_mask(problem: Problem, pictured: Hypotheses) -> SearchResult:
    """Where the search ends with the silhouette, from the picture's poses and from all round."""
    starts = Hypotheses.joined([pictured, _around(problem)])
    return search(problem.energy, starts, MASKS.iterations, {MASKS.kept_from_iteration: POINTS.kept_hypotheses})


def _unsure(term: PointTerm) -> PointRows:
    """The points, which the search leaves where they are, unsure by what they share as well."""
    rows = term.rows
    if term.shared is None:
        return rows
    if isinstance(term.shared, UnsurePlace):
        return replace(rows, sigma=np.hypot(rows.sigma, term.shared.off(rows.points)))
    depth = rows.points[:, 2]
    by = np.stack([depth, np.ones(len(depth)) if rows.shared is Shared.DEPTH else depth**2], axis=1)
    variance = np.einsum("ij,jk,ik->i", by, term.shared.covariance, by)
    stretch = np.linalg.norm(rows.points, axis=1) / depth
    return replace(rows, along=np.sqrt(rows.along**2 + stretch**2 * variance))


def _some(rows: PointRows) -> PointRows:
    """Some of the points, which have the energy of all."""
    every = -(-len(rows.points) // POINTS.searched_points)
    points = rows.points[::every]
    share = rows.share * len(rows.points) / len(points)
    return replace(rows, points=points, sigma=rows.sigma[::every], along=rows.along[::every], share=share)


def _roughly(rows: PointRows) -> PointRows:
    """The points with an uncertainty that reaches metres, and patches that reach as far."""
    odds = replace(rows.odds, reach=POINTS.rough_sigma_m, reach_sigma=POINTS.rough_sigma_m)
    along = np.where(rows.along > 0.0, np.hypot(rows.along, POINTS.rough_sigma_m), 0.0)
    return replace(rows, sigma=np.full(len(rows.points), POINTS.rough_sigma_m), along=along, odds=odds)


def _around(problem: Problem) -> Hypotheses:
    """In the 2D box, turned all round: where the picture does not tell how a vehicle is turned.

    So it is as well where the picture's poses leave every keypoint, and the box: a van as a car is nearer than it is,
    and there it is off a ground that is surely known.
    """
    azimuths = 2.0 * np.pi * np.arange(POINTS.azimuths) / POINTS.azimuths
    box, ground = view_box(problem.observation), problem.ground
    return at_azimuths(box, problem.camera, problem.model, ground, azimuths, relative=True)


def _starts(problem: Problem, pictured: Hypotheses) -> Hypotheses:
    """The picture's poses, and all of them at the depths at which points begin, as several kinds of vehicles."""
    depths = _begins(np.concatenate([np.square(one.rows.points).sum(axis=1) for one in problem.energy.points]))
    metres = (depths[:, None] + POINTS.start_offsets_m).ravel()
    far = np.linalg.norm(pictured.translation, axis=1)
    moved = pictured.translation * (metres[:, None] / far)[..., None]  # (depths, H, 3)
    count = 1 + len(metres)
    every = Hypotheses(
        np.tile(pictured.rotation, (count, 1, 1)),
        np.concatenate([pictured.translation, moved.reshape(-1, 3)]),
        np.tile(pictured.coefficients, (count, 1)),
    )
    model = problem.model
    larger = model.by_size @ (np.array(POINTS.larger_size_m) - model.dimension_mean)
    grown = Hypotheses(every.rotation, every.translation, np.broadcast_to(larger, every.coefficients.shape).copy())
    return Hypotheses.joined([every, grown])


def _begins(squares: Array) -> Array:
    """(M,) distances at which vehicles may begin, metres, by the squares of all points' distances.

    Where points begin again behind a gap, of most points first: a vehicle that shows few is behind what hides it.
    """
    ranges = np.sqrt(np.sort(squares))
    first = np.flatnonzero(np.diff(ranges, prepend=-np.inf) > POINTS.start_gap_m)
    count = np.diff(first, append=len(ranges))
    most = np.argsort(-count, kind="stable")[: POINTS.start_clusters]
    behind = ranges[first[most[count[most] >= POINTS.least_points]]]
    ranks = np.array(POINTS.start_quantiles) * (len(ranges) - 1)
    among = np.interp(ranks, np.arange(len(ranges)), ranges)  # np.quantile takes longer
    return np.unique(np.concatenate([behind, among]).round(1))
