"""Boxes of video drives over time: the keypoints that single images gave, followed by labelled ids or without any.

`ONLINE` is what `fgrecon.Tracker` says after each frame, by that one and those before; `BATCH` what it says at the end,
by all. Both get what the single images got, and nothing else: the camera's own motion is not given, and velocities are
relative to the camera. `ONLINE_MOVING` and `BATCH_MOVING` are the same with the motion that the images tell; velocities
are over the world then, and not scored. `ALONE` is each vehicle of each image by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.evaluation.consistency import normalised_squared_error
from fgrecon.evaluation.kitti_images import Setup
from fgrecon.evaluation.video_frames import ScoredFrame
from fgrecon.evaluation.video_images import TURNED_ROUND, BoxOutcome, VideoBox, outcome
from fgrecon.io.frames import SourceFrame
from fgrecon.io.images import read_image
from fgrecon.io.kitti_drives import IMAGES_PER_SECOND, Drive, DriveFrame
from fgrecon.io.track_file import GroundTruth
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.tracker import Tracker
from fgrecon.video.association import GatedAssociation
from fgrecon.video.follow import Follower
from fgrecon.video.motion_look import MotionLook
from fgrecon.video.records import FrameRecord, Sighting

__all__ = ["ALONE", "BATCH", "BATCH_MOVING", "ONLINE", "ONLINE_MOVING", "follow_boxes", "labelled_velocities"]

Array = NDArray[np.float64]

ALONE = "alone"
"""Each vehicle of each image by itself; without what is known of others the whole system does the same."""
ONLINE = "online"
"""Each frame by itself and those before."""
BATCH = "batch"
"""Each frame by all."""

ONLINE_MOVING, BATCH_MOVING = "online_moving", "batch_moving"
"""The same with the camera's motion, as the images tell it."""

_OVER_GROUND = [0, 2]  # axes of the camera
_ABOUT, _FEWEST = 2, 4  # a labelled velocity is of labels at most so many frames away, and of so many labels


def follow_boxes(
    frames: Sequence[ScoredFrame],
    drives: Sequence[Drive],
    setups: Mapping[str, Setup],
    *,
    forget_ids: bool = False,
    estimate_motion: bool = False,
    advance: Callable[[str], None] = lambda _: None,
) -> list[VideoBox]:
    """The boxes with outcomes of `ALONE` (where all were solved together), `ONLINE`, `BATCH` and more beside their own.

    Args:
        frames: Those of `fgrecon.evaluation.video_frames.score_frames`.
        drives: The drives that they are of.
        setups: What each drive is reconstructed with, by its name.
        forget_ids: Whether the vehicles are given ids anew, by association.
        estimate_motion: Whether to follow with the camera's motion as well, which all images between the first and the
            last tell; it needs the ground.
        advance: Called with the drive's name after each of these frames that was followed, with the motion once more.
    """
    found: list[VideoBox] = []
    for drive in drives:
        own = [frame for frame in frames if frame.drive == drive.name]
        setup = setups[drive.name]
        found += _follow(own, drive, setup, advance, forget_ids=forget_ids, estimate_motion=estimate_motion)
    return found


def _records(seen: Sequence[ScoredFrame], drive: Drive, setup: Setup, *, moving: bool) -> Iterator[FrameRecord]:
    """What the frames show; with the camera's motion, those between them as well."""
    sightings = {frame.number: frame.sightings for frame in seen}
    look = None
    if moving:
        assert setup.ground is not None
        look = MotionLook(drive.calibration.camera, setup.ground)
    for frame in drive.frames:
        shown = sightings.get(frame.number, ())
        record = FrameRecord(frame.number, frame.number / IMAGES_PER_SECOND, frame.image.name, None, tuple(shown))
        if look is not None and sightings and min(sightings) <= frame.number <= max(sightings):
            image = SourceFrame(record.number, record.time, record.name, read_image(frame.image))
            yield replace(record, motion=look(image, shown))
        elif frame.number in sightings:
            yield record


def _follow(
    seen: Sequence[ScoredFrame],
    drive: Drive,
    setup: Setup,
    advance: Callable[[str], None],
    *,
    forget_ids: bool,
    estimate_motion: bool,
) -> list[VideoBox]:
    camera = drive.calibration.camera.with_size_of(read_image(drive.frames[0].image))  # as single images have it
    ways = [
        (online, batch, _estimates(seen, drive, camera, setup, advance, forget_ids=forget_ids, moving=moving))
        for online, batch, moving in ((ONLINE, BATCH, False), (ONLINE_MOVING, BATCH_MOVING, True))
        if estimate_motion or not moving
    ]
    frames, velocities = {frame.number: frame for frame in drive.frames}, labelled_velocities(drive)
    scored = []
    for frame in seen:
        for box, one in zip(frame.boxes, frame.sightings, strict=False):  # the first are the labelled ones
            labelled = frames[box.frame]
            objects, offset = labelled.objects, labelled.calibration.label_offset
            truth = GroundTruth(objects.location[box.index], float(objects.rotation_y[box.index]))
            size, velocity = objects.size[box.index], velocities.get((box.frame, box.track))
            more: dict[str, BoxOutcome] = {}
            if setup.together:
                more[ALONE] = _alone(box, one, labelled, camera, setup, truth)
            for *names, found in ways:
                for name, estimate in zip(names, found.get((box.frame, box.index), (None, None)), strict=True):
                    if estimate is None:
                        more[name] = BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, "no estimate")
                        continue
                    of_label = None if name in (ONLINE_MOVING, BATCH_MOVING) else velocity
                    more[name] = _moving(outcome(estimate.reconstruction, truth, size, offset), estimate, of_label)
            scored.append(replace(box, outcomes={**box.outcomes, **more}))
    return scored


def _estimates(
    seen: Sequence[ScoredFrame],
    drive: Drive,
    camera: Camera,
    setup: Setup,
    advance: Callable[[str], None],
    *,
    forget_ids: bool,
    moving: bool,
) -> dict[tuple[int, int], tuple[VehicleEstimate | None, VehicleEstimate | None]]:
    """Of each labelled box that was followed, by frame and index, the estimate online and in batch."""
    tracker = Tracker(
        prior=setup.prior, size_prior=setup.size_prior, options=setup.options, shared_ground=setup.together, past=None
    )
    largest = max((int(frame.tracks.max(initial=-1)) for frame in drive.frames), default=-1)
    association = GatedAssociation(first=largest + 1)
    follower = Follower(tracker, association, camera, ground=setup.ground, moving=moving)
    online: dict[tuple[int, int], VehicleEstimate] = {}
    named: dict[tuple[int, int], int] = {}  # the vehicle that each label was taken for
    boxes = {frame.number: frame.boxes for frame in seen}
    for record in _records(seen, drive, setup, moving=moving):
        if forget_ids:
            record = replace(record, sightings=tuple(replace(one, identity=None) for one in record.sightings))
        tracked = follower(record)
        online |= {(record.number, identity): estimate for identity, estimate in tracked.estimates.items()}
        for box, one in zip(boxes.get(record.number, ()), record.sightings, strict=False):
            identity = next((i for i, place in tracked.boxes.items() if place is one.box), None)
            if identity is not None:
                named[box.frame, box.index] = identity
        if record.number in boxes:
            advance(drive.name)
    smoothed = {(identity, one.time): one for identity, past in tracker.smooth().items() for one in past}
    found = {label: online.get((label[0], identity)) for label, identity in named.items()}
    return {
        label: (one, None if one is None else smoothed.get((named[label], one.time))) for label, one in found.items()
    }


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
                slope, _ = np.polyfit(np.array(near) / IMAGES_PER_SECOND, np.array([places[n] for n in near]), 1)
                found[number, track] = slope
    return found


def _alone(
    box: VideoBox, seen: Sighting, frame: DriveFrame, camera: Camera, setup: Setup, truth: GroundTruth
) -> BoxOutcome:
    if seen.observation is None:
        return BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, "no keypoints")
    try:
        result = reconstruct(
            seen.observation,
            camera,
            prior=setup.prior,
            ground=setup.ground,
            size_prior=setup.size_prior,
            options=setup.options,
        )
    except DegenerateProblemError as error:
        return BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, str(error))
    return outcome(result, truth, frame.objects.size[box.index], frame.calibration.label_offset)


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
