"""Frames of one vehicle in one graph: poses, velocities, the shape, and what ties them together.

    marginal --- X(0,t-2) --- motion --- X(0,t-1) --- motion --- X(0,t)      the window
       |            |                       |                      |
       |         keypoints, box, ground   keypoints, ...        keypoints, ...
       +------------+---------- L(0) -------+----------------------+

Images of one vehicle err alike (`ShapeOptions.common_error`): the more there were, the less each counts against the
terms of the shape. Motion relative to a camera that moves in an unknown way only makes poses smooth, and counts by the
same share. Where the camera's motion is known it is evidence of another kind, whose errors are its own: how much larger
a parked car looks after one's own way says how far away it is, whatever its size. It counts whole.

A frame's velocity is that up to the next frame, the last one's that from the frame before: over the world where the
camera's motion is known from one to the other, else relative to the camera. One kind says nothing of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.keys import V, X
from factors.marginals import Marginal, marginal_factor
from fgrecon.core.motion import MotionModel
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.adjust import Adjusted, SolvedStage, adjust
from fgrecon.solve.graph.covariance import Spread
from fgrecon.solve.graph.graph import Graph, Seen, State, common_share
from fgrecon.solve.graph.observation import Weights
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle import Held
from fgrecon.solve.proposals.adjust import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.heading import HEADINGS, Belief
from fgrecon.solve.time.motion import link, velocity_terms

__all__ = ["Frame", "FrameStep", "OwnFactors", "WindowSolve", "solve_alone", "solve_window", "velocity_covariances"]

Array = NDArray[np.float64]

_LONGEST = 1.0  # seconds that one velocity stands for


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

    def __post_init__(self) -> None:
        """Take the problem as it is given."""
        self.given = self.given or self.problem

    def believe(self, before: Frame) -> None:
        """Take the belief of the frame before, with what this one says."""
        assert self.step is not None
        self.belief = before.belief.later(self.step.seconds, self.step.turn).told(self.evidence)

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
        extra: The factors of motion, and what is left of earlier frames.
        share: Of their information that the frames have.
        tied: The same of what ties them.
        over_world: Whether the velocity of each is over the world; else it is relative to the camera.
    """

    seen: tuple[Seen, ...]
    starts: tuple[PoseEstimate, ...]
    adjusted: Adjusted
    extra: tuple[gtsam.NonlinearFactor, ...]
    share: float = 1.0
    tied: float = 1.0
    over_world: tuple[bool, ...] = ()


def solve_alone(problem: Problem, start: PoseEstimate, number: int) -> WindowSolve:
    """Solve one frame as the single image that it is."""
    seen = Seen(problem, image=number)
    return WindowSolve((seen,), (start,), adjust([seen], [start]), ())


def solve_window(
    frames: Sequence[Frame],
    shape: Held,
    model: MotionModel,
    *,
    earlier: int = 0,
    left: Marginal | None = None,
    most: int | None = None,
    own: OwnFactors | None = None,
    stands: bool | None = None,
) -> WindowSolve:
    """Solve frames that follow each other together, and bring them to where they end.

    Args:
        frames: The frames, at least two.
        shape: Where the shape begins.
        model: How such vehicles move.
        earlier: How many more frames of the vehicle there were.
        left: What is left of them, as if each counted whole; or None.
        most: Newton's steps at most, see `fgrecon.solve.graph.optimise`.
        own: Makes factors of the caller's own for each step; or None.
        stands: Whether the vehicle stands in all of them; None where it may.

    Returns:
        What was solved; where it failed the frames stay as they are.
    """
    share = common_share(len(frames) + earlier, frames[0].problem.options)
    seen = tuple(Seen(f.problem, image=f.number) for f in frames)
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
    counted = list(extra)
    if left is not None:
        extra.append(marginal_factor(left.scaled(share)))
        counted.append(marginal_factor(left.scaled(share / frames[-1].problem.common_factor)))
    others = gtsam.Values()
    for frame in frames:
        others.insert(V(0, frame.number), frame.velocity)
    state = State([f.pose for f in frames], {0: shape}, [f.weights for f in frames], others)
    graph = Graph(seen, state, pose_free=True, extra=extra, counted=counted, earlier=earlier)
    optimum = optimise(graph, state, most)
    if optimum.failure is None:
        if most is not None:
            optimum = replace(optimum, unfinished=None)
        for frame, pose, weights in zip(frames, optimum.state.poses, optimum.state.weights, strict=True):
            frame.pose, frame.weights = pose, weights
            frame.velocity = optimum.state.others.atVector(V(0, frame.number))
    adjusted = Adjusted(optimum, (SolvedStage("track", graph, optimum.steps),), ((),) * len(frames))
    starts = tuple(frame.start for frame in frames)
    return WindowSolve(seen, starts, adjusted, tuple(extra), share, tied, tuple(_over_world(frames)))


def _over_world(frames: Sequence[Frame]) -> list[bool]:
    """Whether the velocity in each of several frames is over the world."""
    return [after.known for after in (*frames[1:], frames[-1])]


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
    for frame, after, known in zip(frames, [*frames[1:], frames[-1]], over_world, strict=True):
        assert after.step is not None
        seconds = min(after.step.seconds, _LONGEST)
        found += velocity_terms(frame.number, seconds, model, known=known, share=share, stands=stands)
    return found
