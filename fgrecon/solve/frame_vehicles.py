"""Vehicles of one frame: each solved by itself, on what is known of the ground; then their headings together.

Of the ground they tell what a vehicle of each class that they may be of does in their place, as far as it is probable.
A van that is taken for a car comes out too near and too high, and would draw the ground along for all.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors.marginals import Marginal
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.solve.claimed_points import TakenPlace, is_scanned, without_claimed
from fgrecon.solve.class_filter import ClassBelief, with_model
from fgrecon.solve.either_class import EitherClass, either_class, mean_weights
from fgrecon.solve.fitted_class import FittedClass
from fgrecon.solve.ground_filter import CameraFrame, KnownGround
from fgrecon.solve.image_facing import estimate_pose_facing
from fgrecon.solve.image_ground import GroundEvidence, ground_evidence
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.solve_settings import GROUND_FILTER
from fgrecon.solve.time.frame import Frame, FrameStep, seconds_from
from fgrecon.solve.time.time_settings import SETTINGS as TIME
from fgrecon.solve.time.vehicle_filter import FilterModel, VehicleFilter, VehicleUpdate, first_observed
from fgrecon.solve.vehicle.model import in_traffic


@dataclass(frozen=True)
class FrameContext:
    """A vehicle's frame: its time as it was given, from where it was taken, and the ground that it was solved on."""

    time: float
    world_T_camera: gtsam.Pose3 | None
    known: KnownGround | None
    either: EitherClass | None = None  # what another class changes; None where its class is not open


@dataclass(frozen=True)
class VehicleTrack:
    """A vehicle and where its frames were taken."""

    vehicle: VehicleFilter
    last: CameraFrame  # the frame of a camera in which it was observed last
    contexts: tuple[FrameContext, ...]  # of each frame of its past
    classes: ClassBelief | None = None  # of which class it is, by its frames; None where none says

    def recent_either_class(self, time: float) -> EitherClass | None:
        """What another class changes by a frame so shortly before that another one (seconds) shows no more."""
        last, begun = self.contexts[-1].either, time
        for context in reversed(self.contexts):
            if context.either is not last:
                break
            begun = context.time
        return last if seconds_from(begun, time) < TIME.class_correlation_s else None


@dataclass(frozen=True)
class FrameVehicles:
    """The vehicles of a frame, looked at but not taken yet."""

    updates: Mapping[int, VehicleUpdate]  # by id
    refused: Mapping[int, FgreconError]  # why others could not be looked at, by id
    classes: Mapping[int, ClassBelief | None]  # of which class each is, by id; None where nothing says
    either: Mapping[int, EitherClass | None]  # what another class changes in each; None where that is not open
    lower: Mapping[int, tuple[float, float]]  # than they are taken to stand, by id, as `EitherClass.lower`

    def poses(self) -> list[Array]:
        """Pose (4, 4) of each that was looked at."""
        return [update.frame.pose.matrix() for update in self.updates.values()]

    def ground_evidence(self, known: Marginal, plane: Ground) -> GroundEvidence | None:
        """What those that were looked at say of the ground, of whichever class they are; see `ground_evidence`."""
        updates = self.updates.values()
        lower = {i: self.lower[name] for i, name in enumerate(self.updates) if name in self.lower}
        return ground_evidence([one.frame for one in updates], [one.shape for one in updates], plane, known, lower)


def look_at_vehicles(
    observations: Mapping[int, Observation],
    frame: CameraFrame,
    ground: Ground | None,
    tracks: Mapping[int, VehicleTrack],
    setup: SolveSetup,
    model: FilterModel,
) -> FrameVehicles:
    """Look at the vehicles of a frame, and decide which way they face, by what each knows of itself and by one another.

    Args:
        observations: Of each vehicle, by id.
        ground: The ground that they are looked at on, or None.
        tracks: Those that were observed before, by id.
        setup: What holds for all of them.
        model: How they are followed.
    """
    updates: dict[int, VehicleUpdate] = {}
    refused: dict[int, FgreconError] = {}
    classes: dict[int, ClassBelief | None] = {}
    for name, observation in observations.items():
        try:
            vehicle, classes[name] = _as_class(observation, tracks.get(name), frame, setup)
            model_of = (
                setup.model_of([observation], [frame.camera]) if vehicle is None else vehicle.past[-1].problem.model
            )
            problem = Problem.of(observation, frame.camera, model_of, ground, setup.options)
            updates[name] = _looked_at(problem, vehicle, tracks.get(name), frame, model)
        except FgreconError as error:
            refused[name] = error
    places = {name: _place(one) for name, one in updates.items() if is_scanned(observations[name])}
    for name, observation in without_claimed(observations, places).items():
        with suppress(FgreconError):  # it stays where it was
            before = updates[name]
            problem = before.frame.given.showing(observation)
            updates[name] = _looked_at(problem, before.vehicle, tracks.get(name), frame, model)
    for name, update in [*updates.items()]:
        try:
            settled = update.settled()
            if settled.vehicle is None and (other := _facing_otherwise(settled.frame)) is not None:
                settled = settled.restarted(*other)
            updates[name] = settled
        except FgreconError as error:
            refused[name] = error
            del updates[name]
    either = {
        name: _either_class(update, tracks.get(name), classes[name], frame, setup) for name, update in updates.items()
    }
    lower = {name: _lower(update, tracks.get(name), either[name], frame.ground) for name, update in updates.items()}
    return FrameVehicles(updates, refused, classes, either, {name: one for name, one in lower.items() if one})


def _looked_at(
    problem: Problem, vehicle: VehicleFilter | None, track: VehicleTrack | None, frame: CameraFrame, model: FilterModel
) -> VehicleUpdate:
    """A vehicle in a frame by itself; `vehicle` is what it was before, None where it was not observed."""
    if vehicle is None or track is None:
        return first_observed(model, problem, frame.time)
    return vehicle.observed(problem, frame.time, _step(track.last, frame))


def _place(update: VehicleUpdate) -> TakenPlace:
    """Where a vehicle is by what it knows of itself."""
    frame = update.frame
    if update.vehicle is None or frame.step is None:
        return TakenPlace.of(update.solved.adjusted)
    return TakenPlace.expected(frame.problem, frame.pose.matrix(), update.shape[0], update.vehicle.foreseen(frame.step))


def _lower(
    update: VehicleUpdate, track: VehicleTrack | None, either: EitherClass | None, ground: Ground | None
) -> tuple[float, float] | None:
    """By how much lower than it is taken a vehicle may stand; None where its class is not open.

    And where no ground is given: sizes alone say then how high the camera is.
    """
    if either is None or ground is None:
        return None
    prior, place = update.frame.problem.model.prior, np.asarray(update.frame.pose.translation())
    size = prior.category.box_size(prior.keypoints(*update.shape))
    return either.lower(place, size, ground.normal, class_weights(track, either))


def class_weights(track: VehicleTrack | None, *more: EitherClass | None) -> dict[str, float]:
    """Log weights of the classes of a vehicle, by its frames and more."""
    known = () if track is None else track.contexts
    return mean_weights([*(context.either for context in known), *more])


def _either_class(
    update: VehicleUpdate, track: VehicleTrack | None, belief: ClassBelief | None, frame: CameraFrame, setup: SolveSetup
) -> EitherClass | None:
    """What another class changes in a vehicle's frame, on the ground as it is given.

    The ground that vehicles share follows what they are taken for.
    """
    if track is not None and (recent := track.recent_either_class(frame.time)) is not None:
        return recent
    here, ground = update.frame, frame.ground
    alone = update.solved.adjusted.optimum if track is None and here.problem.ground is ground else None
    classes: Mapping[str, float] | None = setup.classes_of([here.problem.observation])
    if classes is None and belief is not None:
        classes = belief.probability
    problem = here.problem if here.problem.ground is ground else here.problem.on(ground)
    return either_class(problem, here.pose.matrix(), update.shape[0], setup, classes, alone)


def _as_class(
    observation: Observation, track: VehicleTrack | None, frame: CameraFrame, setup: SolveSetup
) -> tuple[VehicleFilter | None, ClassBelief | None]:
    """A vehicle, with its frames made for the class that this one and those before say, and what they say.

    Once points say how far it is, its size is as free as the traffic's, whatever its class.
    """
    classes = setup.classes_of([observation])
    if track is None:
        return None, None if classes is None else ClassBelief.first(classes)
    vehicle, belief = track.vehicle, _belief(classes, track, observation, frame)
    before = model = vehicle.past[-1].problem.model
    if belief is not None and belief.outdated:
        belief = replace(belief, modelled=belief.probability)
        model = setup.model_for(belief.probability)
    if model is not before or observation.evidence:
        known = ((one.problem.observation, one.problem.camera) for one in vehicle.frames)
        measured = any(setup.is_measured(*one) for one in ((observation, frame.camera), *known))
        model = in_traffic(model) if measured else model
    return vehicle if model is before else with_model(vehicle, model), belief


def _belief(
    classes: Mapping[str, float] | None, track: VehicleTrack, observation: Observation, frame: CameraFrame
) -> ClassBelief | None:
    """Of which class a tracked vehicle is by one more frame, which may say nothing."""
    if classes is None:
        return track.classes
    if track.classes is None:
        return replace(ClassBelief.first(classes), modelled={})
    place = observation.place
    height = 0.0 if place is None else float(place[3] - place[1])
    odds = next((one.odds for one in observation.evidence if isinstance(one, FittedClass)), {})
    return track.classes.updated(classes, frame.time - track.last.time, height, odds)


def _step(before: CameraFrame, now: CameraFrame) -> FrameStep:
    """From a vehicle's last frame to this one."""
    camera, place, seconds = now.motion_from(before), now.world_T_camera, now.time - before.time
    if camera is None or place is None or not np.abs(camera.translation()).max() < GROUND_FILTER.farthest_camera_m:
        return FrameStep(seconds, None, np.zeros((6, 6)))
    covariance = now.drift.since(before.drift, place)
    return FrameStep(seconds, None, np.zeros((6, 6))) if covariance is None else FrameStep(seconds, camera, covariance)


def _facing_otherwise(frame: Frame) -> tuple[Problem, PoseEstimate] | None:
    """A vehicle's first frame the other way round, where its directions say so; None where they do not."""
    believed = frame.belief
    if believed.facing(rotation_y(frame.pose.matrix())) >= 0.5:
        return None
    heading, place = believed.heading, np.asarray(frame.pose.translation())
    other = estimate_pose_facing(frame.problem, heading, believed.facing(heading), place)
    return other if other and believed.facing(rotation_y(other[1].camera_T_object)) > 0.5 else None
