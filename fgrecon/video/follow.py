"""Tracking of a video: ids, the camera's pose in the world, and a tracker's estimates, frame by frame.

record of a frame ---- ids (given, or by association) ---- tracker ---- estimates of this frame
       |                          ^                           |
       +---- camera's motion -----+----- motion in space -----+
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import GraphFactor
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.video.association import Association, Candidate, ground_contact
from fgrecon.video.camera_path import CameraPath
from fgrecon.video.records import FrameRecord, Sighting

DEFAULT_KIND = "Car"
"""What a vehicle is where nothing says."""

_VELOCITY_GAIN = 0.5  # share of a frame in the velocity that the association is given


class VehicleTracker(Protocol):
    """Estimates many vehicles over time, by their ids; `fgrecon.Tracker` is one.

    Attributes:
        refused: Why vehicles of the last frame have no estimate, by id.
    """

    refused: Mapping[int, FgreconError]

    def update(
        self,
        time: float,
        observations: Mapping[int, Observation],
        *,
        camera: Camera,
        world_T_camera: Array | None = None,
        ground: Ground | None = None,
        motion_covariance: Array | None = None,
        evidence: Sequence[Evidence] = (),
        estimated: bool = True,
    ) -> Mapping[int, VehicleEstimate]:
        """Take a frame; the estimates of the vehicles that it shows, by id. The arguments are `fgrecon.Tracker`'s.

        Args:
            estimated: Whether there shall be any before `smooth`: `placed` says where a vehicle is all the same.
        """

    def placed(self, vehicle: int) -> tuple[Array, Array] | None:
        """Pose (4, 4) of a vehicle in its last frame, and its keypoints (K, 3) in its own; None where it is unknown."""

    def smooth(self) -> Mapping[int, Sequence[VehicleEstimate]]:
        """The estimates of all frames by all of them, by id, in the order of time."""


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """One frame with its vehicles.

    Attributes:
        number: Of the frame, within its source.
        time: Seconds.
        name: Of the frame.
        problem: Why it could not be read, or None.
        world_T_camera: (4, 4) pose of the camera, or None where it is not known.
        boxes: (4,) 2D box by id.
        scores: Of the detection by id.
        kinds: What each is said to be, by id; `Car` where nothing says.
        observations: Keypoints by id.
        estimates: By id; a vehicle that could not be solved has none.
        refused: Why not, by id.
        window: Factors of a window that was solved when the frame came, for drawing; empty where nobody asked for it.
    """

    number: int
    time: float
    name: str
    problem: str | None
    world_T_camera: Array | None = None
    boxes: Mapping[int, Array] = field(default_factory=dict)
    scores: Mapping[int, float] = field(default_factory=dict)
    kinds: Mapping[int, str] = field(default_factory=dict)
    observations: Mapping[int, Observation] = field(default_factory=dict)
    estimates: Mapping[int, VehicleEstimate] = field(default_factory=dict)
    refused: Mapping[int, str] = field(default_factory=dict)
    window: tuple[GraphFactor, ...] = ()


class Follower:
    """Follows the vehicles of one video: called with the records of its frames, in order."""

    def __init__(
        self,
        tracker: VehicleTracker,
        association: Association,
        camera: Camera,
        *,
        ground: Ground | None = None,
        path: CameraPath | None = None,
        window_graph: Callable[[int], tuple[GraphFactor, ...]] | None = None,
        sense: Callable[[FrameRecord], Sequence[Evidence]] | None = None,
        estimated: bool = True,
    ) -> None:
        """Take what does the work.

        Args:
            tracker: Estimates the vehicles.
            association: Gives ids to those that come without.
            camera: The camera.
            ground: The ground in its frame, or None.
            path: Where the camera is, by poses or by the motions in the records; None where that is not known.
            window_graph: Gives the factors of a vehicle's window, as `fgrecon.Tracker.window_graph` does. Each frame
                has those of one: of the longest windows that of the nearest vehicle. None: no frame has them.
            sense: What other sensors say of a frame's vehicles; None where there are none.
            estimated: Whether frames have estimates as they come; else the tracker makes none before it smooths.
        """
        self._window_graph, self._sense, self._estimated = window_graph, sense, estimated
        self.tracker, self.association, self.camera, self.ground = tracker, association, camera, ground
        self.path = CameraPath() if path is None else path
        self._time = -np.inf
        self._kinds: dict[int, Counter[str]] = {}  # what each vehicle is said to be, frame by frame
        self._last: dict[int, tuple[float, Array, Array]] = {}  # time, place and velocity of each vehicle

    def __call__(self, record: FrameRecord) -> TrackedFrame:
        """The frame's vehicles; a frame that is not later than the one before is a gap."""
        if record.time <= self._time:
            self.path.skip(record)
            problem = f"{record.name}: its time, {record.time:g} s, is not later than that of the frame before"
            return TrackedFrame(record.number, record.time, record.name, record.problem or problem)
        self._time = record.time
        world_T_camera, previous_T_current, motion_covariance = self.path.move(record)
        known = [s for s in record.sightings if s.identity is not None]
        unknown = [s for s in record.sightings if s.identity is None]
        ids = self.association(record.time, [self._candidate(s) for s in unknown], previous_T_current)
        named = {s.identity: s for s in known} | dict(zip(ids, unknown, strict=True))
        sightings = {identity: s for identity, s in named.items() if identity is not None}
        observations = {
            i: observation for i, s in sightings.items() if (observation := s.classed_observation) is not None
        }
        try:
            estimates = self.tracker.update(
                record.time,
                observations,
                camera=self.camera,
                world_T_camera=world_T_camera,
                ground=self.ground,
                motion_covariance=motion_covariance,
                evidence=() if self._sense is None else self._sense(record),
                estimated=self._estimated,
            )
        except InvalidInputError as error:
            if not error.field.startswith("evidence["):
                raise
            raise InvalidInputError(f"{record.name}: {error.field}", error.value, error.fix) from error
        for identity in ids:
            if identity in observations and identity not in self.tracker.refused:
                placed = self.tracker.placed(identity)
                if placed is not None:
                    self._set_motion(identity, record.time, *placed)
        return TrackedFrame(
            number=record.number,
            time=record.time,
            name=record.name,
            problem=record.problem,
            world_T_camera=world_T_camera,
            boxes={i: s.box for i, s in sightings.items()},
            scores={i: s.score for i, s in sightings.items()},
            kinds={i: self._kind(i, s) for i, s in sightings.items()},
            observations=observations,
            estimates={identity: self.over_world(one) for identity, one in estimates.items()},
            refused={identity: str(error) for identity, error in self.tracker.refused.items()},
            window=self._window(estimates),
        )

    def over_world(self, estimate: VehicleEstimate) -> VehicleEstimate:
        """An estimate, without its velocity if that is relative to the camera and those of other frames are not."""
        if estimate.velocity is None or estimate.world_T_object is not None or not self.path.known:
            return estimate
        return replace(estimate, velocity=None, turn_rate=None, velocity_covariance=None)

    def _window(self, estimates: Mapping[int, VehicleEstimate]) -> tuple[GraphFactor, ...]:
        if self._window_graph is None or not estimates:
            return ()
        longest = max(estimate.frames for estimate in estimates.values())
        places = {i: e.reconstruction.location for i, e in estimates.items() if e.frames == longest}
        return self._window_graph(min(places, key=lambda i: float(np.linalg.norm(places[i]))))

    def _candidate(self, one: Sighting) -> Candidate:
        directions = None if one.observation is None else one.observation.azimuth
        stands = None if self.ground is None else ground_contact(one.box, self.camera, self.ground)
        if stands is None:
            return Candidate(one.box, one.score, directions=directions)
        return Candidate(one.box, one.score, *stands, directions)

    def _kind(self, identity: int, sighting: Sighting) -> str:
        """What most of a vehicle's frames so far say that it is, this one counted in."""
        votes = self._kinds.setdefault(identity, Counter())
        if sighting.kind is not None:
            votes[sighting.kind] += 1
        return votes.most_common(1)[0][0] if votes else DEFAULT_KIND

    def _set_motion(self, identity: int, time: float, camera_T_object: Array, points: Array) -> None:
        """Give the association a vehicle's pose (4, 4) and its motion relative to the camera; points are (K, 3)."""
        before, place = self._last.get(identity), camera_T_object[:3, 3]
        velocity = np.zeros(3)
        if before is not None and time > before[0]:
            now = (place - before[1]) / (time - before[0])
            velocity = (1.0 - _VELOCITY_GAIN) * before[2] + _VELOCITY_GAIN * now
            self.association.set_motion(identity, transform(camera_T_object, points), velocity, self.camera)
        self._last[identity] = time, place, velocity
