"""Filter of one vehicle: each frame by itself first, then its heading, then the window's graph.

The first frame is solved alone, as a single image is. Of later ones the pose search is enough, which starts where the
motion leads as well: the window's graph solves them. The belief of the heading (`heading`) says which of a frame's
poses is meant, for this and for the other frames of the window; a frame that has none there starts anew, its keypoints
flipped if that explains them better.

The window is the last two frames and some of those before them, spread over seconds. Frames that follow each other
closely err alike and tell little of the way; a wide base line measures it. A frame that contradicts those before is
solved alone, and the next one decides: it goes on from those before, and the odd one is left out, or from the odd one,
and another vehicle has got the id.

All of these are values: `VehicleFilter.observed` gives a `VehicleUpdate`, and that, `taken`, the next `VehicleFilter`.
Whatever is raised on the way, the vehicle is what it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np

from factors.motion import moved as moved_pose
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.category import MotionModel
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.frame import Frame, FrameStep, image_height, seconds_from
from fgrecon.solve.time.heading_choice import choose_headings, image_evidence
from fgrecon.solve.time.heading_filter import TrackHeading, path_evidence
from fgrecon.solve.time.time_settings import SETTINGS
from fgrecon.solve.time.window import MotionFactors, WindowSolve, solve_single, solve_window, thinned


@dataclass(frozen=True)
class FilterModel:
    """How vehicles are followed."""

    motion: MotionModel  # how such vehicles move
    window: int  # frames in the graph, at least two
    past: int | None = None  # frames of a vehicle that are kept; None keeps all
    extra: MotionFactors | None = None  # makes factors of the caller's own for each step from frame to frame; or None


@dataclass(frozen=True)
class VehicleFilter:
    """A vehicle after a frame."""

    model: FilterModel  # how it is followed
    frames: tuple[Frame, ...]  # those of the window, in order
    # all that are kept, in order, as they are now; each for itself, also where the window has merged some
    past: tuple[Frame, ...]
    count: int  # how many there were in all
    shape: ShapeValues  # Lambda (N,) and offsets (K, 3)
    solved: WindowSolve  # the last solve
    path: VehiclePath  # over the world, up to the last frame
    asked: float = -np.inf  # when it was asked whether it stands, seconds
    odd: bool = False  # whether the last frame contradicts those before

    def observed(self, problem: Problem, time: float, step: FrameStep) -> VehicleUpdate:
        """The vehicle in its next frame, by itself.

        Args:
            problem: What the frame shows.
            time: Its time, seconds.
            step: From the vehicle's frame before.

        Raises:
            DegenerateProblemError: The frame determines no pose.
        """
        before = self.frames[-1]
        reached, path = self.path.on(before.pose, step)
        start = search_pose(problem, self.foreseen(step))
        frame = _frame(self.count, time, problem, start, step)
        return VehicleUpdate(self.model, self, frame.following(before, reached), self.shape, self.solved, path)

    def foreseen(self, step: FrameStep) -> Array:
        """(4, 4) where the vehicle should be if it goes on as it did, and so does a camera of unknown motion."""
        last = self.frames[-1]
        camera = step.camera or gtsam.Pose3()
        if last.step is not None and last.camera_known != (step.camera is not None):
            camera = gtsam.Pose3()  # which a velocity relative to it counts already
            if last.step.camera is not None and not last.step.simultaneous:
                share = step.seconds / last.step.seconds
                camera = gtsam.Pose3.Expmap(share * gtsam.Pose3.Logmap(last.step.camera))
        return np.asarray(moved_pose(last.pose, last.velocity, step.seconds, camera).matrix())

    def with_frames(self, frames: Sequence[Frame]) -> VehicleFilter:
        """The vehicle with these frames in its window; those that stand for themselves are so in its past, too."""
        changed = {frame.number: frame for frame in frames if not frame.merged}
        past = tuple(changed.get(frame.number, frame) for frame in self.past)
        return replace(self, frames=tuple(frames), past=past)

    def extended(self, frame: Frame, path: VehiclePath) -> VehicleFilter:
        """The vehicle with another frame, and its window solved."""
        past = (*self.past, frame) if self.model.past is None else (*self.past, frame)[-self.model.past :]
        longer = replace(self, past=past, count=self.count + 1, path=path)
        longer = longer.with_frames(_with_velocity([*self.frames, frame]))
        if longer.odd:
            *earlier, odd, last = longer.frames
            agreeing = _window_solved(longer, [*earlier, last.without(odd)], SETTINGS.agreement_nats)
            if agreeing is not None:
                end = agreeing.frames[-1]
                last = replace(last, pose=end.pose, weights=end.weights, velocity=end.velocity)
                return replace(agreeing, past=(*agreeing.past[:-1], last))
            longer = _begun_anew(longer, odd, last)  # of another vehicle than those before
        return _window_solved(longer, longer.frames, SETTINGS.contradiction_nats) or _with_odd_frame(longer)


def _begun_anew(vehicle: VehicleFilter, odd: Frame, last: Frame) -> VehicleFilter:
    """Go on from two frames alone: what those before said of the heading, and their path, are another vehicle's."""
    odd = _begun(odd)
    last = last.following(odd)
    shape = vehicle.solved.shape
    frames = _with_velocity(choose_headings([odd, last], shape))
    return replace(vehicle, shape=shape, path=VehiclePath(), asked=last.time).with_frames(frames)


def _window_solved(vehicle: VehicleFilter, frames: Sequence[Frame], energy: float) -> VehicleFilter | None:
    """The vehicle with frames solved; None where the last contradicts those before by this energy, nats."""
    model, now = vehicle.model, frames[-1].time

    def solve(stands: bool | None) -> WindowSolve:
        most = SETTINGS.window_iterations
        return solve_window(frames, vehicle.shape, model.motion, max_iterations=most, extra=model.extra, stands=stands)

    stands = vehicle.solved.stands if seconds_from(vehicle.asked, now) < SETTINGS.driving_recheck_s else None
    solved = solve(stands)
    if stands is not None and (solved.failed or solved.contradicts(energy)):
        stands = None  # it may have begun to drive, or come to stand
        solved = solve(stands)
    if solved.failed or solved.contradicts(energy):
        return None
    asked = vehicle.asked if stands is not None else now
    moved = replace(vehicle, shape=solved.shape, solved=solved, asked=asked, odd=False).with_frames(
        solved.moved(frames)
    )
    return replace(moved, frames=tuple(thinned(moved.frames, model.window - 1)))


def _with_odd_frame(vehicle: VehicleFilter) -> VehicleFilter:
    """The vehicle with its last frame as a single image: which of it and of those before is right the next one says."""
    *earlier, last = vehicle.frames
    start = replace(last.start, camera_T_object=last.pose.matrix(), weights=last.weights.keypoints, alternatives=())
    last, solved = _solved_alone(last, start)
    return replace(vehicle, solved=solved, asked=last.time, odd=True).with_frames([*earlier, last])


@dataclass(frozen=True)
class VehicleUpdate:
    """A vehicle in a frame that is not taken yet."""

    model: FilterModel  # how it is followed
    vehicle: VehicleFilter | None  # as it was before; None where this is its first frame
    frame: Frame
    shape: ShapeValues  # Lambda (N,) and offsets (K, 3): of the vehicle, or by its first frame
    solved: WindowSolve  # the last solve, or that of the first frame
    path: VehiclePath  # up to the frame

    def settled(self) -> VehicleUpdate:
        """The update on the side where the vehicle faces, as are the frames of its window."""
        if self.vehicle is None:
            return self  # a single image; see `restarted`
        *earlier, frame = choose_headings([*self.vehicle.frames, self.frame], self.shape)
        return replace(self, frame=frame, vehicle=self.vehicle.with_frames(earlier))

    def restarted(self, problem: Problem, start: PoseEstimate) -> VehicleUpdate:
        """A vehicle's first frame solved once more, taken for another problem: its keypoints are flipped."""
        frame, solved = _solved_alone(replace(self.frame, given=problem, flipped=None, start=start), start)
        return replace(self, frame=frame, shape=solved.shape, solved=solved)

    def taken(self, ground: Ground | None, frame: Frame) -> VehicleFilter:
        """The vehicle with this frame, on a ground and by sensors that may be known better by now.

        Args:
            ground: The ground, or None.
            frame: This frame, itself where nothing was found of its sensors.

        Raises:
            FgreconError: It cannot be solved there.
        """
        same = frame is self.frame and frame.problem.ground is ground
        update = self if same else self._changed(ground, frame)
        frame = update.frame
        if update.vehicle is not None:
            return update.vehicle.extended(frame, self.path)
        return VehicleFilter(self.model, (frame,), (frame,), 1, update.shape, update.solved, self.path)

    def _changed(self, ground: Ground | None, frame: Frame) -> VehicleUpdate:
        """The update on another ground, with this frame as it is known now."""
        flipped = None if frame.flipped is None else frame.flipped.on(ground)
        frame = replace(frame, given=frame.given.on(ground), flipped=flipped)
        if self.vehicle is not None:
            return replace(self, frame=frame)
        here, *others = frame.poses
        start = replace(  # the poses that it was brought to, as proposals
            frame.start,
            camera_T_object=here.camera_T_object,
            coefficients=here.coefficients,
            weights=frame.weights.keypoints,
            visibility=frame.weights.visibility,
            alternatives=tuple(others),
        )
        frame, solved = _solved_alone(frame, start)
        return replace(self, frame=frame, shape=solved.shape, solved=solved)


def first_observed(model: FilterModel, problem: Problem, time: float) -> VehicleUpdate:
    """A vehicle in its first frame, which is solved as a single image.

    Raises:
        DegenerateProblemError: The frame determines no pose.
    """
    start = search_pose(problem)
    frame, solved = _solved_alone(_frame(0, time, problem, start), start)
    return VehicleUpdate(model, None, _begun(frame), solved.shape, solved, VehiclePath())


def _frame(number: int, time: float, problem: Problem, start: PoseEstimate, step: FrameStep | None = None) -> Frame:
    """A frame at its best proposal, as if it were the first."""
    here = Alternative(start.camera_T_object, start.coefficients, 0.0)
    poses = (here, *start.alternatives)
    image = _evidence(problem.observation, poses)
    heading = TrackHeading.begun(image, start.camera_T_object[:3, 3], image_height(problem.observation))
    return Frame(
        given=problem,
        start=start,
        poses=poses,
        pose=gtsam.Pose3(start.camera_T_object),
        weights=Weights(start.weights, start.visibility, np.ones(4), float(start.camera_T_object[2, 3])),
        number=number,
        time=time,
        step=step,
        image=image,
        heading=heading,
        belief=heading.belief,
    )


def _solved_alone(frame: Frame, start: PoseEstimate) -> tuple[Frame, WindowSolve]:
    """A frame where it ends as the single image that it is, and the solve."""
    solved = solve_single(frame.problem, start, frame.number)
    state = solved.adjusted.optimum.state
    here = Alternative(state.poses[0].matrix(), state.shapes[0][0], 0.0)
    poses = (here, *solved.adjusted.alternatives[0])
    return replace(frame, pose=state.poses[0], weights=state.weights[0], poses=poses), solved


def _with_velocity(frames: Sequence[Frame]) -> list[Frame]:
    """A new frame goes on as those before did; the second moment tells how, and a step of another kind likewise."""
    *earlier, frame = frames
    before, step = earlier[-1], frame.step
    assert step is not None
    velocity = before.velocity
    begins = all(one.step is not None and one.step.simultaneous for one in earlier[1:])
    if not step.simultaneous and (begins or (before.step is not None and before.camera_known != frame.camera_known)):
        camera = gtsam.Pose3() if step.camera is None else step.camera
        twist = gtsam.Pose3.Logmap(before.pose.inverse().compose(camera.compose(frame.pose))) / step.seconds
        most = SETTINGS.highest_speed_m_per_s
        velocity = np.array([*np.clip(twist[[3, 5]], -most, most), 0.0])
        earlier[-1:] = [replace(before, velocity=velocity)]
        if begins:
            earlier = [replace(one, velocity=velocity) for one in earlier]
    return [*earlier, replace(frame, velocity=velocity)]


def _begun(frame: Frame) -> Frame:
    """A frame as the first of its vehicle, by the poses that it has now."""
    return replace(frame, image=_evidence(frame.given.observation, frame.poses)).begun()


def _evidence(observation: Observation, poses: Sequence[Alternative]) -> Array:
    """(B,) logarithms of what an image says of the heading; a low vehicle shows less."""
    return image_evidence(observation, poses) * min(image_height(observation) / SETTINGS.full_height_px, 1.0)


@dataclass(frozen=True)
class VehiclePath:
    """Where a vehicle has gone over the world, as far as the camera's own motion is known."""

    camera: gtsam.Pose3 = field(default_factory=gtsam.Pose3)  # the camera, in a world that begins with the vehicle
    begun: Array | None = None  # (3,) where the path begins, or None

    def on(self, pose: gtsam.Pose3, step: FrameStep) -> tuple[Array | None, VehiclePath]:
        """What the path up to a frame says of the heading in the next one, and the path up to that.

        Args:
            pose: The vehicle in the frame.
            step: To the next one.

        Returns:
            (B,) logarithms, or None where the vehicle has not gone far enough; and the path.
        """
        if step.camera is None:
            return None, replace(self, begun=None)
        place = np.asarray(self.camera.transformFrom(pose.translation()))
        camera = self.camera.compose(step.camera)
        if self.begun is None:
            return None, VehiclePath(camera, place)
        by_depth = SETTINGS.place_sigma_per_m * np.linalg.norm(pose.translation())
        sigma = float(np.hypot(SETTINGS.place_sigma_m, by_depth))
        way = place - self.begun
        if np.linalg.norm(way) < max(SETTINGS.path_m, 4.0 * sigma):
            return None, VehiclePath(camera, self.begun)
        return path_evidence(np.asarray(camera.rotation().unrotate(way)), sigma), VehiclePath(camera, place)
