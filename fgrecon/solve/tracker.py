"""Vehicles over time: keypoints of frame after frame in, poses, shapes and velocities out.

    frame t: keypoints by id, camera ---- pose search ---- facing by all frames ---- graph of a window ---- estimates
                                               |                                           |
                                             ground                   two frames, and some of the seconds before

A vehicle's first frame gives what `fgrecon.reconstruct` gives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_finite
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import GraphFactor, Reconstruction, rotation_y
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.turned import turned_alternative
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.solve.box_check import box_excess, boxes_off
from fgrecon.solve.facing import couple_facings
from fgrecon.solve.frame_vehicles import FrameVehicles, PastFrame, VehicleTrack
from fgrecon.solve.graph.multi_start import MultiStartResult
from fgrecon.solve.graph.structure import graph_factors
from fgrecon.solve.inputs import SolveSetup, as_camera_pose, as_ground, as_motion_covariance, calibrated, observe
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.result import count, results
from fgrecon.solve.road import KnownGround, Road
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.time.camera_way import CameraWay
from fgrecon.solve.time.neighbours import with_neighbours
from fgrecon.solve.time.smooth import smooth
from fgrecon.solve.time.vehicle import Followed
from fgrecon.solve.time.window import Frame, OwnFactors, WindowSolve, velocity_covariances

__all__ = ["Tracker"]

Array = NDArray[np.float64]

_MAPPING = "Give a mapping: an `fgrecon.Observation` by id. Images go to `fgrecon.video.ImageTracker`."
_MOST_FRAMES = 100  # of a window
_SHORTEST = 1e-6  # seconds from frame to frame: noise that grows with time must not vanish


class Tracker:
    """Follows vehicles by their ids; every frame makes their estimates better.

    Attributes:
        refused: Why vehicles of the last frame have no estimate, by id.
    """

    refused: Mapping[int, FgreconError]

    def __init__(
        self,
        *,
        prior: ShapePrior | str | Path = "car14",
        size_prior: SizePrior | str | None = None,
        options: Options | None = None,
        window: int = 5,
        shared_ground: bool = False,
        past: int | None = 1000,
        motion_factors: OwnFactors | None = None,
    ) -> None:
        """Prepare for vehicles of one category.

        Args:
            prior: Shape prior, or its name, or the path of its file.
            size_prior: Fleet (`kitti`, `apollo79`), or a size prior; None takes sizes from the shape prior.
            options: Settings; `joint` must be set.
            window: Frames that are solved together when a new one comes, 2 to 100: that one, the one before it, and
                some of the seconds before.
            shared_ground: Whether the vehicles share one ground that is a variable and changes from frame to frame: it
                is found first, by a step of a solve of all vehicles of the frame together. Where none is told, two
                vehicles and more tell where it is.
            past: Frames of each vehicle to keep for `smooth`; None keeps all.
            motion_factors: Makes factors of your own between frames of a vehicle: called with the numbers of two that
                follow each other in a window (frames between them may have left it), the seconds between them, and a
                factor to multiply standard deviations by (frames count by a share, and so does what ties them). They
                are on X(0, number), V(0, number) and L(0) of `factors`.

        Raises:
            InvalidInputError: An argument cannot be used; names it, its value and the fix.
        """
        setup = SolveSetup.of(prior, size_prior, options, joint=True)
        if not isinstance(window, int | np.integer) or not 2 <= window <= _MOST_FRAMES:
            raise InvalidInputError("window", window, f"Give 2 to {_MOST_FRAMES} frames, a whole number.")
        if past is not None and (not isinstance(past, int | np.integer) or past < 1):
            raise InvalidInputError("past", past, "Give at least 1 frame, a whole number, or None.")
        self._setup = replace(setup, options=replace(setup.options, keep_history=False))
        self._window, self._past = window, past
        self._shared, self._own, self._road = shared_ground, motion_factors, Road()
        self._tracks: dict[int, VehicleTrack] = {}
        self._forgotten: list[float] = []  # how far the boxes of vehicles were off that were forgotten
        self._time = self._clock = -np.inf
        self._cameras: list[tuple[Camera, gtsam.Pose3 | None]] = []  # of the last time
        self._way = CameraWay()
        self._one_call = Lock()
        self.refused = {}

    def __reduce__(self) -> str:
        """A tracker is not copied.

        Raises:
            TypeError: Always: the graphs that it holds are GTSAM's, whose Python factors have no copy.
        """
        raise TypeError("a Tracker cannot be copied or pickled: keep the observations, and give them to another one")

    @single_threaded
    def update(
        self,
        time: float,
        observations: Mapping[int, KeypointsLike],
        *,
        camera: Camera | ArrayLike,
        world_T_camera: ArrayLike | None = None,
        ground: Ground | float | None = None,
        motion_covariance: ArrayLike | None = None,
    ) -> dict[int, VehicleEstimate]:
        """Take a frame. Calls from several threads are taken one after the other.

        Args:
            time: Of the frame, seconds, later than of all before, by a microsecond at least; or that of the last one,
                where both have a place and are of different cameras.
            observations: Keypoints of each vehicle that it shows, by id: as `fgrecon.reconstruct` takes them.
            camera: The camera that took it, or its matrix (3, 3), or (fx, fy, cx, cy).
            world_T_camera: (4, 4) pose of the camera in a world that stands still; None where it is not known. Between
                frames that both have one, vehicles move as their category does, and parked ones stand.
            ground: Ground plane in the camera's frame; a number is the height in metres of a level camera.
            motion_covariance: (6, 6) of the camera's motion since the last frame that has a place: rotation in radians,
                then translation in metres, in this camera's frame (`CameraMotion`); None where it is exact.

        Returns:
            The estimates by id, by this frame and those before; vehicles without one are in `refused`.

        Raises:
            InvalidInputError: An argument cannot be used; names it, its value and the fix.
        """
        time = float(as_finite("time", time, (), "Give seconds."))
        if not issubclass(kind := type(observations), Mapping):
            raise InvalidInputError("observations", kind.__name__, _MAPPING)
        seen_by, plane = calibrated("camera", Camera.of(camera)), as_ground(ground)
        place = None if world_T_camera is None else gtsam.Pose3(as_camera_pose(world_T_camera))
        moved = None if motion_covariance is None else as_motion_covariance(motion_covariance)
        with self._one_call:
            return self._update(time, observations, seen_by, place, plane, moved)

    def _update(
        self,
        time: float,
        observations: Mapping[int, KeypointsLike],
        seen_by: Camera,
        place: gtsam.Pose3 | None,
        plane: Ground | None,
        moved: Array | None,
    ) -> dict[int, VehicleEstimate]:
        clock = self._go_on(time, seen_by, place)
        self._way.go(place, moved)
        refused: dict[int, FgreconError] = {}

        def problem(observation: Observation, ground: Ground | None) -> Problem:
            return Problem.of(observation, seen_by, self._setup.model, ground, self._setup.options)

        seen = self._seen(observations, seen_by, refused)
        vehicles = FrameVehicles(clock, place, self._way, seen, problem, self._track, refused)
        known: KnownGround | None = None
        if self._shared:
            known = self._road.later(clock, plane, seen_by, place, vehicles, motion_covariance=moved)
            plane = plane if known is None else known.ground
        else:
            vehicles.look(plane)
        found: dict[int, VehicleEstimate] = {}
        for name, (track, frame) in vehicles.looked.items():
            try:
                track.followed.take(frame, plane)
            except FgreconError as error:
                refused[name] = error
                continue
            self._tracks[name] = track
            track.time, track.world_T_camera, track.milestone = clock, place, self._way.here
            stands_on = known if "ground" not in self._setup.options.disabled_terms else None
            track.past.append(PastFrame(frame, time, place, stands_on))
            if self._past is not None:
                del track.past[: -self._past]
            found[name] = self._estimate(name, track)
        self.refused = refused
        return found

    def _go_on(self, time: float, camera: Camera, place: gtsam.Pose3 | None) -> float:
        """Go on to a frame; returns its time by a clock on which frames of one time are a microsecond apart.

        Noise that grows with time must not vanish.

        Raises:
            InvalidInputError: It is not later, nor of another camera at a known place.
        """
        if abs(time - self._time) < _SHORTEST and place is not None and self._are_others(camera, place):
            self._cameras.append((camera, place))
        elif time - self._time >= _SHORTEST:
            self._cameras = [(camera, place)]
        else:
            fix = f"Give frames in order, a microsecond apart at least: the last one was at {self._time:.10g} s."
            fix += " Different cameras may have frames at the same time, if all of these have `world_T_camera`."
            raise InvalidInputError("time", time, fix)
        self._time, self._clock = time, max(time, self._clock + _SHORTEST)
        return self._clock

    def _are_others(self, camera: Camera, place: gtsam.Pose3) -> bool:
        """Whether the cameras of the last time have places as well, and none of them is this one."""
        return all(
            there is not None and not (there.equals(place, 0.0) and np.array_equal(other.matrix, camera.matrix))
            for other, there in self._cameras
        )

    def _track(self, name: int) -> VehicleTrack:
        """The track of a vehicle; a new one is among those that are kept once it is solved."""
        return self._tracks.get(name) or VehicleTrack(
            Followed(self._setup.prior.category.motion, self._window, self._own)
        )

    def _seen(
        self, observations: Mapping[int, KeypointsLike], camera: Camera, refused: dict[int, FgreconError]
    ) -> dict[int, Observation]:
        """The observations as they are solved from; those that cannot be used go to `refused`."""
        found: dict[int, Observation] = {}
        for name, given in observations.items():
            try:
                found[name] = observe(given, camera, self._setup.prior.category, self._setup.options)
            except FgreconError as error:
                refused[name] = error
        together = couple_facings([*found.values()], camera, self._setup.prior, self._setup.options, rows=False)
        return dict(zip(found, together, strict=True))

    @single_threaded
    def smooth(self) -> dict[int, list[VehicleEstimate]]:
        """The estimates of all frames that are kept, by all of them; by id, in the order of time."""
        with self._one_call:
            return self._smooth()

    def _smooth(self) -> dict[int, list[VehicleEstimate]]:
        pasts = {name: [past.frame for past in track.past] for name, track in self._tracks.items()}
        for frames in pasts.values():
            frames[0] = replace(frames[0], step=None)
        told = with_neighbours(pasts)
        return {name: self._smoothed(name, track, told[name]) for name, track in self._tracks.items()}

    def boxes_off(self) -> float | None:
        """By how much 2D boxes are larger than their vehicles look, as a fraction; negative where smaller.

        Returns:
            The median over the vehicles (those that were forgotten as well), each by the median over its frames that
            are kept; None where it is as usual, or they are fewer than five.
        """
        with self._one_call:
            return boxes_off([*self._forgotten, *map(_box_excess, self._tracks.values())])

    def window_graph(self, vehicle: int) -> tuple[GraphFactor, ...]:
        """The factors that a vehicle's last frame was solved with, those of the other frames of its window included.

        Args:
            vehicle: Its id, by which the variables are named as well: `X(v=7,t=3)` is the pose of vehicle 7 in its
                frame 3, counted from 0.

        Returns:
            The factors, for drawing; none of a vehicle that is not there, or whose solve failed.
        """
        with self._one_call:
            track = self._tracks.get(vehicle)
            if track is None or track.followed.solved.failed:
                return ()
            adjusted = track.followed.solved.adjusted
            return tuple(
                replace(factor, variables=tuple(name.replace("v=0", f"v={vehicle}", 1) for name in factor.variables))
                for factor in graph_factors(adjusted.graph, adjusted.optimum.state.weights)
            )

    def forget(self, vehicle: int) -> None:
        """Let go of a vehicle, and of its past; one that is not there is none to let go of."""
        with self._one_call:
            if (track := self._tracks.pop(vehicle, None)) is not None:
                self._forgotten.append(_box_excess(track))

    def _estimate(self, name: int, track: VehicleTrack) -> VehicleEstimate:
        """Of the last frame."""
        followed, past = track.followed, track.past[-1]
        last = len(followed.solved.seen) - 1
        return _estimates(name, {last: past}, followed.solved, last + 1)[0]

    def _smoothed(self, name: int, track: VehicleTrack, frames: Sequence[Frame]) -> list[VehicleEstimate]:
        pasts = {past.frame.number: past for past in track.past}
        found = []
        for solved, some, given in smooth(frames, track.followed.shape, track.followed.motion, self._own):
            wanted = {index: replace(pasts[some[index].number], frame=some[index]) for index in given}
            found += _estimates(name, wanted, solved, len(frames))
        return found


def _box_excess(track: VehicleTrack) -> float:
    shape, frames = track.followed.shape[0], [past.frame for past in track.past]
    found = np.array([box_excess(f.problem, f.pose.matrix(), shape, f.problem.camera) for f in frames])
    told = found[np.isfinite(found)]
    return float(np.median(told)) if len(told) else float("nan")


def _estimates(name: int, pasts: Mapping[int, PastFrame], solved: WindowSolve, total: int) -> list[VehicleEstimate]:
    """Of some frames that were solved together, by their places there."""
    frames = [past.frame for past in pasts.values()]
    alone = len(solved.seen) == 1
    facings = [frame.believed.facing(rotation_y(frame.pose.matrix())) for frame in frames]
    adjusted = solved.adjusted if alone else _with_alternatives(solved.adjusted, pasts, facings)
    counted = None if alone else count(adjusted.graph, adjusted.optimum, at_once=pasts)
    told = results(solved.seen, solved.starts, adjusted, {}, solved.extra, only=pasts, counted=counted)
    found = []
    spreads = [None] * len(frames) if alone else velocity_covariances(solved, frames)
    for (index, past), result, facing, spread in zip(pasts.items(), told, facings, spreads, strict=True):
        # The world's velocity is not known where the camera has come to its place in an unknown way.
        moving = not alone and solved.over_world[index] == (past.world_T_camera is not None)
        found.append(_estimate(name, past, result, facing, total, spread if moving else None, moving=moving))
    return found


def _estimate(
    name: int, past: PastFrame, result: Reconstruction, facing: float, total: int, spread: Array | None, *, moving: bool
) -> VehicleEstimate:
    frame, place = past.frame, past.world_T_camera
    pose = frame.pose.matrix()
    if past.known is not None and result.pose_covariance is not None:
        result = replace(result, pose_covariance=past.known.considered(pose, result.pose_covariance))
    velocity: Array | None = None
    turn_rate: float | None = None
    if moving:
        axes = pose[:3, :3] if place is None else place.rotation().matrix() @ pose[:3, :3]
        forward, left, turn_rate = frame.velocity.tolist()
        velocity = axes @ np.array([forward, 0.0, left])
        spread = None if spread is None else axes @ spread @ axes.T
    return VehicleEstimate(
        id=name,
        time=past.time,
        reconstruction=result,
        velocity=velocity,
        turn_rate=turn_rate,
        facing_probability=facing,
        world_T_object=None if place is None else place.matrix() @ result.camera_T_object,
        frames=total,
        velocity_covariance=spread,
    )


def _with_alternatives(
    adjusted: MultiStartResult, pasts: Mapping[int, PastFrame], facings: Sequence[float]
) -> MultiStartResult:
    """With the vehicle turned round as an alternative of frames, as improbable as it is by the track."""
    told, shape = list(adjusted.alternatives), adjusted.optimum.state.shapes[0][0]
    for (index, past), facing in zip(pasts.items(), facings, strict=True):
        told[index] = turned_alternative(past.frame.pose.matrix(), shape, facing) or told[index]
    return replace(adjusted, alternatives=tuple(told))
