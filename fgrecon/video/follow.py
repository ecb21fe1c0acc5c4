"""From what each frame shows to tracked vehicles: ids, the camera's place in the world, and a tracker's estimates.

record of a frame ---- ids (given, or by association) ---- tracker ---- estimates of this frame
       |                          ^                           |
       +---- camera's motion -----+------- told back ---------+
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import GraphFactor
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.poses import CameraPoses
from fgrecon.video.association import Association, Candidate, stands_at
from fgrecon.video.egomotion import CameraMotion
from fgrecon.video.records import FrameRecord, Sighting

__all__ = ["DEFAULT_KIND", "Follower", "TrackedFrame", "VehicleTracker"]

Array = NDArray[np.float64]

DEFAULT_KIND = "Car"
"""What a vehicle is where nothing says."""

_AS_BEFORE, _ANYHOW = (0.2, 5.0), (0.5, 20.0)
"""Standard deviations of a motion that was not found, radians and metres in a second: of a camera that goes on as it
did, and of one of which nothing is known."""
_MOMENT = 0.1  # seconds; of a shorter motion is not less unknown
_GOES_ON = 1.0  # seconds for which a camera is taken to go on as it did


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
    ) -> Mapping[int, VehicleEstimate]:
        """Take a frame; the estimates of the vehicles that it shows, by id. The arguments are `fgrecon.Tracker`'s."""

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
        poses: CameraPoses | None = None,
        moving: bool = False,
        window_graph: Callable[[int], tuple[GraphFactor, ...]] | None = None,
    ) -> None:
        """Take what does the work.

        Args:
            tracker: Estimates the vehicles.
            association: Gives ids to those that come without.
            camera: The camera.
            ground: The ground in its frame, or None.
            poses: The camera's poses, or None.
            moving: Whether the motions in the records tell them instead. Where they are missing the camera goes on as
                before for a second; from then on it has no place, until the next one.
            window_graph: Gives the factors of a vehicle's window, as `fgrecon.Tracker.window_graph` does. Each frame
                has those of one: of the longest windows that of the nearest vehicle. None: no frame has them.
        """
        self._window_graph = window_graph
        self.tracker, self.association, self.camera, self.ground = tracker, association, camera, ground
        self._world = _World(poses, moving=moving)
        self._time = -np.inf
        self._kinds = _Kinds()
        self._seen: dict[int, tuple[float, Array, Array]] = {}  # time, place and velocity of each vehicle

    def __call__(self, record: FrameRecord) -> TrackedFrame:
        """The frame's vehicles; a frame that is not later than the one before is a gap."""
        if record.time <= self._time:
            self._world.pass_by(record)
            problem = f"{record.name}: its time, {record.time:g} s, is not later than that of the frame before"
            return TrackedFrame(record.number, record.time, record.name, record.problem or problem)
        self._time = record.time
        world_T_camera, previous_T_current, motion_covariance = self._world.move(record)
        known = [s for s in record.sightings if s.identity is not None]
        unknown = [s for s in record.sightings if s.identity is None]
        found = self.association(record.time, [self._candidate(s) for s in unknown], previous_T_current)
        named = {s.identity: s for s in known} | dict(zip(found, unknown, strict=True))
        sightings = {identity: s for identity, s in named.items() if identity is not None}
        observations = {i: s.observation for i, s in sightings.items() if s.observation is not None}
        estimates = self.tracker.update(
            record.time,
            observations,
            camera=self.camera,
            world_T_camera=world_T_camera,
            ground=self.ground,
            motion_covariance=motion_covariance,
        )
        for identity in found:
            if identity is not None and identity in estimates:
                self._tell(identity, estimates[identity])
        return TrackedFrame(
            number=record.number,
            time=record.time,
            name=record.name,
            problem=record.problem,
            world_T_camera=world_T_camera,
            boxes={i: s.box for i, s in sightings.items()},
            scores={i: s.score for i, s in sightings.items()},
            kinds=self._kinds.of(sightings),
            observations=observations,
            estimates=dict(estimates),
            refused={identity: str(error) for identity, error in self.tracker.refused.items()},
            window=self._window(estimates),
        )

    def _window(self, estimates: Mapping[int, VehicleEstimate]) -> tuple[GraphFactor, ...]:
        if self._window_graph is None or not estimates:
            return ()
        longest = max(estimate.frames for estimate in estimates.values())
        places = {i: e.reconstruction.location for i, e in estimates.items() if e.frames == longest}
        return self._window_graph(min(places, key=lambda i: float(np.linalg.norm(places[i]))))

    def _candidate(self, one: Sighting) -> Candidate:
        directions = None if one.observation is None else one.observation.azimuth
        stands = None if self.ground is None else stands_at(one.box, self.camera, self.ground)
        if stands is None:
            return Candidate(one.box, one.score, directions=directions)
        return Candidate(one.box, one.score, *stands, directions)

    def _tell(self, identity: int, estimate: VehicleEstimate) -> None:
        """Let the association know where a vehicle is and how it moves, seen from the camera."""
        result = estimate.reconstruction
        before = self._seen.get(identity)
        velocity = np.zeros(3)
        if before is not None and estimate.time > before[0]:
            velocity = 0.5 * before[2] + 0.5 * (result.location - before[1]) / (estimate.time - before[0])
            self.association.tell(identity, transform(result.camera_T_object, result.wireframe), velocity, self.camera)
        self._seen[identity] = estimate.time, result.location, velocity


class _Kinds:
    """What each vehicle is said to be, by most of its frames so far."""

    def __init__(self) -> None:
        self._told: dict[int, Counter[str]] = {}

    def of(self, sightings: Mapping[int, Sighting]) -> dict[int, str]:
        """By id, those of a frame counted in."""
        for identity, sighting in sightings.items():
            if sighting.kind is not None:
                self._told.setdefault(identity, Counter())[sighting.kind] += 1
        return {i: self._told[i].most_common(1)[0][0] if i in self._told else DEFAULT_KIND for i in sightings}


class _World:
    """Where the camera is, frame by frame: by given poses, or by the motions in the records."""

    def __init__(self, poses: CameraPoses | None, *, moving: bool) -> None:
        self._poses, self._moving = poses, moving
        self._pose: Array | None = None
        self._step: Array | None = None  # the last motion that was found, and how long it took
        self._passed = 0.0
        self._time: float | None = None
        self._passed_by: CameraMotion | None = None  # the motion up to frames that were left out
        self._missed = self._lost = 0.0  # seconds without a motion: for which the camera went on, and had no place

    def pass_by(self, record: FrameRecord) -> None:
        """Leave a frame out; the next motion begins there all the same."""
        if not self._moving or record.problem is not None or self._pose is None:
            return
        if record.motion is None:
            self._passed_by, self._lost = None, self._lost + _MOMENT
        else:
            self._passed_by = self._since(record.motion)

    def _since(self, motion: CameraMotion) -> CameraMotion:
        """A motion, with that up to the frames that were left out before it."""
        return motion if self._passed_by is None else self._passed_by.then(motion)

    def move(self, record: FrameRecord) -> tuple[Array | None, Array | None, Array | None]:
        """The camera's place, and how it came there.

        Returns:
            (4, 4) world_T_camera; (4, 4) previous_T_current since the last frame that has a place; and the covariance
            (6, 6) of that, as `CameraMotion` has it, where it was estimated. None where not known.
        """
        before = self._pose
        if self._poses is not None:
            here = self._poses.at(record.number, record.time)
            if here is None:
                return None, None, None
            self._pose = here
            return here, None if before is None else np.asarray(np.linalg.inv(before) @ here), None
        if not self._moving or record.problem is not None:  # the next motion covers this frame as well
            return None, None, None
        passed = 0.0 if self._time is None else record.time - self._time
        self._time = record.time
        if before is None:
            self._pose = np.eye(4)
            return self._pose, None, None
        found = None if record.motion is None else self._since(record.motion)
        self._passed_by = None
        if found is not None:
            step, covariance = found.previous_T_current, found.covariance + _isotropic(_ANYHOW, self._lost)
            self._step, self._passed, self._missed, self._lost = step, passed, 0.0, 0.0
        elif self._step is not None and self._missed + passed <= _GOES_ON:
            step = _scaled(self._step, passed / self._passed)
            covariance = _isotropic(_AS_BEFORE, max(passed, _MOMENT))
            self._missed += passed
        else:
            self._step, self._lost = None, self._lost + passed
            return None, None, None
        self._pose = before @ step
        return self._pose, step, covariance


def _isotropic(sigmas: tuple[float, float], seconds: float) -> Array:
    """(6, 6) covariance of a motion by what is unknown of it in a second: radians, metres."""
    return np.diag(np.repeat(np.square(sigmas), 3)) * seconds**2


def _scaled(motion: Array, share: float) -> Array:
    """A motion that goes on for a share of its time."""
    from scipy.spatial.transform import Rotation

    scaled = np.eye(4)
    scaled[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(motion[:3, :3]).as_rotvec()).as_matrix()
    scaled[:3, 3] = share * motion[:3, 3]
    return scaled
