"""Labelled boxes of video drives over time: the keypoints that single images gave, followed by their labelled ids.

`ONLINE` is what `fgrecon.Tracker` says after each frame, by that one and those before; `BATCH` what it says at the end,
by all. Both get what the single images got, and nothing else: the camera's own motion is not given, and velocities are
relative to the camera. `ALONE` is each vehicle of each image by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.evaluation.consistency import normalised_squared_error
from fgrecon.evaluation.kitti_images import Setup
from fgrecon.evaluation.video_images import TURNED_ROUND, BoxOutcome, VideoBox, outcome
from fgrecon.io.kitti_drives import Drive, DriveFrame
from fgrecon.io.track_file import GroundTruth
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.tracker import Tracker

__all__ = ["ALONE", "BATCH", "ONLINE", "follow_boxes", "labelled_velocities"]

Array = NDArray[np.float64]

ALONE = "alone"
"""Each vehicle of each image by itself; without what is known of others the whole system does the same."""
ONLINE = "online"
"""Each frame by itself and those before."""
BATCH = "batch"
"""Each frame by all."""

_RATE = 10.0  # images of KITTI's drives in a second
_OVER_GROUND = [0, 2]  # axes of the camera
_ABOUT, _FEWEST = 2, 4  # a labelled velocity is of labels at most so many frames away, and of so many labels


def follow_boxes(boxes: Sequence[VideoBox], drives: Sequence[Drive], setups: Mapping[str, Setup]) -> list[VideoBox]:
    """The boxes with outcomes of `ALONE` (where all were solved together), `ONLINE` and `BATCH` beside their own.

    Args:
        boxes: Those of `fgrecon.evaluation.video_images.score_drives`, in its order.
        drives: The drives that they are of.
        setups: What each drive is reconstructed with, by its name.
    """
    found: list[VideoBox] = []
    for drive in drives:
        found += _follow([box for box in boxes if box.drive == drive.name], drive, setups[drive.name])
    return found


def _follow(boxes: Sequence[VideoBox], drive: Drive, setup: Setup) -> list[VideoBox]:
    tracker = Tracker(
        prior=setup.prior, size_prior=setup.size_prior, options=setup.options, shared_ground=setup.together, past=None
    )
    frames = {frame.number: frame for frame in drive.frames}
    online: dict[tuple[int, int], VehicleEstimate] = {}
    for number, some in groupby(boxes, key=lambda box: box.frame):
        camera = frames[number].calibration.camera
        seen = {box.track: box.observation for box in some if box.observation is not None}
        estimates = tracker.update(number / _RATE, seen, camera=camera, ground=setup.ground)
        online |= {(number, track): estimate for track, estimate in estimates.items()}
    times = {key: estimate.time for key, estimate in online.items()}
    smoothed = {(track, one.time): one for track, past in tracker.smooth().items() for one in past}
    batch = {key: smoothed.get((key[1], time)) for key, time in times.items()}
    velocities = labelled_velocities(drive)
    scored = []
    for box in boxes:
        frame, key = frames[box.frame], (box.frame, box.track)
        objects, offset = frame.objects, frame.calibration.label_offset
        truth = GroundTruth(objects.location[box.index], float(objects.rotation_y[box.index]))
        size, velocity = objects.size[box.index], velocities.get(key)
        more: dict[str, BoxOutcome] = {}
        if setup.together:
            more[ALONE] = _alone(box, frame, setup, truth)
        for name, estimate in ((ONLINE, online.get(key)), (BATCH, batch.get(key))):
            if estimate is None:
                more[name] = BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, "no estimate")
            else:
                more[name] = _moving(outcome(estimate.reconstruction, truth, size, offset), estimate, velocity)
        scored.append(replace(box, outcomes={**box.outcomes, **more}))
    return scored


def labelled_velocities(drive: Drive) -> dict[tuple[int, int], Array]:
    """(3,) velocity of each labelled box relative to the camera, metres per second, by frame and track.

    It is the slope of a line through the track's labels within two frames, of which there are at least four, on both
    sides.
    """
    tracks: dict[int, dict[int, Array]] = {}
    for frame in drive.frames:
        for index in np.flatnonzero(frame.boxed & (frame.tracks >= 0)):
            tracks.setdefault(int(frame.tracks[index]), {})[frame.number] = frame.objects.location[index]
    found: dict[tuple[int, int], Array] = {}
    for track, places in tracks.items():
        for number in places:
            near = [n for n in range(number - _ABOUT, number + _ABOUT + 1) if n in places]
            if len(near) >= _FEWEST and near[0] < number < near[-1]:
                slope, _ = np.polyfit(np.array(near) / _RATE, np.array([places[n] for n in near]), 1)
                found[number, track] = slope
    return found


def _alone(box: VideoBox, frame: DriveFrame, setup: Setup, truth: GroundTruth) -> BoxOutcome:
    calibration = frame.calibration
    if box.observation is None:
        return BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, "no keypoints")
    try:
        result = reconstruct(
            box.observation,
            calibration.camera,
            prior=setup.prior,
            ground=setup.ground,
            size_prior=setup.size_prior,
            options=setup.options,
        )
    except DegenerateProblemError as error:
        return BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, str(error))
    return outcome(result, truth, frame.objects.size[box.index], calibration.label_offset)


def _moving(found: BoxOutcome, estimate: VehicleEstimate, velocity: Array | None) -> BoxOutcome:
    """With the facing's probability over time, and the velocity's error over the ground."""
    found = replace(found, facing=estimate.facing_probability)
    if velocity is None or estimate.velocity is None:
        return found
    off = (estimate.velocity - velocity)[_OVER_GROUND]
    found = replace(found, velocity=float(np.linalg.norm(off)))
    spread = estimate.velocity_covariance
    if spread is None or found.degrees > TURNED_ROUND:
        return found
    over_ground = spread[np.ix_(_OVER_GROUND, _OVER_GROUND)]
    squared = normalised_squared_error(off, over_ground)
    if squared is None:
        return found
    radius = float(np.linalg.det(over_ground)) ** 0.25
    return replace(found, squared={**found.squared, "velocity": squared}, spread={**found.spread, "velocity": radius})
