"""The search where points were measured: poses of the picture, brought to the depths of the points.

A picture does not tell size from depth: its poses face the right way and are metres too near or too far, where no point
is on their surface and none pulls. So each of them is moved along its ray to where points begin, with the sizes of
several kinds of vehicles, and all are refined with the points, roughly at first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from factors.surface_points import PointRows
from fgrecon.solve.proposals.point_term import PointTerm
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import SearchResult, search
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.proposals.starts import at_azimuths, view_box
from fgrecon.solve.proposals.terms import Hypotheses

Array = NDArray[np.float64]

POINTS = SETTINGS.points


def search_with_points(problem: Problem, pictured: Hypotheses) -> SearchResult:
    """Where the search ends with the points.

    Args:
        problem: With a term of points, and all coefficients.
        pictured: Poses that the picture alone leads to, with all coefficients.
    """
    assert problem.energy.points is not None
    energy = replace(problem.energy, points=PointTerm(_some(problem.energy.points.rows)))
    rough = replace(energy, points=PointTerm(_roughly(_some(problem.energy.points.rows))))
    starts = _starts(problem, pictured)
    best = search(rough, starts, 0, {}).hypotheses.take(np.arange(min(POINTS.rough_starts, len(starts))))
    near = search(rough, best, POINTS.rough_iterations, {}).hypotheses
    return search(energy, near, POINTS.iterations, {POINTS.kept_from_iteration: POINTS.kept_hypotheses})


def _some(rows: PointRows) -> PointRows:
    """Some of the points, which have the energy of all."""
    every = -(-len(rows.points) // POINTS.searched_points)
    points, sigma = rows.points[::every], rows.sigma[::every]
    return replace(rows, points=points, sigma=sigma, share=rows.share * len(rows.points) / len(points))


def _roughly(rows: PointRows) -> PointRows:
    """The points with an uncertainty that reaches metres, and patches that reach as far."""
    odds = replace(rows.odds, reach=POINTS.rough_sigma_m, reach_sigma=POINTS.rough_sigma_m)
    return replace(rows, sigma=np.full(len(rows.points), POINTS.rough_sigma_m), odds=odds)


def _starts(problem: Problem, pictured: Hypotheses) -> Hypotheses:
    """The picture's poses, and all of them at the depths at which points begin, as several kinds of vehicles."""
    energy = problem.energy
    assert energy.points is not None
    if problem.observation.measured.sum() < SETTINGS.least_keypoints:
        azimuths = 2.0 * np.pi * np.arange(POINTS.azimuths) / POINTS.azimuths
        box, ground = view_box(problem.observation), problem.ground
        around = at_azimuths(box, problem.camera, problem.model, ground, azimuths, relative=True)
        pictured = Hypotheses.joined([pictured, around])
    ranges = np.linalg.norm(energy.points.rows.points, axis=1)
    depths = np.unique(np.quantile(ranges, POINTS.start_quantiles).round(1))
    far = np.linalg.norm(pictured.translation, axis=1)
    parts = [pictured]
    for metres in (depths[:, None] + POINTS.start_offsets_m).ravel():
        moved = pictured.translation * (metres / far)[:, None]
        parts.append(Hypotheses(pictured.rotation, moved, pictured.coefficients))
    every = Hypotheses.joined(parts)
    model = problem.model
    larger = model.by_size @ (np.array(POINTS.larger_size_m) - model.dimension_mean)
    grown = Hypotheses(every.rotation, every.translation, np.broadcast_to(larger, every.coefficients.shape).copy())
    return Hypotheses.joined([every, grown])
