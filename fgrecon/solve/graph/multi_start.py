"""Multi-start optimisation: every mode that matters is refined in the graph, and the full energy decides.

One car in one image: each proposal that came close is refined with a shape of its own, and the lowest energy wins.
Where that rests on few keypoints, it is searched once more from there (`fgrecon.solve.proposals.restarts`).
Where a vehicle is in several images, its shape is everybody's: the best proposals are solved together; then every
image's other proposals are refined with that shape held, a discrete graph over the images decides between them
(`fgrecon.solve.graph.mode_selection`), and where an image changes over everything is solved once more.

Pose and shape move together from the proposals on. With `joint=False` the pose stays the proposal's, and the strategies
of the paper solve at the fixed pose first (section III-C).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import turn_between
from fgrecon.core.half_turn import HALF_TURN
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative
from fgrecon.core.robust import StrategyName
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.mode_selection import is_flipped, select_modes
from fgrecon.solve.graph.newton import Step
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.proposals.pose_search import PoseEstimate, distinct
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.restarts import lower_poses
from fgrecon.solve.proposals.search_settings import SETTINGS as POSE_SEARCH


@dataclass(frozen=True)
class SolvedStage:
    """One stage of the optimisation: its name, its graph and its steps."""

    name: str
    graph: Graph
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class MultiStartResult:
    """Where the graph's optimisation ended."""

    optimum: Optimum  # the end; iterations and gain are those of all stages from the proposals that led there
    stages: tuple[SolvedStage, ...]  # all stages, those from other proposals before among them
    alternatives: tuple[tuple[Alternative, ...], ...]  # other poses of each observation, best first

    @property
    def graph(self) -> Graph:
        """The graph of the last stage."""
        return self.stages[-1].graph

    @property
    def ended(self) -> tuple[Graph, Optimum]:
        """The graph of the last stage, and its end."""
        return self.graph, self.optimum

    @property
    def settled_energy(self) -> float:
        """Energy at the visibility of the end's own poses, nats.

        That of `optimum` is at the visibility that it was held at. Where visibility swings this belongs to other
        poses, and ends of different starts cannot be compared by it.
        """
        values = self.optimum.values
        weights = self.graph.reweigh(values, self.optimum.state.weights, 1.0)
        return self.graph.energy(values, weights)


def minimise_from_proposals(
    observations: Sequence[GraphObservation],
    starts: Sequence[PoseEstimate],
    extra: Sequence[gtsam.NonlinearFactor] = (),
    *,
    in_order: bool = False,
    steady: float | None = None,
) -> MultiStartResult:
    """Minimise the full energy from the proposals.

    Args:
        observations: The observations.
        starts: The proposals of each.
        extra: Factors of the caller's own.
        in_order: Whether the images of a vehicle were taken one after the other, so that its heading seldom flips from
            one to the next.
        steady: Where the solves end, as `optimise` has it.

    Returns:
        The result. Where the start is behind the camera or a system is singular, the state so far and why.

    Raises:
        InvalidInputError: A factor of the caller's own has a key of no variable.
    """
    start = start_state(observations, starts)
    if extra:  # refuses those on variables that there are not, whatever the stages hold
        Graph(observations, start, pose_free=True, extra=extra)
    best = _run(observations, start, extra, steady)
    if len(observations) == 1:
        return _lowest_energy_mode(observations, best, starts[0], extra, steady)
    return _select_modes_of_images(observations, best, starts, extra, in_order=in_order)


def start_state(observations: Sequence[GraphObservation], starts: Sequence[PoseEstimate]) -> State:
    """Each observation at its best proposal, each vehicle with the mean of its proposals' shapes."""
    shapes = {}
    for number in dict.fromkeys(one.vehicle for one in observations):
        own = [start.coefficients for one, start in zip(observations, starts, strict=True) if one.vehicle == number]
        shapes[number] = (sum(own[1:], own[0]) / len(own), np.zeros((len(starts[0].weights), 3)))
    poses = [gtsam.Pose3(start.camera_T_object) for start in starts]
    return State(poses, shapes, [_weights(start) for start in starts])


def _weights(start: PoseEstimate) -> Weights:
    return Weights(start.weights, start.visibility, np.ones(4), float(start.camera_T_object[2, 3]))


def _stage_names(options: Options) -> tuple[str, ...]:
    if not options.shape.joint:
        return ("shape",)
    return ("shape", "joint") if options.strategy.is_paper else ("joint",)


def _run(
    observations: Sequence[GraphObservation],
    start: State,
    extra: Sequence[gtsam.NonlinearFactor],
    steady: float | None = None,
) -> MultiStartResult:
    """All stages from one state."""
    stages: list[SolvedStage] = []
    iterations, state = 0, start
    make_gains: tuple[Callable[[], float], ...] = ()
    for name in _stage_names(observations[0].problem.options):
        graph = Graph(observations, state, pose_free=name == "joint", extra=extra)
        optimum = optimise(graph, state, steady=steady)
        stages.append(SolvedStage(name, graph, optimum.steps))
        iterations, make_gains = iterations + optimum.iterations, make_gains + optimum.make_gains
        state = optimum.state
        if optimum.failure is not None:
            break
    return MultiStartResult(
        replace(optimum, iterations=iterations, make_gains=make_gains), tuple(stages), ((),) * len(observations)
    )


def _close_proposals(start: PoseEstimate) -> list[Alternative]:
    """The proposals to refine beside the best; none where the strategy defines no energy."""
    return [alternative for alternative in start.alternatives if alternative.excess <= SETTINGS.proposal_gap_nats]


def _lowest_energy_mode(
    observations: Sequence[GraphObservation],
    first: MultiStartResult,
    start: PoseEstimate,
    extra: Sequence[gtsam.NonlinearFactor],
    steady: float | None,
) -> MultiStartResult:
    """One car in one image: refine the other proposals, and take the one of least energy."""

    def refine(other: Alternative) -> MultiStartResult:
        moved = replace(start, camera_T_object=other.camera_T_object, coefficients=other.coefficients)
        return _run(observations, start_state(observations, [moved]), extra, steady)

    solved = [one for one in [first, *map(refine, _close_proposals(start))] if one.optimum.failure is None]
    if not solved:
        return first
    best = min(solved, key=lambda one: one.optimum.energy)
    least = -np.inf
    if start.everywhere and not extra and not best.graph.sensed:  # with which it would be slow, and gains nothing
        best, more = _restarted(observations[0], best, refine)
        solved += more
        least = 0.0 if more else least  # what is lower by so little that it is no other result
    others = [
        Alternative(
            one.optimum.state.poses[0].matrix(),
            one.optimum.state.shapes[observations[0].vehicle][0],
            max(one.optimum.energy - best.optimum.energy, least),
        )
        for one in solved
        if one is not best
    ]
    left = [other for other in start.alternatives if not other.excess <= SETTINGS.proposal_gap_nats]
    return replace(best, alternatives=(_distinct(best.optimum.state.poses[0], [*others, *left]),))


def _restarted(
    one: GraphObservation, best: MultiStartResult, refine: Callable[[Alternative], MultiStartResult]
) -> tuple[MultiStartResult, list[MultiStartResult]]:
    """A result that rests on few keypoints, or a better one from a search from there; and all that was refined."""
    tried: list[MultiStartResult] = []
    for again in range(SETTINGS.most_restarts):
        if not _rests_on_few(one.problem, best.optimum):
            break
        state = best.optimum.state
        lower = lower_poses(one.problem, state.poses[0].matrix(), state.shapes[one.vehicle][0], again)
        refined = [other for other in map(refine, lower) if other.optimum.failure is None]
        tried += refined
        lowest = min(refined, key=lambda other: other.settled_energy, default=best)
        if not lowest.settled_energy < best.settled_energy - SETTINGS.better_by_nats:
            break
        best = lowest
    return best, tried


def _rests_on_few(problem: Problem, optimum: Optimum) -> bool:
    """Whether so few keypoints carry a result that other shapes allow other poses."""
    options = problem.options
    if options.strategy.name is not StrategyName.MIXTURE or not options.shape.joint:
        return False  # weights are no probabilities, or the pose is the proposal's
    if float(problem.energy.keypoints.evidence.right.sum()) < SETTINGS.restart_least_right:
        return False
    many = float(problem.observation.measured.mean()) > SETTINGS.many_measured_share
    few = SETTINGS.restart_below_weight if many else SETTINGS.restart_below_weight_of_some
    return float(optimum.state.weights[0].keypoints.sum()) < few


def _select_modes_of_images(
    observations: Sequence[GraphObservation],
    best: MultiStartResult,
    starts: Sequence[PoseEstimate],
    extra: Sequence[gtsam.NonlinearFactor],
    *,
    in_order: bool,
) -> MultiStartResult:
    """Several images: those whose other proposals are more probable under the common shape change over to them."""
    alternatives: list[tuple[Alternative, ...]] = [() for _ in observations]
    for _ in range(SETTINGS.mode_rounds):
        if best.optimum.failure is not None:
            return best
        state = best.optimum.state
        modes = _modes_of(observations, state, starts, extra, in_order=in_order)
        chosen = [0] * len(observations)
        for number in state.shapes:
            own = [i for i, one in enumerate(observations) if one.vehicle == number]
            choice, behind = select_modes([modes[i] for i in own], in_order=in_order)
            for i, index, nats in zip(own, choice, behind, strict=True):
                chosen[i] = index
                ranked = [replace(mode, excess=float(n)) for mode, n in zip(modes[i], nats, strict=True)]
                pose = gtsam.Pose3(modes[i][index].camera_T_object)
                alternatives[i] = _distinct(pose, [one for j, one in enumerate(ranked) if j != index])
        if not any(chosen):
            break
        poses = [gtsam.Pose3(modes[i][index].camera_T_object) for i, index in enumerate(chosen)]
        moved = _run(observations, State(poses, state.shapes, state.weights), extra)
        if moved.optimum.failure is not None:
            break
        best = replace(moved, stages=best.stages + moved.stages)
    return replace(best, alternatives=tuple(alternatives))


def _modes_of(
    observations: Sequence[GraphObservation],
    state: State,
    starts: Sequence[PoseEstimate],
    extra: Sequence[gtsam.NonlinearFactor],
    *,
    in_order: bool,
) -> list[list[Alternative]]:
    """Of each image the present pose and the other proposals, refined with the shape held, with energies.

    Where neighbours of a sequence are flipped against each other, every image has the flipped pose as well.
    """
    poses = [pose.matrix() for pose in state.poses]
    pairs = zip(observations, observations[1:], poses, poses[1:], strict=False)
    flips = in_order and any(a.vehicle == b.vehicle and is_flipped(p, q) for a, b, p, q in pairs)
    modes = []
    for i, (one, start) in enumerate(zip(observations, starts, strict=True)):
        here = State([state.poses[i]], {one.vehicle: state.shapes[one.vehicle]}, [state.weights[i]])
        others = [other.camera_T_object for other in _close_proposals(start)]
        if others or turn_between(poses[i], start.camera_T_object) > POSE_SEARCH.distinct_turn_radians:
            others.append(start.camera_T_object)
        if flips and not any(is_flipped(poses[i], other) for other in others):
            others.append(poses[i] @ HALF_TURN)
        modes.append(_refined_with_shape_held(one, here, others, extra))
    return modes


def _refined_with_shape_held(
    one: GraphObservation, here: State, others: Sequence[NDArray[np.float64]], extra: Sequence[gtsam.NonlinearFactor]
) -> list[Alternative]:
    """The present pose of an image and others, refined with the shape held: energies in nats."""
    coefficients = here.shapes[one.vehicle][0]
    if not others:
        return [Alternative(here.poses[0].matrix(), coefficients, 0.0)]
    graph = Graph([one], here, pose_free=True, hold_shape=True, extra=extra)
    present = graph.energy(graph.values(here), here.weights)
    modes = [Alternative(here.poses[0].matrix(), coefficients, present)]
    for pose in others:
        moved = State([gtsam.Pose3(pose)], here.shapes, here.weights)
        optimum = optimise(Graph([one], moved, pose_free=True, hold_shape=True, extra=extra), moved)
        refined = optimum.state.poses[0].matrix()
        if optimum.failure is None and all(
            turn_between(refined, a.camera_T_object) > POSE_SEARCH.distinct_turn_radians for a in modes
        ):
            modes.append(Alternative(refined, coefficients, optimum.energy))
    return modes


def _distinct(pose: gtsam.Pose3, others: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Those that are turned against the pose and against each other, best first."""
    if not others:
        return ()
    best_first = sorted(others, key=lambda one: one.excess)
    kept = distinct([pose.matrix(), *(other.camera_T_object for other in best_first)])
    return tuple(best_first[i - 1] for i in kept[1:])
