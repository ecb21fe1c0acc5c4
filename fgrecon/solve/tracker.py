"""Vehicles over time: keypoints of frame after frame in, poses, shapes and velocities out.

    frame t: keypoints by id, camera ---- pose search ---- facing by all frames ---- graph of a window ---- estimates
                                               |                                           |
                                             ground                   two frames, and some of the seconds before

A vehicle's first frame gives what `fgrecon.reconstruct` gives.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_flag, as_time
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence
from fgrecon.core.history import Deferred
from fgrecon.core.input_warnings import InputWarnings, interval_warning, warn, warn_of
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import GraphFactor, Reconstruction, rotation_y
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.solve.box_check import box_excess, boxes_off
from fgrecon.solve.contradiction import with_contradictions
from fgrecon.solve.depth_scale import with_scales
from fgrecon.solve.exclusive_keypoints import with_exclusive_keypoints
from fgrecon.solve.fitted_class import with_fitted_classes
from fgrecon.solve.frame_vehicles import FrameContext, FrameVehicles, VehicleTrack, class_weights, look_at_vehicles
from fgrecon.solve.graph.records import graph_factors
from fgrecon.solve.ground_filter import CameraFrame, GroundFilter, KnownGround
from fgrecon.solve.image_facing import couple_facings
from fgrecon.solve.inputs import (
    SolveSetup,
    as_camera_pose,
    as_ground,
    as_motion_covariance,
    calibrated,
    check_frames,
    evidence_of,
    observe,
    without_rates_over_ground,
)
from fgrecon.solve.proposals.point_term import with_its_points
from fgrecon.solve.result import marginalise, results, with_facing_over_time, with_gains
from fgrecon.solve.road_plane import ground_by_points
from fgrecon.solve.sensor_filter import SensorFilter
from fgrecon.solve.solve_settings import GROUND_FILTER
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.time.frame import CameraDrift, Frame
from fgrecon.solve.time.smooth import smooth
from fgrecon.solve.time.vehicle_filter import FilterModel
from fgrecon.solve.time.window import MotionFactors, WindowSolve, rate_gains, velocity_covariances
from fgrecon.solve.weakness import too_fast, weakened

_MAPPING = "Give a mapping: an `fgrecon.Observation` by id. Images go to `fgrecon.video.ImageTracker`."


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
        size_prior: SizesLike | None = None,
        options: Options | None = None,
        window: int = 5,
        shared_ground: bool = False,
        past: int | None = 1000,
        motion_factors: MotionFactors | None = None,
    ) -> None:
        """Prepare for vehicles of one category.

        Args:
            prior: Shape prior, or its name, or the path of its file.
            size_prior: Fleet by name (`fgrecon.SIZE_PRIORS`), or a size prior; None takes sizes from the shape prior.
            options: Settings; `joint` must be set.
            window: Frames that are solved together when a new one comes, 2 to 100: that one, the one before it, and
                some of the seconds before.
            shared_ground: Whether the vehicles share one ground that is a variable and changes from frame to frame: it
                is found first, by a step of a solve of all vehicles of the frame together. Where none is given, two
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
        if not isinstance(window, int | np.integer) or not 2 <= window <= GROUND_FILTER.largest_window:
            raise InvalidInputError(
                "window", window, f"Give 2 to {GROUND_FILTER.largest_window} frames, a whole number."
            )
        if past is not None and (not isinstance(past, int | np.integer) or past < 1):
            raise InvalidInputError("past", past, "Give at least 1 frame, a whole number, or None.")
        if motion_factors is not None and not callable(motion_factors):
            raise InvalidInputError("motion_factors", motion_factors, "Give a function that makes factors, or None.")
        self._setup = replace(setup, options=replace(setup.options, keep_history=False))
        kept = None if past is None else int(past)
        self._model = FilterModel(setup.prior.category.motion, int(window), kept, motion_factors)
        self._road = GroundFilter() if as_flag("shared_ground", shared_ground) else None
        self._tracks: dict[int, VehicleTrack] = {}
        self._forgotten: list[float] = []  # how far the boxes of vehicles were off that were forgotten
        self._sensors = SensorFilter()
        self._scans: InputWarnings | None = InputWarnings()  # until it is warned of them
        self._time = self._clock = -np.inf
        self._latest: list[float] = []  # times of the last two frames with vehicles
        self._cameras: list[tuple[Camera, gtsam.Pose3 | None]] = []  # of the last time
        self._drift = CameraDrift()
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
        evidence: Sequence[Evidence] = (),
        estimated: bool = True,
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
            evidence: What other sensors say of the frame's vehicles, such as `fgrecon.Points` of a scan.
            estimated: Whether estimates are made; else there are those of `smooth` alone, and `placed` says where
                vehicles are.

        Returns:
            The estimates by id, by this frame and those before; vehicles without one are in `refused`.

        Raises:
            InvalidInputError: An argument cannot be used; names it, its value and the fix.
        """
        time = as_time(time)
        if not issubclass(kind := type(observations), Mapping):
            raise InvalidInputError("observations", kind.__name__, _MAPPING)
        made = as_flag("estimated", estimated)
        used, plane = calibrated("camera", Camera.of(camera)), as_ground(ground)
        place = None if world_T_camera is None else gtsam.Pose3(as_camera_pose(world_T_camera))
        moved = None if motion_covariance is None else as_motion_covariance(motion_covariance)
        measured = evidence_of(evidence, used, of_all=True)
        check_frames(measured, used, plane, observations.values())
        with self._one_call:
            cameras = self._cameras_at(time, used, place)
            sensed = self._sensors.applied(measured, time)
            given, plane = plane, ground_by_points(sensed, plane, used, self._setup.options.disabled_terms)
            # Noise that grows with time must not vanish: frames of one time are a microsecond apart.
            clock = max(time, self._clock + GROUND_FILTER.shortest_s)
            drift = self._drift.moved(place, moved)
            frame = CameraFrame(clock, used, plane, place, moved, drift, sensed=plane is not given)
            found = self._update(frame, time, observations, sensed, estimated=made)
            if observations:  # others follow nothing, and may be any time apart
                if time > self._time and (line := interval_warning([*self._latest, time])) is not None:
                    warn(line, stacklevel=3)
                self._latest = [*self._latest[-1:], time]
            self._time, self._clock, self._cameras, self._drift = time, clock, cameras, frame.drift
            if self._scans is not None:
                for name, one in found.items():
                    self._scans.add_scanned(str(name), one.reconstruction.diagnostics.own_shares)
                if lines := self._scans.scan:
                    self._scans = None
                    warn(" ".join(lines), stacklevel=3)
            return found

    def _update(
        self,
        frame: CameraFrame,
        time: float,
        observations: Mapping[int, KeypointsLike],
        evidence: Sequence[Evidence],
        *,
        estimated: bool,
    ) -> dict[int, VehicleEstimate]:
        """The estimates of a frame's vehicles; whatever is raised, the tracker is what it was."""
        usable, refused = self._observe(observations, frame, evidence)

        def look(ground: Ground | None) -> FrameVehicles:
            return look_at_vehicles(usable, frame, ground, self._tracks, self._setup, self._model)

        road, known, ground = self._road, None, frame.ground
        if road is None:
            vehicles = look(ground)
        else:
            road, known, vehicles = road.later(frame, look)
            ground = ground if known is None else known.ground
        refused |= vehicles.refused
        looked = {name: (one.frame, one.shape) for name, one in vehicles.updates.items()}
        sensors = self._sensors.later(frame.time, evidence, looked)
        grounded = None if "ground" in self._setup.options.disabled_terms else known
        tracks: dict[int, VehicleTrack] = {}
        for name, update in vehicles.updates.items():
            try:
                vehicle = update.taken(ground, sensors.over(update.frame))
            except FgreconError as error:
                refused[name] = error
                continue
            before = self._tracks.get(name)
            context = FrameContext(time, frame.world_T_camera, grounded, vehicles.either[name])
            contexts = (context,) if before is None else (*before.contexts, context)
            tracks[name] = VehicleTrack(vehicle, frame, contexts[-len(vehicle.past) :], vehicles.classes[name])
        found = {name: self._estimate(name, track) for name, track in tracks.items()} if estimated else {}
        self._tracks, self._road, self._sensors, self.refused = self._tracks | tracks, road, sensors, refused
        return found

    def _cameras_at(
        self, time: float, camera: Camera, place: gtsam.Pose3 | None
    ) -> list[tuple[Camera, gtsam.Pose3 | None]]:
        """The cameras of a frame's time, with their places."""
        if time - self._time >= GROUND_FILTER.shortest_s:
            return [(camera, place)]
        others = all(
            there is not None
            and place is not None
            and not (there.equals(place, 0.0) and np.array_equal(other.matrix, camera.matrix))
            for other, there in self._cameras
        )
        if abs(time - self._time) < GROUND_FILTER.shortest_s and place is not None and others:
            return [*self._cameras, (camera, place)]
        fix = f"Give frames in order, a microsecond apart at least: the last one was at {self._time:.10g} s."
        fix += " Different cameras may have frames at the same time, if all of these have `world_T_camera`."
        raise InvalidInputError("time", time, fix)

    def _observe(
        self, observations: Mapping[int, KeypointsLike], frame: CameraFrame, evidence: Sequence[Evidence]
    ) -> tuple[dict[int, Observation], dict[int, FgreconError]]:
        """The observations as they are solved from, and why others cannot be used."""
        camera, found = frame.camera, dict[int, Observation]()
        refused: dict[int, FgreconError] = {}
        warnings = InputWarnings()
        for name, given in observations.items():
            try:
                found[name], warning = observe(given, camera, self._setup, evidence=evidence, moving=True)
                warnings.add(f"vehicle {name}", warning)
                if frame.world_T_camera is None:
                    found[name] = without_rates_over_ground(found[name])
            except FgreconError as error:
                refused[name] = error
        warn_of(warnings, stacklevel=5)
        exclusive = with_exclusive_keypoints([*found.values()], self._setup.options.keypoints)
        scaled = with_scales(exclusive, camera, self._setup)
        scaled = with_fitted_classes(scaled, camera, self._setup, frame.ground)
        coupled = couple_facings(scaled, camera, self._setup.prior, self._setup.options)
        return dict(zip(found, (with_its_points(one, camera) for one in coupled), strict=True)), refused

    @single_threaded
    def smooth(self, vehicles: Iterable[int] | None = None) -> dict[int, Sequence[VehicleEstimate]]:
        """The estimates of all frames that are kept, by all of them; by id, in the order of time.

        Those of a vehicle are made when they are first looked at, by what was known when this was called.

        Args:
            vehicles: Their ids, of which those that are not there have none; None for all.
        """
        with self._one_call:
            tracks, sensors = dict(self._tracks), self._sensors
        if vehicles is not None:
            tracks = {name: tracks[name] for name in vehicles if name in tracks}
        pasts = {name: [sensors.over(frame) for frame in track.vehicle.past] for name, track in tracks.items()}
        for frames in pasts.values():
            frames[0] = replace(frames[0], step=None)
        smoothed = single_threaded(self._smoothed)
        return {name: Deferred(partial(smoothed, name, track, pasts[name])) for name, track in tracks.items()}

    def placed(self, vehicle: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Where a vehicle is in its last frame, by this and those before; None of one that is not there.

        Args:
            vehicle: Its id.

        Returns:
            Its pose (4, 4) in the camera's frame, and its keypoints (K, 3) in its own.
        """
        with self._one_call:
            track = self._tracks.get(vehicle)
        if track is None:
            return None
        state, prior = track.vehicle.solved.adjusted.optimum.state, track.vehicle.past[-1].problem.model.prior
        return np.asarray(state.poses[-1].matrix()), prior.keypoints(*state.shapes[0])

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
            if track is None or track.vehicle.solved.failed:
                return ()
            adjusted = track.vehicle.solved.adjusted
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
        vehicle = track.vehicle
        last = len(vehicle.solved.parts) - 1
        frame = vehicle.past[-1], track.contexts[-1]
        return _estimates(name, {last: frame}, vehicle.solved, last + 1, class_weights(track))[0]

    def _smoothed(self, name: int, track: VehicleTrack, frames: Sequence[Frame]) -> list[VehicleEstimate]:
        contexts = {frame.number: context for frame, context in zip(track.vehicle.past, track.contexts, strict=True)}
        found = []
        for solved, some, given in smooth(frames, track.vehicle.shape, self._model.motion, self._model.extra):
            selected = {index: (some[index], contexts[some[index].number]) for index in given}
            found += _estimates(name, selected, solved, len(frames), class_weights(track))
        return found


def _box_excess(track: VehicleTrack) -> float:
    shape, frames = track.vehicle.shape[0], track.vehicle.past
    excess = np.array([box_excess(f.problem, f.pose.matrix(), shape, f.problem.camera) for f in frames])
    known = excess[np.isfinite(excess)]
    return float(np.median(known)) if len(known) else float("nan")


def _estimates(
    name: int,
    frames: Mapping[int, tuple[Frame, FrameContext]],
    solved: WindowSolve,
    total: int,
    weights: Mapping[str, float],
) -> list[VehicleEstimate]:
    """Of some frames that were solved together, by their places there, with the log weights of its classes."""
    single = len(solved.parts) == 1
    selected = [frame for frame, _ in frames.values()]
    facings = [frame.belief.facing(rotation_y(frame.pose.matrix())) for frame in selected]
    adjusted, known, by_frame = solved.adjusted, None, None
    spreads: Sequence[Array | None] = [None] * len(selected)
    if not single:
        each = dict(zip(frames, facings, strict=True))
        by_frame = [each.get(index) for index in range(len(solved.parts))]
        known = marginalise(adjusted.graph, adjusted.optimum, at_once=frames)
        spreads = velocity_covariances(solved, selected)
    reconstructions = results(
        solved.parts, solved.starts, adjusted, {}, solved.extra, only=frames, facing=by_frame, marginalised=known
    )
    without = None if solved.without is None else solved.without.ended
    reconstructions = with_contradictions(reconstructions, adjusted.ended, without, [*frames])
    if not single:
        pairs = zip(selected, reconstructions, strict=True)
        reconstructions = [with_facing_over_time(result, frame.given) for frame, result in pairs]
        gains = rate_gains(solved, selected, spreads)
        reconstructions = [with_gains(result, gained) for result, gained in zip(reconstructions, gains, strict=True)]
    found = []
    for (index, (frame, context)), result, facing, spread in zip(
        frames.items(), reconstructions, facings, spreads, strict=True
    ):
        # The world's velocity is not known where the camera has come to its place in an unknown way.
        moving = not single and solved.over_world[index] == (context.world_T_camera is not None)
        unsure = _on_known_ground(result, context.known)
        if context.either is not None:
            unsure = context.either.added_to(unsure, weights)
        found.append(_estimate(name, frame, context, unsure, facing, total, (spread,) if moving else None))
    return found


def _on_known_ground(result: Reconstruction, known: KnownGround | None) -> Reconstruction:
    """A result that is no surer than the ground allows."""
    covariance = result.uncertainty.pose_covariance
    if known is None or covariance is None:
        return result
    covariance = known.considered(result.camera_T_object, covariance)
    return replace(result, uncertainty=replace(result.uncertainty, pose_covariance=covariance))


def _estimate(
    name: int,
    frame: Frame,
    context: FrameContext,
    result: Reconstruction,
    facing: float,
    total: int,
    moving: tuple[Array | None] | None,
) -> VehicleEstimate:
    """Of one frame; `moving` is the velocity's covariance, which may be unknown, or None where it has no velocity."""
    place, pose = context.world_T_camera, frame.pose.matrix()
    velocity: Array | None = None
    turn_rate: float | None = None
    spread: Array | None = None
    if moving is not None:
        axes = pose[:3, :3] if place is None else place.rotation().matrix() @ pose[:3, :3]
        forward, left, turn_rate = frame.velocity.tolist()
        velocity = axes @ np.array([forward, 0.0, left])
        spread = None if moving[0] is None else axes @ moving[0] @ axes.T
        result = weakened(result, too_fast(float(np.linalg.norm(velocity))))
    return VehicleEstimate(
        id=name,
        time=context.time,
        reconstruction=result,
        velocity=velocity,
        turn_rate=turn_rate,
        facing_probability=facing,
        world_T_object=None if place is None else place.matrix() @ result.camera_T_object,
        frames=total,
        velocity_covariance=spread,
    )
