"""Window of frames of one vehicle as one graph: poses, velocities, the shape, and the motion between them.

    X(0,t-9) --- motion --- X(0,t-4) --- motion --- X(0,t-1) --- motion --- X(0,t)
       |                       |                       |                      |
    keypoints, box, ground   keypoints, ...         keypoints, ...         keypoints, ...
       +---------- L(0) -------+-----------------------+----------------------+

Images of one vehicle err alike (`ShapeOptions.common_error`): the more there were, the less each counts against the
terms of the shape. Motion relative to a camera that moves in an unknown way only makes poses smooth, and counts by the
same share. Where the camera's motion is known it is evidence of another kind, whose errors are its own: how much larger
a parked car looks after one's own way says how far away it is, whatever its size. It counts whole.

A frame's velocity is that up to the next frame, the last one's that from the frame before: over the world where the
camera's motion is known from one to the other, else relative to the camera. One kind says nothing of the other.

Past a vehicle that stands a camera of known motion measures how far away it is. One that drives tells nothing of that
kind, and which it is no frame says for itself: both are solved, and their energies decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby, pairwise

import gtsam
import numpy as np

from factors.keys import V, X, decode_key
from factors.vehicle_range import range_rate_factor
from fgrecon.core.arrays import Array
from fgrecon.core.category import MotionModel
from fgrecon.core.checks import as_list
from fgrecon.core.evidence import RangeRate
from fgrecon.core.reconstruction import rotation_y
from fgrecon.solve.graph.covariance import Spread, marginals_of
from fgrecon.solve.graph.graph import Graph, GraphObservation, State, common_share
from fgrecon.solve.graph.multi_start import MultiStartResult, SolvedStage, minimise_from_proposals
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.frame import Frame, seconds_from
from fgrecon.solve.time.heading_filter import another_side
from fgrecon.solve.time.motion_terms import between_terms, velocity_terms
from fgrecon.solve.time.time_settings import SETTINGS

MotionFactors = Callable[[int, int, float, float], Sequence[gtsam.NonlinearFactor]]
"""Numbers of two frames that follow each other, the seconds between them, and what to multiply standard deviations by:
makes factors on X(0, number), V(0, number) and L(0)."""

RANGE_RATE = "range_rate"
"""Name of what radars say of velocities."""


@dataclass(frozen=True)
class WindowSolve:
    """Frames of a window, solved together."""

    parts: tuple[GraphObservation, ...]  # the frames' observations
    starts: tuple[PoseEstimate, ...]  # their proposals
    adjusted: MultiStartResult  # where the graph's optimisation ended
    extra: tuple[gtsam.NonlinearFactor, ...]  # the factors of motion, and of range rates
    motion_share: float = 1.0  # share of their information that these have
    # whether the velocity of each is over the world, else it is relative to the camera; None where no time has
    # passed that tells it
    over_world: tuple[bool | None, ...] = ()
    # whether the vehicle stands in all of them, or drives; None where that is not certain
    stands: bool | None = None
    rates: tuple[gtsam.NonlinearFactor, ...] = ()  # of the factors those of range rates
    without: MultiStartResult | None = None  # the same without the caller's own factors; None where there are none

    def moved(self, frames: Sequence[Frame]) -> list[Frame]:
        """The frames where they ended."""
        state = self.adjusted.optimum.state
        return [
            replace(frame, pose=pose, weights=weights, velocity=state.others.atVector(V(0, frame.number)))
            for frame, pose, weights in zip(frames, state.poses, state.weights, strict=True)
        ]

    @property
    def shape(self) -> ShapeValues:
        """Lambda (N,) and offsets (K, 3) where it ended."""
        return self.adjusted.optimum.state.shapes[0]

    @property
    def failed(self) -> bool:
        """Whether there is no end."""
        return self.adjusted.optimum.failure is not None

    def contradicts(self, energy: float) -> bool:
        """Whether the last frame contradicts those before.

        Either by more than some energy (nats, if it counted whole) the motion to it and to the one before it; or its
        keypoints are all taken for wrong, though by itself they are right.
        """
        optimum, last = self.adjusted.optimum, {one.image for one in self.parts[-2:]}
        ends = [_frames_of(tuple(factor.keys())) for factor in self.extra]
        between = [f for f, some in zip(self.extra, ends, strict=True) if len(some) > 1 and some & last]
        if self.adjusted.graph.error_of(between, optimum.values) > energy * self.motion_share:
            return True
        start, pose = self.starts[-1], optimum.state.poses[-1].matrix()
        if another_side(rotation_y(pose), rotation_y(start.camera_T_object)):
            return False  # brought to another side, where its keypoints need not be right
        return bool(optimum.state.weights[-1].keypoints.sum() < SETTINGS.explained_share * start.weights.sum())


@lru_cache(maxsize=256)
def _frames_of(keys: tuple[int, ...]) -> frozenset[int]:
    """Numbers of the frames whose poses and velocities a factor is about."""
    return frozenset(key.low for key in map(decode_key, keys) if key.letter in "XV")


def solve_single(problem: Problem, start: PoseEstimate, number: int) -> WindowSolve:
    """Solve one frame as the single image that it is."""
    part = GraphObservation(problem, image=number)
    return WindowSolve((part,), (start,), minimise_from_proposals([part], [start]), ())


def solve_window(
    frames: Sequence[Frame],
    shape: ShapeValues,
    model: MotionModel,
    *,
    max_iterations: int | None = None,
    extra: MotionFactors | None = None,
    stands: bool | None = None,
) -> WindowSolve:
    """Solve frames that follow each other together.

    Args:
        frames: The frames, at least two.
        shape: Where the shape begins.
        model: How such vehicles move.
        max_iterations: Of Newton's steps, see `fgrecon.solve.graph.optimise`.
        extra: Makes factors of the caller's own for each step; or None.
        stands: Whether the vehicle stands, where that is known already; None where it is to be found out.
    """
    found = _solve_window(frames, shape, model, max_iterations, extra, stands)
    if extra is None:
        return found
    return replace(found, without=_solve_window(frames, shape, model, max_iterations, None, stands).adjusted)


def _solve_window(
    frames: Sequence[Frame],
    shape: ShapeValues,
    model: MotionModel,
    max_iterations: int | None,
    extra: MotionFactors | None,
    stands: bool | None,
) -> WindowSolve:
    """The frames together, standing or driving by what explains them better."""
    between, rates = _between_factors(frames, model), _range_rates(frames)

    def solved(known: bool | None) -> WindowSolve:
        factors = [*between, *_motion_factors(frames, model, extra, known)]
        return replace(_solved(frames, shape, [*factors, *rates], max_iterations, known), rates=tuple(rates))

    tells = seconds_from(frames[0].time, frames[-1].time) >= SETTINGS.driving_evidence_s
    if not (model.wheeled and tells and all(frame.camera_known for frame in frames[1:])):
        return solved(None)
    if stands is not None:
        return solved(stands)
    standing, driving = solved(known=True), solved(known=False)
    if standing.failed or driving.failed:
        return driving if standing.failed else standing
    gained = _energy(standing) - _energy(driving) - SETTINGS.driving_gain_nats
    better = driving if gained > 0.0 else standing
    return better if abs(gained) > SETTINGS.driving_margin_nats else replace(better, stands=None)


def _energy(solved: WindowSolve) -> float:
    optimum, graph = solved.adjusted.optimum, solved.adjusted.graph
    return sum((optimum.energies or graph.energies(optimum.values, optimum.state.weights)).values())


def _solved(
    frames: Sequence[Frame],
    shape: ShapeValues,
    extra: list[gtsam.NonlinearFactor],
    max_iterations: int | None,
    stands: bool | None,
) -> WindowSolve:
    """The frames together, with the motion of a vehicle that stands in all of them, or drives, or may do either."""
    parts = tuple(GraphObservation(f.problem, image=f.number) for f in frames)
    others = gtsam.Values()
    for frame in frames:
        others.insert(V(0, frame.number), frame.velocity)
    state = State([f.pose for f in frames], {0: shape}, [f.weights for f in frames], others)
    graph = Graph(parts, state, pose_free=True, extra=extra)
    optimum = optimise(graph, state, max_iterations)
    if optimum.failure is None and max_iterations is not None:
        optimum = replace(optimum, unfinished=None)
    adjusted = MultiStartResult(optimum, (SolvedStage("track", graph, optimum.steps),), ((),) * len(frames))
    starts, over_world = tuple(frame.start for frame in frames), tuple(_observed_over_world(frames))
    return WindowSolve(parts, starts, adjusted, tuple(extra), _shares(frames)[1], over_world, stands)


def _shares(frames: Sequence[Frame]) -> tuple[float, float]:
    """By which share the frames count, and what ties them: whole where the camera's motion is known."""
    share = common_share(len(frames), frames[0].problem.options)
    return share, 1.0 if all(frame.camera_known for frame in frames[1:]) else share


def _over_world(frames: Sequence[Frame]) -> list[bool]:
    """Whether the velocity in each of several frames is over the world."""
    return [after.camera_known for after in (*frames[1:], frames[-1])]


def _observed_over_world(frames: Sequence[Frame]) -> list[bool | None]:
    """The same; None of frames that follow each other and are all of one moment."""
    found: list[bool | None] = []
    for known, some in groupby((*frames[1:], frames[-1]), lambda after: after.camera_known):
        steps = [after.step for after in some]
        observed = any(step is not None and not step.simultaneous for step in steps)
        found += [known if observed else None] * len(steps)
    return found


def _between_factors(frames: Sequence[Frame], model: MotionModel) -> list[gtsam.NonlinearFactor]:
    """The factors of motion between frames that follow each other."""
    found: list[gtsam.NonlinearFactor] = []
    share = _shares(frames)[1]
    for (before, frame), kinds in zip(pairwise(frames), pairwise(_over_world(frames)), strict=True):
        assert frame.step is not None
        numbers, alike = (before.number, frame.number), kinds[0] == kinds[1]
        found += between_terms(numbers, frame.step, frame.pose, model, share=share, alike=alike)
    return found


def _motion_factors(
    frames: Sequence[Frame], model: MotionModel, extra: MotionFactors | None, stands: bool | None
) -> list[gtsam.NonlinearFactor]:
    """The factors about the velocity in each of frames that follow each other, and the caller's own.

    That a vehicle stands, or how fast one drives, is said once of each and not of each frame: it counts by the share.
    """
    found: list[gtsam.NonlinearFactor] = []
    over_world, (share, motion_share) = _over_world(frames), _shares(frames)
    last = next((frame for frame in frames[:0:-1] if frame.step and not frame.step.simultaneous), frames[-1])
    for frame, after, known in zip(frames, [*frames[1:], last], over_world, strict=True):
        assert after.step is not None
        seconds = min(after.step.seconds, SETTINGS.longest_velocity_s)
        found += velocity_terms(frame.number, seconds, model, known=known, share=share, stands=stands)
    for before, frame in pairwise(frames):
        if extra is not None and frame.step is not None:
            own = extra(before.number, frame.number, frame.step.seconds, motion_share**-0.5)
            found += as_list("motion_factors", own, gtsam.NonlinearFactor)
    return found


def _range_rates(frames: Sequence[Frame]) -> list[gtsam.NonlinearFactor]:
    """The factors of range rates; none of a rate over the ground where velocities are relative to the camera."""
    found: list[gtsam.NonlinearFactor] = []
    for i, (frame, known) in enumerate(zip(frames, _over_world(frames), strict=True)):
        model = frame.problem.model
        middle = np.array([0.0, -model.dimension_mean[2] / 2.0, 0.0])
        for one in _rates_of(frame):
            if one.over_ground and not known:
                continue
            moves = known and not one.over_ground
            sensor = _sensor_velocity([*frames[i:0:-1], *frames[i + 1 :]], one.origin) if moves else np.zeros(3)
            if sensor is not None:
                keys = X(0, frame.number), V(0, frame.number)
                found.append(range_rate_factor(keys, one.metres_per_second, one.sigma, one.origin, middle, sensor))
    return found


def _rates_of(frame: Frame) -> list[RangeRate]:
    return [one for one in frame.problem.observation.evidence if isinstance(one, RangeRate)]


def _sensor_velocity(frames: Sequence[Frame], origin: Array) -> Array | None:
    """(3,) velocity over the world, in the camera's axes, of what is at (3,) there; None where no step tells it.

    Args:
        frames: Those whose steps are looked at, the nearest first.
        origin: In the camera's frame.
    """
    for frame in frames:
        step = frame.step
        if step is not None and step.camera is not None and not step.simultaneous:
            twist = gtsam.Pose3.Logmap(step.camera) / step.seconds
            return twist[3:] + np.cross(twist[:3], origin)
    return None


def velocity_covariances(
    solved: WindowSolve, frames: Sequence[Frame], graph: Graph | None = None
) -> list[Array | None]:
    """(3, 3) covariance of each frame's velocity along the vehicle's own axes; None where it cannot be had.

    The axes are unsure as well: turned by w, a velocity changes by w x v. What images have wrong alike, for which they
    count by a share, leaves a velocity relative to the camera alone: of it they are as sure as if each counted whole.

    Args:
        graph: That of some of the factors; None for that which was solved.
    """
    graph, optimum = graph or solved.adjusted.graph, solved.adjusted.optimum
    keys = {key(0, frame.number) for frame in frames for key in (X, V)}
    spread = marginals_of(graph, optimum.values, optimum.state.weights, keys, as_assumed=True)
    return [None if spread is None else _velocity_covariance(spread, frame, solved.motion_share) for frame in frames]


def rate_gains(solved: WindowSolve, frames: Sequence[Frame], spreads: Sequence[Array | None]) -> list[dict[str, float]]:
    """By how many times the range rates of all frames make the velocity's standard deviation of each smaller.

    Nothing of a frame that has none, or where there is no covariance without them.

    Args:
        spreads: What `velocity_covariances` says of the frames.
    """
    if not solved.rates:
        return [{}] * len(frames)
    optimum, rates = solved.adjusted.optimum, {id(rate) for rate in solved.rates}
    others = [factor for factor in solved.extra if id(factor) not in rates]
    graph = Graph(solved.parts, optimum.state, pose_free=True, extra=others)
    graph.look(optimum.values)
    before = velocity_covariances(solved, frames, graph)
    return [
        {RANGE_RATE: float(np.sqrt(np.trace(without) / np.trace(spread)))}
        if without is not None and spread is not None and _rates_of(frame)
        else {}
        for frame, without, spread in zip(frames, before, spreads, strict=True)
    ]


def _velocity_covariance(spread: Spread, frame: Frame, share: float) -> Array | None:
    joint = spread.joint([X(0, frame.number), V(0, frame.number)])
    forward, left, _ = frame.velocity
    by_both = np.zeros((3, 9))
    by_both[:, :3] = -np.array([[0.0, -left, 0.0], [left, 0.0, -forward], [0.0, forward, 0.0]])
    by_both[0, 6] = by_both[2, 7] = 1.0
    covariance: Array = share * by_both @ joint @ by_both.T
    return covariance if np.isfinite(covariance).all() else None


def thinned(frames: Sequence[Frame], most: int) -> list[Frame]:
    """The frames that a window goes on from: few that are spread over seconds tell as much as many.

    Frames that follow each other closely err alike; past what stands a wide base line measures how far away it is.
    Motion and evidence of a frame that leaves pass on to the one after it. Where the camera's motion is known between
    some of them only, the oldest leaves, since what is known would be lost in a step of both kinds.

    Args:
        frames: Those of the window, in order.
        most: How many to keep at most.
    """
    now = frames[-1].time
    kept = [frame for frame in frames[:-2] if seconds_from(frame.time, now) <= SETTINGS.window_span_s]
    kept += frames[-2:]
    while len(kept) > most:
        times = [frame.time for frame in kept]
        inner = range(1, len(times) - 1)
        if not inner or len({frame.camera_known for frame in kept[1:]}) > 1:
            kept.pop(0)
            continue
        nearest = min(inner, key=lambda i: seconds_from(times[i - 1], times[i + 1]))
        kept[nearest : nearest + 2] = [kept[nearest + 1].without(kept[nearest])]
    return kept
