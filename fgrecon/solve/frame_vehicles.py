"""The vehicles of one frame: each looked at by itself, on what is known of the ground; then which way they face."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.marginals import Marginal
from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.solve.facing import estimate_pose_facing
from fgrecon.solve.ground_evidence import GroundEvidence, ground_evidence
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.road import KnownGround
from fgrecon.solve.time.camera_way import CameraWay, Milestone
from fgrecon.solve.time.neighbours import neighbours_say
from fgrecon.solve.time.vehicle import Followed
from fgrecon.solve.time.window import Frame, FrameStep

__all__ = ["FrameVehicles", "PastFrame", "VehicleTrack"]

Array = NDArray[np.float64]

_FARTHEST = 1e6  # metres: a camera that is further away than that has come there in an unknown way


@dataclass(frozen=True)
class PastFrame:
    """A frame of a vehicle: what was seen, the time that was told, from where, and the ground that it was solved on."""

    frame: Frame
    time: float
    world_T_camera: gtsam.Pose3 | None
    known: KnownGround | None


@dataclass
class VehicleTrack:
    """A vehicle and its past."""

    followed: Followed
    time: float = -np.inf
    world_T_camera: gtsam.Pose3 | None = None
    milestone: Milestone = field(default_factory=Milestone)
    past: list[PastFrame] = field(default_factory=list)


@dataclass
class FrameVehicles:
    """The vehicles of a frame.

    Attributes:
        time: Of the frame, seconds, by a clock on which no two frames are of one time.
        world_T_camera: Pose of the camera, or None.
        way: How the camera came there.
        observations: Of each vehicle, by id.
        problem: What one shows on a ground.
        track: The track that an id has, or a new one.
        refused: Why vehicles could not be looked at, by id.
        looked: Each vehicle's track and the frame, by id, once they are looked at.
    """

    time: float
    world_T_camera: gtsam.Pose3 | None
    way: CameraWay
    observations: Mapping[int, Observation]
    problem: Callable[[Observation, Ground | None], Problem]
    track: Callable[[int], VehicleTrack]
    refused: dict[int, FgreconError]
    looked: dict[int, tuple[VehicleTrack, Frame]] = field(default_factory=dict)

    def look(self, ground: Ground | None) -> None:
        """Look at them on a ground."""
        for name, observation in self.observations.items():
            try:
                problem, track = self.problem(observation, ground), self.track(name)
                self.looked[name] = track, track.followed.look(problem, self.time, self._step(track))
            except FgreconError as error:
                self.refused[name] = error
        self._settle()

    def poses(self) -> list[Array]:
        """Pose (4, 4) of each that was looked at."""
        return [frame.pose.matrix() for _, frame in self.looked.values()]

    def say(self, known: Marginal, plane: Ground) -> GroundEvidence | None:
        """What those that were looked at say of the ground; see `ground_evidence`."""
        frames = [frame for _, frame in self.looked.values()]
        return ground_evidence(frames, [track.followed.shape for track, _ in self.looked.values()], plane, known)

    def _settle(self) -> None:
        """Decide which way they face, by what each knows of itself and by one another."""
        frames = [frame for _, frame in self.looked.values()]
        says = neighbours_say(frames, [frame.belief for frame in frames])
        for name, said in zip([*self.looked], says, strict=True):
            track, frame = self.looked[name]
            try:
                track.followed.settle(frame, said)
                if frame.step is None and (other := _faced(frame)) is not None:
                    track.followed.again(frame, *other)
            except FgreconError as error:
                self.refused[name] = error
                del self.looked[name]

    def _step(self, track: VehicleTrack) -> FrameStep | None:
        """From the last frame of a track to this one."""
        if not track.followed.frames:
            return None
        before, place = track.world_T_camera, self.world_T_camera
        camera = None if before is None or place is None else before.between(place)
        if camera is not None and not np.abs(camera.translation()).max() < _FARTHEST:
            camera = None
        unsure = None if camera is None or place is None else self.way.since(track.milestone, place)
        if unsure is None:
            return FrameStep(self.time - track.time, None, np.zeros((6, 6)))
        return FrameStep(self.time - track.time, camera, unsure)


def _faced(frame: Frame) -> tuple[Problem, PoseEstimate] | None:
    """A vehicle's first frame the other way round, where its neighbours say so; None where they do not."""
    believed = frame.believed
    if believed.facing(rotation_y(frame.pose.matrix())) >= 0.5:
        return None
    heading, place = believed.heading, np.asarray(frame.pose.translation())
    other = estimate_pose_facing(frame.problem, heading, believed.facing(heading), place)
    return other if other and believed.facing(rotation_y(other[1].camera_T_object)) > 0.5 else None
