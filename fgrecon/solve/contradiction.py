"""Contradictions between the caller's own factors, or ranges, and the images: how much worse these fit than without.

Right ones bring an image from its minimum to the truth, which costs a few nats. Wrong ones cost more: they bring it to
a pose that it does not show, or make the vehicle larger or smaller than such are. Keypoints contradict themselves where
they fit better with left and right exchanged: of a mirrored image, or by the viewer's sides.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from statistics import median

from factors.keys import decode_key
from factors.vehicle_range import RangeFactor
from fgrecon.core.errors import FgreconError
from fgrecon.core.input_warnings import FACTORS_CONTRADICT, RANGE_CONTRADICTS, SETTINGS, fit_share
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.robust import StrategyName
from fgrecon.solve.graph.graph import EXTRA, Graph, GraphObservation
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import STATUS
from fgrecon.solve.weakness import weakened

Ended = tuple[Graph, Optimum]
"""A graph, and its minimum."""

_SHAPE = "LOPM"


def with_contradictions(
    found: Sequence[Reconstruction], ended: Ended, without: Ended | None = None, indices: Sequence[int] | None = None
) -> list[Reconstruction]:
    """The results, weak where factors of the caller's own, or ranges, contradict the images.

    Args:
        found: Results of observations of a graph.
        ended: That graph, and its end.
        without: The graph of the same observations without the caller's factors, and its end; None where it has none.
        indices: Which observations the results are of; None for all.
    """
    every = range(len(ended[0].observations)) if indices is None else indices
    if (no_ranges := _without_ranges(*ended)) is not None:
        found = _contradicted(found, ended, no_ranges, every, RANGE_CONTRADICTS)
    return [*found] if without is None else _contradicted(found, ended, without, every, FACTORS_CONTRADICT)


def _contradicted(
    found: Sequence[Reconstruction], ended: Ended, without: Ended, indices: Sequence[int], contradict: str
) -> list[Reconstruction]:
    """The results, weak where a graph's images fit worse than those of the graph without something, by its name."""
    graph = ended[0]
    if graph.options.strategy.name is not StrategyName.MIXTURE:  # other energies have outliers pull at poses
        return [*found]
    if ended[1].failure is not None or without[1].failure is not None:
        return [*found]
    known = _vehicles_of_shape_factors(graph)
    with_them, alone = _energies(*ended, known), _energies(*without, known)
    vehicles = [part.vehicle.number for part in graph.observations]
    lost = [one - other for one, other in zip(with_them, alone, strict=True)]
    results = []
    for i, result in zip(indices, found, strict=True):
        usual = median(nats for nats, number in zip(lost, vehicles, strict=True) if number == vehicles[i])
        reason = ""
        if lost[i] > STATUS.contradicted_nats:
            reason = f"{contradict} image and shape prior, which fit worse by {lost[i]:.0f} nats"
        elif vehicles.count(vehicles[i]) > 1 and usual > STATUS.contradicted_median_nats:
            reason = f"{contradict} half of its images, which fit worse by {usual:.0f} nats and more"
        if reason and not result.status.settled:
            result = replace(result, message=f"{result.message} {reason[0].upper()}{reason[1:]}.")
        results.append(weakened(result, (reason,) if reason else ()))
    return results


def _without_ranges(graph: Graph, optimum: Optimum) -> Ended | None:
    """A graph without its ranges, and its end; None where it has none, or failed."""
    name = RangeFactor.name
    if optimum.failure is not None or not any(name in graph.names_of(i) for i in range(len(graph.observations))):
        return None
    options = replace(graph.options, disabled_terms=graph.options.disabled_terms | {name})
    parts = [
        GraphObservation(replace(part.problem, options=options), part.vehicle.number, part.image)
        for part in graph.observations
    ]
    alone = Graph(parts, optimum.state, pose_free=True, extra=graph.extra)
    return alone, optimise(alone, optimum.state)


def _vehicles_of_shape_factors(graph: Graph) -> set[int]:
    """Numbers of the vehicles about whose shape the caller knows more than the prior."""
    keys = [decode_key(key) for factor in graph.extra for key in list(factor.keys())]
    return {key.vehicle for key in keys if key.letter in _SHAPE}


def _energies(graph: Graph, optimum: Optimum, known: Collection[int]) -> list[float]:
    """Energy of each observation, and its vehicle's, where a graph ended, without the caller's factors, nats.

    An image counts whole, though images of one vehicle have a share each; shapes that are `known` count nothing.
    """
    found = []
    for i, (part, weights) in enumerate(zip(graph.observations, optimum.state.weights, strict=True)):
        shape = dict(part.vehicle.energies(optimum.values))
        terms = graph.energies_of(i, optimum.values, weights)
        image = sum(nats for name, nats in terms.items() if name != EXTRA and name not in shape) / part.share
        found.append(image + (0.0 if part.vehicle.number in known else sum(shape.values())))
    return found


def with_mirrored_gain(result: Reconstruction, problem: Problem) -> Reconstruction:
    """The result with what exchanging left and right gains, weak where that is much.

    Args:
        result: Of the vehicle by itself, or in a scene.
        problem: What was solved.
    """
    observation = problem.observation
    share = fit_share(observation, result.diagnostics.weights)
    if observation.azimuth is not None or share is None or share >= SETTINGS.unmirrored_share:
        return result
    try:
        exchanged = problem.showing(observation.renamed(problem.model.prior.category.mirror))
        there = search_pose(exchanged)
        gain = search_pose(problem).energy - there.energy
    except FgreconError:
        return result
    after = fit_share(exchanged.observation, there.weights)
    if after is None or after < SETTINGS.unmirrored_share:  # neither fits
        return result
    found = replace(result, diagnostics=replace(result.diagnostics, mirrored_gain=float(gain)))
    if not gain > SETTINGS.mirrored_gain_nats:
        return found
    return weakened(found, [f"its keypoints fit better with left and right exchanged, by {gain:.0f} nats"])
