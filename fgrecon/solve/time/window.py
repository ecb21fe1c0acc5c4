"""Frames of one vehicle in one graph: poses, velocities, the shape, and what ties them together.

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
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.keys import V, X, decode_key
from fgrecon.core.motion import MotionModel
from fgrecon.core.reconstruction import Alternative, rotation_y
from fgrecon.solve.graph.covariance import Spread
from fgrecon.solve.graph.graph import Graph, GraphObservation, State, common_share
from fgrecon.solve.graph.multi_start import MultiStartResult, SolvedStage, minimise_from_proposals
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.heading import HEADINGS, Belief, another_side, carried
from fgrecon.solve.time.motion import link, velocity_terms

__all__ = [
    "AT_ONCE",
    "Frame",
    "FrameStep",
    "OwnFactors",
    "WindowSolve",
    "solve_alone",
    "solve_window",
    "velocity_covariances",
]

Array = NDArray[np.float64]

AT_ONCE = 1e-4
"""Seconds: nothing moves between frames that are no further apart; they are of two cameras."""

_LONGEST = 1.0  # seconds that one velocity stands for
_DRIVES = 7.0
"""Nats by which driving must explain the frames better than standing: the logarithm of the thousand speeds that there
are, as exactly as frames tell one. On KITTI's video parked vehicles stay at 6.6 or below, by two networks, and those
that drive begin at 10.5."""
_DOUBT = 3.0  # nats more or less than that: what leaves open which it is
_TELLS = 0.5  # seconds: frames of less time do not say which it is
_EXPLAINED = 0.2  # share of its keypoints' weights by itself


OwnFactors = Callable[[int, int, float, float], Sequence[gtsam.NonlinearFactor]]
"""Numbers of two frames that follow each other, the seconds between them, and what to multiply standard deviations by:
makes factors on X(0, number), V(0, number) and L(0)."""


@dataclass(frozen=True)
class FrameStep:
    """From a frame to the next.

    Attributes:
        seconds: Time.
        camera: camera_first_T_camera_second; None where it is unknown.
        covariance: (6, 6) of the camera's motion, rotation and translation in the second camera's frame.
    """

    seconds: float
    camera: gtsam.Pose3 | None
    covariance: Array

    def carried(self, pose: gtsam.Pose3) -> Array:
        """(6, 6) covariance by the camera's motion of a pose in the second frame, in the vehicle's own."""
        by_motion = pose.inverse().AdjointMap()
        return np.asarray(by_motion @ self.covariance @ by_motion.T)

    def then(self, later: FrameStep) -> FrameStep:
        """From this step's first frame to the second one of a later step, which begins where this one ends."""
        seconds = self.seconds + later.seconds
        if self.camera is None or later.camera is None:
            return FrameStep(seconds, None, np.zeros((6, 6)))
        by_later = later.camera.inverse().AdjointMap()
        return FrameStep(
            seconds, self.camera.compose(later.camera), by_later @ self.covariance @ by_later.T + later.covariance
        )

    @property
    def at_once(self) -> bool:
        """Whether both frames are of one moment, by two cameras."""
        return self.seconds < AT_ONCE

    @property
    def turn(self) -> float:
        """By how much `rotation_y` of a thing at rest changes, radians."""
        if self.camera is None:
            return 0.0
        axis = self.camera.rotation().matrix().T[:, 0]  # the first camera's x, in the second
        return float(np.arctan2(-axis[2], axis[0]))


@dataclass
class Frame:
    """One frame of the vehicle.

    Attributes:
        number: In the keys.
        time: Seconds.
        problem: What is given; the observation turned round where that is how it is taken.
        given: The same as it was given; the poses are of it.
        start: Its proposals.
        poses: The poses that its keypoints allow, with energies of the whole.
        evidence: (B,) what it says of the heading, logarithms.
        step: From the frame before; None for the first.
        pose: Where it is now.
        weights: Weights there.
        velocity: (3,) where it is now.
        belief: Of the heading, by this frame and those before.
        neighbours: (B,) what the other vehicles say of it, logarithms; no part of the belief.
        since: Seconds since the frames of an earlier moment; None where there are none.
    """

    number: int
    time: float
    problem: Problem
    start: PoseEstimate
    poses: tuple[Alternative, ...]
    evidence: Array
    step: FrameStep | None
    pose: gtsam.Pose3
    weights: Weights
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    belief: Belief = field(default_factory=Belief.none)
    neighbours: Array = field(default_factory=lambda: np.zeros(len(HEADINGS)))
    given: Problem = None  # type: ignore[assignment]  # the problem, unless it is told
    since: float | None = None

    def __post_init__(self) -> None:
        """Take the problem as it is given."""
        self.given = self.given or self.problem

    def believe(self, before: Frame) -> None:
        """Take the belief of the frame before, with what this one says."""
        assert self.step is not None
        self.belief = before.belief.later(self.step.seconds, self.step.turn).told(self.evidence)

    def without(self, before: Frame) -> Frame:
        """The frame after the one before that, whose evidence it takes over."""
        assert before.step is not None
        assert self.step is not None
        evidence = self.evidence + carried(before.evidence, self.step.seconds, self.step.turn)
        return replace(self, step=before.step.then(self.step), evidence=evidence)

    def follow(self, other: Frame) -> None:
        """Go where another solve of the same image has ended."""
        self.pose, self.weights, self.velocity, self.problem = other.pose, other.weights, other.velocity, other.problem

    @property
    def believed(self) -> Belief:
        """Of the heading, by all."""
        return self.belief.told(self.neighbours)

    @property
    def known(self) -> bool:
        """Whether the camera's motion from the frame before is."""
        return self.step is not None and self.step.camera is not None


@dataclass(frozen=True)
class WindowSolve:
    """Frames of a window, solved together.

    Attributes:
        seen: The frames' observations.
        starts: Their proposals.
        adjusted: Where the graph's optimisation ended.
        extra: The factors of motion.
        tied: Share of their information that these have.
        over_world: Whether the velocity of each is over the world, else it is relative to the camera; None where no
            time has passed that tells it.
        stands: Whether the vehicle stands in all of them, or drives; None where that is in doubt, or cannot be said.
    """

    seen: tuple[GraphObservation, ...]
    starts: tuple[PoseEstimate, ...]
    adjusted: MultiStartResult
    extra: tuple[gtsam.NonlinearFactor, ...]
    tied: float = 1.0
    over_world: tuple[bool | None, ...] = ()
    stands: bool | None = None

    def bring(self, frames: Sequence[Frame]) -> None:
        """Bring the frames to where they ended."""
        state = self.adjusted.optimum.state
        for frame, pose, weights in zip(frames, state.poses, state.weights, strict=True):
            frame.pose, frame.weights = pose, weights
            frame.velocity = state.others.atVector(V(0, frame.number))

    @property
    def failed(self) -> bool:
        """Whether there is no end."""
        return self.adjusted.optimum.failure is not None

    def contradicts(self, energy: float) -> bool:
        """Whether the last frame contradicts those before.

        Either by more than some energy (nats, if it counted whole) the motion to it and to the one before it; or its
        keypoints are all taken for wrong, though by itself they are right.
        """
        optimum, last = self.adjusted.optimum, {one.image for one in self.seen[-2:]}
        against = sum(f.error(optimum.values) for f in self.extra if len(ends := _frames_of(f)) > 1 and ends & last)
        if against > energy * self.tied:
            return True
        start, pose = self.starts[-1], optimum.state.poses[-1].matrix()
        if another_side(rotation_y(pose), rotation_y(start.camera_T_object)):
            return False  # brought to another side, where its keypoints need not be right
        return bool(optimum.state.weights[-1].keypoints.sum() < _EXPLAINED * start.weights.sum())


def _frames_of(factor: gtsam.NonlinearFactor) -> set[int]:
    """Numbers of the frames whose poses and velocities a factor is about."""
    keys = [decode_key(key) for key in list(factor.keys())]
    return {key.low for key in keys if key.letter in "XV"}


def solve_alone(problem: Problem, start: PoseEstimate, number: int) -> WindowSolve:
    """Solve one frame as the single image that it is."""
    seen = GraphObservation(problem, image=number)
    return WindowSolve((seen,), (start,), minimise_from_proposals([seen], [start]), ())


def solve_window(
    frames: Sequence[Frame],
    shape: ShapeValues,
    model: MotionModel,
    *,
    most: int | None = None,
    own: OwnFactors | None = None,
    stands: bool | None = None,
) -> WindowSolve:
    """Solve frames that follow each other together; they stay where they are.

    Args:
        frames: The frames, at least two.
        shape: Where the shape begins.
        model: How such vehicles move.
        most: Newton's steps at most, see `fgrecon.solve.graph.optimise`.
        own: Makes factors of the caller's own for each step; or None.
        stands: Whether the vehicle stands, where that is known already; None where it is to be found out.

    Returns:
        What was solved; where it failed the frames stay as they are.
    """
    tells = frames[-1].time - frames[0].time >= _TELLS
    if not (model.wheeled and tells and all(frame.known for frame in frames[1:])):
        return _solved(frames, shape, model, most, own, None)
    if stands is not None:
        return _solved(frames, shape, model, most, own, stands)
    standing, driving = (_solved(frames, shape, model, most, own, stands) for stands in (True, False))
    return _standing_or_driving(standing, driving)


def _standing_or_driving(standing: WindowSolve, driving: WindowSolve) -> WindowSolve:
    """What explains the frames better; that is in doubt where the other one is not much worse."""
    if standing.failed or driving.failed:
        return driving if standing.failed else standing
    gained = _energy(standing) - _energy(driving) - _DRIVES
    solved = driving if gained > 0.0 else standing
    return solved if abs(gained) > _DOUBT else replace(solved, stands=None)


def _energy(solved: WindowSolve) -> float:
    optimum, graph = solved.adjusted.optimum, solved.adjusted.graph
    return sum((optimum.energies or graph.energies(optimum.values, optimum.state.weights)).values())


def _solved(
    frames: Sequence[Frame],
    shape: ShapeValues,
    model: MotionModel,
    most: int | None,
    own: OwnFactors | None,
    stands: bool | None,
) -> WindowSolve:
    """The frames together, of a vehicle that stands in all of them, or drives, or None where it may do either."""
    share = common_share(len(frames), frames[0].problem.options)
    seen = tuple(GraphObservation(f.problem, image=f.number) for f in frames)
    tied = 1.0 if all(frame.known for frame in frames[1:]) else share
    extra = motion_factors(frames, model, share, tied, stands)
    if own is not None:
        pairs = [(before.number, frame) for before, frame in pairwise(frames)]
        extra += [
            factor
            for number, frame in pairs
            if frame.step is not None
            for factor in own(number, frame.number, frame.step.seconds, tied**-0.5)
        ]
    others = gtsam.Values()
    for frame in frames:
        others.insert(V(0, frame.number), frame.velocity)
    state = State([f.pose for f in frames], {0: shape}, [f.weights for f in frames], others)
    graph = Graph(seen, state, pose_free=True, extra=extra)
    optimum = optimise(graph, state, most)
    if optimum.failure is None and most is not None:
        optimum = replace(optimum, unfinished=None)
    adjusted = MultiStartResult(optimum, (SolvedStage("track", graph, optimum.steps),), ((),) * len(frames))
    starts = tuple(frame.start for frame in frames)
    return WindowSolve(seen, starts, adjusted, tuple(extra), tied, tuple(_told_over_world(frames)), stands)


def _over_world(frames: Sequence[Frame]) -> list[bool]:
    """Whether the velocity in each of several frames is over the world."""
    return [after.known for after in (*frames[1:], frames[-1])]


def _told_over_world(frames: Sequence[Frame]) -> list[bool | None]:
    """The same; None of frames that follow each other and are all of one moment."""
    found: list[bool | None] = []
    for known, some in groupby((*frames[1:], frames[-1]), lambda after: after.known):
        steps = [after.step for after in some]
        told = any(step is not None and not step.at_once for step in steps)
        found += [known if told else None] * len(steps)
    return found


def velocity_covariances(solved: WindowSolve, frames: Sequence[Frame]) -> list[Array | None]:
    """(3, 3) covariance of each frame's velocity along the vehicle's own axes; None where it cannot be had.

    The axes are unsure as well: turned by w, a velocity changes by w x v. What images have wrong alike, for which they
    count by a share, leaves a velocity relative to the camera alone: of it they are as sure as if each counted whole.
    """
    graph, optimum = solved.adjusted.graph, solved.adjusted.optimum
    asked = {key(0, frame.number) for frame in frames for key in (X, V)}
    spread = Spread.of(graph.build(optimum.state.weights), optimum.values, asked)
    return [None if spread is None else _velocity_covariance(spread, frame, solved.tied) for frame in frames]


def _velocity_covariance(spread: Spread, frame: Frame, share: float) -> Array | None:
    joint = spread.joint([X(0, frame.number), V(0, frame.number)])
    forward, left, _ = frame.velocity
    by_both = np.zeros((3, 9))
    by_both[:, :3] = -np.array([[0.0, -left, 0.0], [left, 0.0, -forward], [0.0, forward, 0.0]])
    by_both[0, 6] = by_both[2, 7] = 1.0
    covariance: Array = share * by_both @ joint @ by_both.T
    return covariance if np.isfinite(covariance).all() else None


def motion_factors(
    frames: Sequence[Frame], model: MotionModel, share: float, tied: float, stands: bool | None
) -> list[gtsam.NonlinearFactor]:
    """The factors of motion of frames that follow each other, and about the velocity in each.

    That a vehicle stands, or how fast one drives, is said once of each and not of each frame: it counts by the share.
    """
    found, over_world = [], _over_world(frames)
    for (before, frame), kinds in zip(pairwise(frames), pairwise(over_world), strict=True):
        step = frame.step
        assert step is not None
        numbers = before.number, frame.number
        carried, alike = step.carried(frame.pose), kinds[0] == kinds[1]
        found += link(numbers, step.seconds, model, step.camera, carried=carried, share=tied, alike=alike)
    last = next((frame for frame in frames[:0:-1] if frame.step and not frame.step.at_once), frames[-1])
    for frame, after, known in zip(frames, [*frames[1:], last], over_world, strict=True):
        assert after.step is not None
        seconds = min(after.step.seconds, _LONGEST)
        found += velocity_terms(frame.number, seconds, model, known=known, share=share, stands=stands)
    return found
