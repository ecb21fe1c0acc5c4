"""A vehicle in one image, and in one frame of a video, and the camera on its way, as immutable values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.evidence import Evidence
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.heading_filter import Belief, TrackHeading
from fgrecon.solve.time.time_settings import SETTINGS


def seconds_from(first: float, second: float) -> float:
    """Time from a frame to a later one, seconds, to compare with others: frames of a steady clock are as far apart."""
    return round(second - first, 4)  # a time since 1970 is known to 2e-7 s only


def image_height(observation: Observation) -> float:
    """How high a vehicle is in its image, pixels."""
    if observation.box is not None:
        return float(observation.box[3] - observation.box[1])
    return float(np.ptp(observation.keypoints[observation.measured, 1]))


@dataclass(frozen=True)
class FrameStep:
    """From a frame to the next."""

    seconds: float  # time
    camera: gtsam.Pose3 | None  # camera_first_T_camera_second; None where it is unknown
    covariance: Array  # (6, 6) of the camera's motion, rotation and translation in the second camera's frame

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
        covariance = by_later @ self.covariance @ by_later.T + later.covariance
        return FrameStep(seconds, self.camera.compose(later.camera), covariance)

    @property
    def simultaneous(self) -> bool:
        """Whether both frames are of one moment, by two cameras."""
        return self.seconds < SETTINGS.simultaneous_s

    @property
    def turn(self) -> float:
        """By how much `rotation_y` of a thing at rest changes, radians."""
        if self.camera is None:
            return 0.0
        axis = self.camera.rotation().matrix().T[:, 0]  # the first camera's x, in the second
        return float(np.arctan2(-axis[2], axis[0]))


@dataclass(frozen=True, kw_only=True)
class PosedImage:
    """A vehicle in an image, at one of the poses that its keypoints allow."""

    given: Problem  # what is to be solved, as it was given; the poses are of it
    flipped: Problem | None = None  # the same with its keypoints flipped, where that is how they are taken; else None
    start: PoseEstimate  # its proposals
    poses: tuple[Alternative, ...]  # the poses that its keypoints allow, best first, with energies of the whole
    pose: gtsam.Pose3  # where it is now
    weights: Weights  # weights there

    @property
    def problem(self) -> Problem:
        """What is to be solved, as it is taken."""
        return self.given if self.flipped is None else self.flipped


@dataclass(frozen=True, kw_only=True)
class Frame(PosedImage):
    """One frame of a vehicle."""

    number: int  # in the keys
    time: float  # seconds
    step: FrameStep | None  # from the frame before; None for the first
    image: Array  # (B,) what its image says of the heading, logarithms
    heading: TrackHeading  # what it and the frames before it say of the heading
    belief: Belief  # of the heading
    velocity: Array = field(default_factory=lambda: np.zeros(3))  # (3,) where it is now
    merged: bool = False  # whether it stands for frames before it as well, which left the window

    def sensing(self, evidence: Sequence[Evidence]) -> Frame:
        """The frame with what other sensors say in the place of what they said."""
        flipped = None if self.flipped is None else self.flipped.sensing(evidence)
        return replace(self, given=self.given.sensing(evidence), flipped=flipped)

    def begun(self) -> Frame:
        """The frame as the first of its vehicle."""
        heading = TrackHeading.begun(
            self.image, np.asarray(self.pose.translation()), image_height(self.given.observation)
        )
        return replace(self, step=None, heading=heading, belief=heading.belief)

    def following(self, before: Frame, way: Array | None = None) -> Frame:
        """The frame after another one; `way` (B,) has logarithms of what the vehicle's way says of the heading."""
        assert self.step is not None
        place = np.asarray(self.pose.translation())
        heading = before.heading.following(
            self.step.seconds, self.step.turn, self.image, place, image_height(self.given.observation), way
        )
        return replace(self, heading=heading, belief=heading.belief)

    def without(self, before: Frame) -> Frame:
        """The frame after the one before that, whose motion it takes over."""
        assert before.step is not None
        assert self.step is not None
        return replace(self, step=before.step.then(self.step), merged=True)

    @property
    def camera_known(self) -> bool:
        """Whether the camera's motion from the frame before is known."""
        return self.step is not None and self.step.camera is not None


@dataclass(frozen=True, eq=False)
class CameraDrift:
    """How far a camera may be astray since the beginning of its way.

    A way that is too unsure begins anew: nothing is known of how what was before is placed to what comes then.
    """

    begun: gtsam.Pose3 | None = None  # where the way begins; None where the camera had no place yet
    # (6, 6) of the way from there, in the axes of its beginning
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def moved(self, place: gtsam.Pose3 | None, covariance: Array | None) -> CameraDrift:
        """The drift at a place, after a motion of this covariance (6, 6) in the axes there; None where it is exact."""
        if place is None:
            return self
        begun, total = self.begun or place, self.covariance
        if covariance is not None:
            by_motion = begun.between(place).AdjointMap()
            with np.errstate(all="ignore"):
                total = total + by_motion @ covariance @ by_motion.T
        return CameraDrift(begun, total) if np.abs(total).max() < SETTINGS.camera_drift_m2 else CameraDrift(place)

    def since(self, before: CameraDrift, place: gtsam.Pose3) -> Array | None:
        """(6, 6) covariance of the way since then, in the axes of a place; None where nothing is known of it."""
        if self.begun is None or before.begun is not self.begun:
            return None
        here = place.between(self.begun).AdjointMap()
        covariance = here @ (self.covariance - before.covariance) @ here.T
        # A small difference of large sums is neither symmetric nor positive to the last digit.
        spread, axes = np.linalg.eigh((covariance + covariance.T) / 2.0)
        return np.asarray((axes * np.maximum(spread, 0.0)) @ axes.T)
