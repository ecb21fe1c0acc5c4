"""Runs methods over tracks and scores every frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome
from fgrecon.calibration.labelled_frames import ReconstructedFrame, SceneKnowledge
from fgrecon.core.camera import Camera
from fgrecon.core.metrics import FAILURE_DEGREES, orientation_error, translation_error
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.track_file import Track, TrackFrame
from fgrecon_research.evaluation.methods import Estimate, Method, Solver, select


@dataclass(frozen=True)
class FrameScore:
    """One method on one frame."""

    frame: str  # name of the frame
    orientation_error: float  # degrees; 180 for a failure
    translation_error: float  # metres; infinite for a failure
    rotation_y: float | None  # estimated yaw, radians, or None for a failure
    location: NDArray[np.float64] | None  # (3,) estimated origin in the label's frame, metres, or None for a failure
    milliseconds: dict[str, float]  # wall time by stage; empty for a failure
    failure: str | None  # why the method gave no pose, or None


@dataclass(frozen=True)
class MethodScores:
    """One method on all frames, failures included."""

    name: str
    summary: str
    prior: str
    frames: tuple[FrameScore, ...]

    @property
    def failures(self) -> tuple[FrameScore, ...]:
        """The frames without a pose."""
        return tuple(frame for frame in self.frames if frame.failure is not None)

    @property
    def orientation_errors(self) -> NDArray[np.float64]:
        """(M,) degrees."""
        return np.array([frame.orientation_error for frame in self.frames])

    @property
    def translation_errors(self) -> NDArray[np.float64]:
        """(M,) metres."""
        return np.array([frame.translation_error for frame in self.frames])

    def milliseconds(self, stage: str) -> float | None:
        """Mean wall time of a stage over the frames with a pose; None where the method has no such stage."""
        times = [frame.milliseconds[stage] for frame in self.frames if stage in frame.milliseconds]
        return float(np.mean(times)) if times else None


def score_tracks(
    tracks: Sequence[Track],
    methods: Sequence[Method],
    scene: SceneKnowledge,
    advance: Callable[[str], None] = lambda _: None,
) -> tuple[MethodScores, ...]:
    """Run every method on every frame, one after the other in this process, so that the times mean something.

    Returns:
        One entry per method with one score per frame, in the order given.
    """
    scores = []
    for method in methods:
        solver = method.bind(scene)
        _warm_up(solver, tracks)
        frames = []
        for track in tracks:
            for frame in track.frames:
                frames.append(score_pose(solver, track.camera, frame, track.label_offset))
                advance(method.name)
        scores.append(MethodScores(method.name, method.summary, method.prior_name(scene), tuple(frames)))
    return tuple(scores)


def _warm_up(solver: Solver, tracks: Sequence[Track]) -> None:
    """Solve one frame off the record: the first call fills caches and would be charged for it."""
    for track in tracks:
        for frame in track.frames:
            if frame.observation is not None:
                with suppress(Exception):
                    solver(frame.observation, track.camera)
                return


def score_pose(solver: Solver, camera: Camera, frame: TrackFrame, label_offset: NDArray[np.float64]) -> FrameScore:
    """Run a bound method on one frame and score it in the label's frame.

    What is labelled at X is at X + label_offset (3,) in the camera's frame, metres.
    """
    if frame.observation is None:
        return _failed(frame, "the frame has no measured keypoint")
    try:
        estimate = _checked(solver(frame.observation, camera))
    except Exception as error:  # noqa: BLE001 - a crash counts like a refusal: 180 degrees, named, never left out
        return _failed(frame, f"{type(error).__name__}: {error}")
    yaw = rotation_y(estimate.camera_T_object)
    location = estimate.camera_T_object[:3, 3] - label_offset  # score in the label's frame
    return FrameScore(
        frame=frame.name,
        orientation_error=float(orientation_error([yaw], [frame.truth.rotation_y])[0]),
        translation_error=float(translation_error([location], [frame.truth.location])[0]),
        rotation_y=yaw,
        location=location,
        milliseconds=dict(estimate.milliseconds),
        failure=None,
    )


def _checked(estimate: Estimate) -> Estimate:
    pose = np.asarray(estimate.camera_T_object)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ArithmeticError("The pose is not a finite 4x4 matrix.")
    return estimate


def _failed(frame: TrackFrame, reason: str) -> FrameScore:
    return FrameScore(frame.name, FAILURE_DEGREES, float("inf"), None, None, {}, reason)


class ScoredRivals:
    """Methods that get the keypoints of labelled boxes (`fgrecon.calibration.labelled_frames.Rivals`)."""

    def __init__(self, scene: SceneKnowledge, names: Sequence[str]) -> None:
        """Bind the methods of these names to what is known of the scene.

        Raises:
            InvalidInputError: There is no method of a name.
        """
        self.solvers = {method.name: method.bind(scene) for method in select(names)}

    def __call__(self, solved: ReconstructedFrame) -> list[Mapping[str, BoxOutcome]]:
        """Score each method on the keypoints of each box."""
        return [
            {
                name: _of_score(score_pose(solver, solved.camera, frame, solved.frame.calibration.label_offset))
                for name, solver in self.solvers.items()
            }
            for frame in solved.keypoints()
        ]


def _of_score(one: FrameScore) -> BoxOutcome:
    return BoxOutcome(one.orientation_error, one.translation_error, None, None, one.failure)
