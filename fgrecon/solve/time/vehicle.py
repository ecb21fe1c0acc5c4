"""One vehicle that is followed: each frame by itself first, then which way it faces, then the window's graph.

The first frame is solved alone, as a single image is. Of later ones the pose search is enough, which starts where the
motion leads as well: the window's graph solves them. The belief of the heading (`heading`) says which of a frame's
poses is meant, for this and for the other frames of the window; a frame that has none there starts anew, its keypoints
turned round if that explains them better.

The window is the last two frames and some of those before them, spread over seconds. Frames that follow each other
closely err alike and tell little of the way; a wide base line measures it. A frame that contradicts those before is
solved alone, and the next one decides: it goes on from those before, and the odd one is left out, or from the odd one,
and another vehicle has got the id.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.motion import moved
from fgrecon.core.camera import Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.motion import MotionModel
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Alternative, rotation_y
from fgrecon.core.turned import HALF_TURN, turned_round
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.terms import direction_penalty
from fgrecon.solve.time.heading import (
    Belief,
    another_side,
    backward,
    combined,
    directions_say,
    motion_says,
    poses_say,
    weight_of,
)
from fgrecon.solve.time.thin import thinned
from fgrecon.solve.time.window import Frame, FrameStep, OwnFactors, WindowSolve, solve_alone, solve_window

__all__ = ["Followed", "face", "image_says"]

Array = NDArray[np.float64]

_NEWTON = 4  # steps for a window: most of it was solved with the frame before
_CONTRADICTS, _AGREES = 25.0, 8.0
"""Nats by which a frame contradicts the motion from those before, and by which one that comes after such a frame agrees
with it: on KITTI's video up to 18 where a motion is right, 99 % below 6, and from 87 where another vehicle is seen."""
_ASKED = 0.3  # seconds after which it is asked anew whether a vehicle stands, where there was no doubt
_FAST = 60.0  # metres per second: no vehicle is taken to be faster when it is seen for the second time
_WAY, _PLACE, _DEPTH = 2.0, 0.3, 0.05
"""Metres that a vehicle must have gone for its way to say where it faces; how exactly its place is known: metres, and
per metre of depth."""
_DOUBTFUL = 12.0  # nats: a pose that is worse by more is none that the keypoints allow
_ALIKE = 3.0  # nats: that keypoints are turned round as a whole, one time in twenty


class Followed:
    """A vehicle over time.

    Attributes:
        frames: Those of the window.
        count: How many there were in all.
        shape: Lambda (N,) and offsets (K, 3).
        solved: The last solve.
    """

    solved: WindowSolve
    shape: ShapeValues

    def __init__(self, motion: MotionModel, window: int, own: OwnFactors | None = None) -> None:
        """Begin without a frame.

        Args:
            motion: How such vehicles move.
            window: Frames in the graph, at least two.
            own: Makes factors of the caller's own for each step from frame to frame; or None.
        """
        self.motion, self.window, self.own = motion, window, own
        self.frames: list[Frame] = []
        self.count = 0
        self._asked = -np.inf  # when it was asked whether it stands
        self._odd = False  # whether the last frame contradicts those before
        self._way = self._ahead = _Way()  # up to the last frame that was taken, and up to the one that was looked at

    def look(self, problem: Problem, time: float, step: FrameStep | None) -> Frame:
        """Look at a frame by itself; `settle` and `take` are to follow.

        Args:
            problem: What the frame shows.
            time: Its time, seconds.
            step: From the vehicle's frame before; None for the first.

        Raises:
            DegenerateProblemError: It determines no pose.
        """
        before = self.frames[-1] if self.frames else None
        said, self._ahead = (None, self._way) if before is None or step is None else self._way.on(before.pose, step)
        frame = self._seen(problem, time, step, said)
        if before is None or step is None:
            frame.belief = Belief.none().told(frame.evidence)
            return frame
        frame.believe(before)
        return frame

    def settle(self, frame: Frame, neighbours: Array) -> None:
        """Decide which way the vehicle faces, in a frame that was looked at and in those of the window.

        Args:
            frame: The frame.
            neighbours: (B,) what the other vehicles say of its heading, logarithms.
        """
        frame.neighbours = neighbours
        if frame.step is None:
            return  # a single image; see `again`
        face([*self.frames, frame], self.shape)

    def again(self, frame: Frame, problem: Problem, start: PoseEstimate) -> None:
        """Solve a vehicle's first frame once more, taken for another problem: what it shows is turned round."""
        frame.problem = frame.given = problem
        frame.start = start
        self._first(frame, start)

    def take(self, frame: Frame, ground: Ground | None) -> None:
        """Take a frame that was looked at, on a ground that may have been found meanwhile, and solve the window.

        Whatever is raised, the vehicle is then as it was before.
        """
        before = dict(vars(self), frames=[*self.frames])
        try:
            self._take(frame, ground)
        except BaseException:
            vars(self).update(before)
            raise

    def _take(self, frame: Frame, ground: Ground | None) -> None:
        if frame.problem.ground is not ground:
            turned = frame.problem is not frame.given
            frame.given = frame.given.on(ground)
            frame.problem = frame.problem.on(ground) if turned else frame.given
            if frame.step is None:
                self._first(frame, _from(frame))
        self.frames.append(frame)
        self._way = self._ahead
        self.count += 1
        if frame.step is not None:
            self._start_velocity()
            self._solve()

    def _seen(self, problem: Problem, time: float, step: FrameStep | None, way: Array | None) -> Frame:
        """A frame by itself, and what it says of the heading: of later ones than the first the search says enough."""
        start = search_pose(problem, None if step is None else self._foreseen(step))
        here = Alternative(start.camera_T_object, start.coefficients, 0.0)
        weights = Weights(start.weights, start.visibility, np.ones(4), float(start.camera_T_object[2, 3]))
        pose = gtsam.Pose3(start.camera_T_object)
        frame = Frame(self.count, time, problem, start, (here, *start.alternatives), np.zeros(0), step, pose, weights)
        if step is None:
            self._first(frame, start)
        frame.since = _since(self.frames[-1] if self.frames else None, step)
        frame.evidence = _by_itself(frame) if way is None else _by_itself(frame) + way
        return frame

    def _foreseen(self, step: FrameStep) -> Array:
        """(4, 4) where the vehicle should be if it goes on as it did, and so does a camera of unknown motion."""
        last = self.frames[-1]
        camera = step.camera or gtsam.Pose3()
        if last.step is not None and last.known != (step.camera is not None):
            camera = gtsam.Pose3()  # which a velocity relative to it counts already
            if last.step.camera is not None and not last.step.at_once:
                share = step.seconds / last.step.seconds
                camera = gtsam.Pose3.Expmap(share * gtsam.Pose3.Logmap(last.step.camera))
        return np.asarray(moved(last.pose, last.velocity, step.seconds, camera).matrix())

    def _first(self, frame: Frame, start: PoseEstimate) -> None:
        """Solve a frame as the single image that it is."""
        self.solved = solve_alone(frame.problem, start, frame.number)
        state = self.solved.adjusted.optimum.state
        self.shape, frame.pose, frame.weights = state.shapes[0], state.poses[0], state.weights[0]
        here = Alternative(frame.pose.matrix(), self.shape[0], 0.0)
        frame.poses = (here, *self.solved.adjusted.alternatives[0])

    def _start_velocity(self) -> None:
        """A new frame goes on as those before did; the second moment tells how, and a step of another kind likewise."""
        *earlier, frame = self.frames
        before, step = earlier[-1], frame.step
        assert step is not None
        begins = all(one.step is not None and one.step.at_once for one in earlier[1:])
        if not step.at_once and (begins or (before.step is not None and before.known != frame.known)):
            camera = gtsam.Pose3() if step.camera is None else step.camera
            twist = gtsam.Pose3.Logmap(before.pose.inverse().compose(camera.compose(frame.pose))) / step.seconds
            before.velocity = np.array([*np.clip(twist[[3, 5]], -_FAST, _FAST), 0.0])
            for one in earlier if begins else ():
                one.velocity = before.velocity
        frame.velocity = before.velocity

    def _solve(self) -> None:
        if self._odd:
            *before, odd, last = self.frames
            if self._solved([*before, last.without(odd)], _AGREES):
                last.follow(self.frames[-1])
                return
            self._begin_anew(odd, last)  # of another vehicle than those before
        if not self._solved(self.frames, _CONTRADICTS):
            self._odd = True
            self._solve_last()

    def _begin_anew(self, odd: Frame, last: Frame) -> None:
        """Go on from two frames alone: what those before said of the heading, and their way, are another vehicle's."""
        self.frames, self.shape = [odd, last], _shape(self.solved)
        self._way = self._ahead = _Way()
        odd.step = odd.since = None
        last.since = _since(odd, last.step)
        odd.evidence, last.evidence = _by_itself(odd), _by_itself(last)
        odd.belief = Belief.none().told(odd.evidence)
        last.believe(odd)
        face(self.frames, self.shape)
        self._start_velocity()

    def _solved(self, frames: list[Frame], energy: float) -> bool:
        """Solve frames and go on with them; nothing changes where the last contradicts those before by this energy."""
        now = frames[-1].time
        stands = self.solved.stands if now < self._asked + _ASKED else None
        self._asked = self._asked if stands is not None else now
        solved = solve_window(frames, self.shape, self.motion, most=_NEWTON, own=self.own, stands=stands)
        if solved.failed or solved.contradicts(energy):
            if stands is None:
                return False
            self._asked = -np.inf  # it may have begun to drive, or come to stand
            return self._solved(frames, energy)
        solved.bring(frames)
        self.solved, self.shape, self._odd = solved, _shape(solved), False
        self.frames = thinned(frames, self.window - 1)
        return True

    def _solve_last(self) -> None:
        """Solve the last frame as a single image; which of it and of those before is right the next one says."""
        shape, last = self.shape, self.frames[-1]
        start = replace(last.start, camera_T_object=last.pose.matrix(), weights=last.weights.keypoints, alternatives=())
        self._first(last, start)
        self.shape = shape


def _shape(solved: WindowSolve) -> ShapeValues:
    return solved.adjusted.optimum.state.shapes[0]


def _from(frame: Frame) -> PoseEstimate:
    """The poses that a frame was brought to, as proposals."""
    here, *others = frame.poses
    return replace(
        frame.start,
        camera_T_object=here.camera_T_object,
        coefficients=here.coefficients,
        weights=frame.weights.keypoints,
        visibility=frame.weights.visibility,
        alternatives=tuple(others),
    )


def _by_itself(frame: Frame) -> Array:
    """(B,) what a frame's image says of the heading, as far as it counts after the frames before."""
    seen = frame.given.observation
    return image_says(seen, frame.poses) * weight_of(frame.since, _height(seen))


def image_says(observation: Observation, poses: Sequence[Alternative]) -> Array:
    """(B,) logarithms of what an image says of the heading.

    Args:
        observation: What is seen there.
        poses: The poses that its keypoints allow, the result first, with the energies of the whole.
    """
    azimuth = observation.azimuth
    energies = [p.excess - direction_penalty(azimuth, p.camera_T_object) for p in poses]
    if not np.isfinite(energies).all():  # a strategy without an energy of its own
        energies = [0.0 if i == 0 else _ALIKE for i in range(len(poses))]
    evidence = poses_say([rotation_y(p.camera_T_object) for p in poses], energies, alone=azimuth is None)
    return evidence + directions_say(azimuth, poses[0].camera_T_object[:3, 3])


def face(frames: Sequence[Frame], shape: ShapeValues) -> list[Frame]:
    """Bring every frame to the side where it is by what all of them and the last one's neighbours say; the changed."""
    *_, last = frames
    steps = [(f.step.seconds, f.step.turn) for f in frames[1:] if f.step is not None]
    later = backward([*(f.evidence for f in frames[:-1]), last.evidence + last.neighbours], steps)
    changed = []
    for frame, likelihood in zip(frames, later, strict=True):
        heading = combined(last.believed if frame is last else frame.belief, likelihood).heading
        if another_side(rotation_y(frame.pose.matrix()), heading):
            _move(frame, heading, shape)
            changed.append(frame)
    return changed


def _move(frame: Frame, heading: float, shape: ShapeValues) -> None:
    """Start a frame anew, where it faces a heading."""
    near = [
        p for p in frame.poses if not p.excess > _DOUBTFUL and not another_side(rotation_y(p.camera_T_object), heading)
    ]
    if near:
        frame.pose = gtsam.Pose3(min(near, key=lambda p: p.excess).camera_T_object)
        if frame.problem is not frame.given:
            frame.problem, _ = _explaining(frame.given, frame.problem, frame.pose, frame.weights, shape)
        return
    pose = frame.pose.compose(gtsam.Pose3(HALF_TURN))
    if another_side(rotation_y(pose.matrix()), heading):
        pose = _turned_to(frame.pose, heading)
    other = _turned(frame.given) if frame.problem is frame.given else frame.given
    frame.problem, end = _explaining(frame.problem, other, pose, frame.weights, shape)
    refined = end.state.poses[0]
    frame.pose = pose if another_side(rotation_y(refined.matrix()), heading) else refined


def _explaining(
    first: Problem, second: Problem | None, pose: gtsam.Pose3, weights: Weights, shape: ShapeValues
) -> tuple[Problem, Optimum]:
    """The first of two problems, or the second where a pose explains that better by `_ALIKE`; with the refined pose."""
    end = _refined(first, pose, weights, shape)
    if second is not None and (other := _refined(second, pose, weights, shape)).energy + _ALIKE < end.energy:
        return second, other
    return first, end


def _turned(given: Problem) -> Problem | None:
    """The problem with its keypoints turned round; None where too few have a partner on the other side."""
    other = turned_round(given.observation, given.model.prior)
    try:
        return given.showing(other)
    except DegenerateProblemError:
        return None


def _refined(problem: Problem, pose: gtsam.Pose3, weights: Weights, shape: ShapeValues) -> Optimum:
    """The pose by its image alone, the shape held."""
    state = State([pose], {0: shape}, [weights])
    return optimise(Graph([GraphObservation(problem)], state, pose_free=True, hold_shape=True), state)


@dataclass(frozen=True)
class _Way:
    """Where a vehicle has gone over the world, as far as the camera's own motion is known.

    Attributes:
        camera: The camera, in a world that begins with the vehicle.
        begun: (3,) where the way begins, or None.
    """

    camera: gtsam.Pose3 = field(default_factory=gtsam.Pose3)
    begun: Array | None = None

    def on(self, pose: gtsam.Pose3, step: FrameStep) -> tuple[Array | None, _Way]:
        """What the way up to a frame says of the heading in the next one, and the way up to that.

        Args:
            pose: The vehicle in the frame.
            step: To the next one.

        Returns:
            (B,) logarithms, or None where the vehicle has not gone far enough; and the way.
        """
        if step.camera is None:
            return None, replace(self, begun=None)
        place = np.asarray(self.camera.transformFrom(pose.translation()))
        camera = self.camera.compose(step.camera)
        if self.begun is None:
            return None, _Way(camera, place)
        sigma = float(np.hypot(_PLACE, _DEPTH * np.linalg.norm(pose.translation())))
        moved = place - self.begun
        if np.linalg.norm(moved) < max(_WAY, 4.0 * sigma):
            return None, _Way(camera, self.begun)
        return motion_says(np.asarray(camera.rotation().unrotate(moved)), sigma), _Way(camera, place)


def _since(before: Frame | None, step: FrameStep | None) -> float | None:
    """Seconds to a frame from those of an earlier moment: what images of one moment say counts alike in any order."""
    if before is None or step is None:
        return None
    return before.since if step.at_once else step.seconds


def _height(observation: Observation) -> float:
    """Of a vehicle in the image, pixels."""
    if observation.box is not None:
        return float(observation.box[3] - observation.box[1])
    return float(np.ptp(observation.keypoints[observation.measured, 1]))


def _turned_to(pose: gtsam.Pose3, heading: float) -> gtsam.Pose3:
    """The pose, turned about its own vertical axis to a heading."""
    turn = heading - rotation_y(pose.matrix())
    return gtsam.Pose3(pose.rotation().compose(gtsam.Rot3.Ry(turn)), pose.translation())
