"""Boxes of video drives over time: keypoints of single images, tracked by labelled ids or without any.

`ONLINE` is what `fgrecon.Tracker` says after each frame, by that one and those before; `BATCH` what it says at the end,
by all. Both get what the single images got, and nothing else: the camera's own motion is not given, and velocities are
relative to the camera. `ONLINE_MOVING` and `BATCH_MOVING` are the same with the motion that the images tell. `ALONE` is
each vehicle of each image by itself; `VOTE` and `VOTE_BATCH` flip that where the network's directions of the frames so
far, and of all, add up to the other facing; `SIGN_BELIEF` where a filter that forgets the votes of the frames says so.

Velocities with the camera's motion are over the world that it makes, and so are the labels: there are none over the
world, and the camera's error is in both. The error is thus that of the velocity relative to the camera, as without.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fgrecon.calibration.labelled_boxes import FLIPPED_DEGREES, BoxOutcome, VideoBox, normalised_squared_error, outcome
from fgrecon.calibration.labelled_frames import ScoredFrame, Setup, failed
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.detection import facing_probability
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.evidence import Evidence
from fgrecon.core.geometry import transform, view_azimuth
from fgrecon.core.half_turn import HALF_TURN
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.images import read_image
from fgrecon.io.kitti_files import IMAGES_PER_SECOND, Drive, DriveFrame
from fgrecon.io.source_frames import SourceFrame
from fgrecon.io.track_file import GroundTruth
from fgrecon.perception.keypoints.decode import logit
from fgrecon.perception.stereo import stereo_depth
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.tracker import Tracker
from fgrecon.video.association import GatedAssociation
from fgrecon.video.camera_path import CameraPath, MotionEstimator
from fgrecon.video.follow import Follower
from fgrecon.video.records import FrameRecord, Sighting
from fgrecon_research.io.drive_sensors import Sensor, file_of, right_image, scan_of

# The vote: which way a vehicle faces if one merely adds up what the network says of its frames.
#
# The least that time can tell of a facing, and what everything else over time has to beat. Each frame keeps its single
# image's result, flipped where the sum of the network's log odds over the track says so.


_SIGN_TIME_S = 1.0  # after which the sign's belief has forgotten all but 1/e
_SIGN_NOISE = 1.0  # variance of a frame's vote about the sign, whose own is 1; neither is tuned


def vote(
    track: Sequence[tuple[Reconstruction, Array | None]], times: Sequence[float]
) -> list[dict[str, Reconstruction]]:
    """The results of one vehicle, flipped where the votes of `VOTE`, `VOTE_BATCH` and `SIGN_BELIEF` say so; by name.

    A frame's log odds are those of the half of all directions around the one that its result is seen from. From frame
    to frame the vehicle turns by less than a quarter, so that results beyond that face the other way. The two votes add
    them up. The sign's belief is a Kalman filter over their signs, which are noisy measurements of a state that goes
    back to nothing (Ornstein-Uhlenbeck), as autoware_universe's tracker has one (pull request 13050).

    Args:
        track: Each frame's result and the network's directions (A,), None where there are none, in the order of time.
        times: Of the frames, seconds.
    """
    results = [result for result, _ in track]
    poses = np.array([result.camera_T_object for result in results])
    azimuths = view_azimuth(poses[:, :3, :3], poses[:, :3, 3])
    halves = [
        0.5 if directions is None else facing_probability(directions, azimuth)
        for (_, directions), azimuth in zip(track, azimuths.tolist(), strict=True)
    ]
    yaws = np.array([result.rotation_y for result in results])
    other_way = np.cumsum(np.cos(np.diff(yaws, prepend=yaws[0])) < 0.0) % 2 == 1  # than the first result
    way = np.where(other_way, -1.0, 1.0)
    odds = way * logit(np.array(halves))
    says = {VOTE: np.cumsum(odds), VOTE_BATCH: np.full(len(odds), odds.sum()), SIGN_BELIEF: _sign_belief(odds, times)}
    flips = {name: (way * said < 0.0).tolist() for name, said in says.items()}
    return [
        {name: _flipped(result) if flip[i] else result for name, flip in flips.items()}
        for i, result in enumerate(results)
    ]


def _sign_belief(odds: Array, times: Sequence[float]) -> Array:
    """(T,) expected sign after each frame of log odds (T,)."""
    mean, variance, said = 0.0, 1.0, []
    for one, seconds in zip(odds.tolist(), np.diff(times, prepend=times[0]).tolist(), strict=True):
        kept = float(np.exp(-seconds / _SIGN_TIME_S))
        mean, variance = kept * mean, 1.0 + kept**2 * (variance - 1.0)
        if one:
            gain = variance / (variance + _SIGN_NOISE)
            mean, variance = mean + gain * (float(np.sign(one)) - mean), (1.0 - gain) * variance
        said.append(mean)
    return np.array(said)


def _flipped(result: Reconstruction) -> Reconstruction:
    """With the heading flipped, and its covariance along the axes of that."""
    signs = np.tile(np.diag(HALF_TURN)[:3], 2)
    spread = result.uncertainty.pose_covariance
    covariance = None if spread is None else spread * np.outer(signs, signs)
    return replace(
        result,
        pose=replace(result.pose, camera_T_object=result.camera_T_object @ HALF_TURN),
        uncertainty=replace(result.uncertainty, pose_covariance=covariance),
    )


_Key = tuple[int, int]  # number of a frame, and position among its sightings; the first are those of the labelled boxes

ALONE = "alone"
"""Each vehicle of each image by itself; without what is known of others the whole system does the same."""
VOTE, VOTE_BATCH = "vote", "vote_batch"
"""The same, flipped where the network's directions of the frames so far, and of all, say so by their sum."""
SIGN_BELIEF = "sign_belief"
"""The same, flipped where the votes of the frames so far say so to a filter that forgets."""
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
    sensors: Collection[Sensor] = (),
    advance: Callable[[str], None] = lambda _: None,
) -> list[VideoBox]:
    """The boxes with outcomes of `ALONE` (where all were solved together), the votes, `ONLINE`, `BATCH` and more.

    Args:
        frames: Those of `fgrecon.calibration.labelled_frames.score_frames`.
        setups: What each drive is reconstructed with, by its name.
        forget_ids: Whether the vehicles are given ids anew, by association.
        estimate_motion: Whether to follow with the camera's motion as well, which all images between the first and the
            last tell; it needs the ground.
        sensors: Those of which the tracker gets what frames have: `LIDAR` and `RIGHT`.
        advance: Called with the drive's name after each of these frames that was followed, with the motion once more.
    """
    found: list[VideoBox] = []
    for drive in drives:
        own = [frame for frame in frames if frame.drive == drive.name]
        setup = setups[drive.name]
        how: dict[str, Any] = {"forget_ids": forget_ids, "estimate_motion": estimate_motion, "sensors": sensors}
        found += _follow(own, drive, setup, advance, **how)
    return found


def _records(scored: Sequence[ScoredFrame], drive: Drive, setup: Setup, *, moving: bool) -> Iterator[FrameRecord]:
    """What the frames show; with the camera's motion, those between them as well."""
    sightings = {frame.number: frame.sightings for frame in scored}
    look = None
    if moving:
        assert setup.ground is not None
        look = MotionEstimator(drive.calibration.camera, setup.ground)
    for frame in drive.frames:
        shown = sightings.get(frame.number, ())
        record = FrameRecord(frame.number, frame.seconds, frame.image.name, None, tuple(shown))
        if look is not None and sightings and min(sightings) <= frame.number <= max(sightings):
            image = SourceFrame(record.number, record.time, record.name, read_image(frame.image))
            yield replace(record, motion=look(image, shown))
        elif frame.number in sightings:
            yield record


@dataclass(frozen=True, eq=False)
class _Followed:
    """What following a drive gave."""

    online: Mapping[_Key, VehicleEstimate]  # estimates of the sightings, each by its frame and those before
    batch: Mapping[_Key, VehicleEstimate]  # the same by all frames
    ids: Mapping[_Key, int]  # the vehicle that each sighting was taken for
    # (4, 4) poses of the camera by the number of the frame; none without its motion
    world_T_camera: Mapping[int, Array]
    # labelled ones as the estimates have theirs, but along the camera's axes; by frame and track
    velocities: Mapping[tuple[int, int], Array]


def _follow(
    scored_frames: Sequence[ScoredFrame],
    drive: Drive,
    setup: Setup,
    advance: Callable[[str], None],
    *,
    forget_ids: bool,
    estimate_motion: bool,
    sensors: Collection[Sensor],
) -> list[VideoBox]:
    camera = drive.calibration.camera.with_size_of(read_image(drive.frames[0].image))  # as single images have it
    follow = partial(_estimates, scored_frames, drive, camera, setup, advance, forget_ids=forget_ids, sensors=sensors)
    still = follow(moving=False)
    ways = [(ONLINE, BATCH, still)]
    if estimate_motion:
        ways.append((ONLINE_MOVING, BATCH_MOVING, follow(moving=True)))
    alone = _alone(scored_frames, camera, setup)
    results = ({ALONE: alone} if setup.together else {}) | _votes(scored_frames, alone, still.ids)
    frames = {frame.number: frame for frame in drive.frames}
    scored = []
    for frame in scored_frames:
        for position, box in enumerate(frame.boxes):  # the first sightings are those of the labelled boxes
            key, labelled = (frame.number, position), frames[frame.number]
            objects, offset = labelled.objects, labelled.calibration.label_offset
            truth = GroundTruth(objects.location[box.index], float(objects.rotation_y[box.index]))
            score = partial(_outcome, truth=truth, size=objects.size[box.index], offset=offset)
            more = {name: score(found[key]) for name, found in results.items()}
            for online, batch, way in ways:
                velocity, place = way.velocities.get((frame.number, box.track)), way.world_T_camera.get(frame.number)
                for name, estimate in ((online, way.online.get(key)), (batch, way.batch.get(key))):
                    more[name] = score("no estimate" if estimate is None else estimate.reconstruction)
                    if estimate is not None:
                        more[name] = _moving(more[name], estimate, velocity, place)
            scored.append(replace(box, outcomes={**box.outcomes, **more}))
    return scored


def _outcome(found: Reconstruction | str, truth: GroundTruth, size: Array, offset: Array) -> BoxOutcome:
    """Of a result, or of why there is none."""
    return failed(found) if isinstance(found, str) else outcome(found, truth, size, offset)


def _estimates(
    scored: Sequence[ScoredFrame],
    drive: Drive,
    camera: Camera,
    setup: Setup,
    advance: Callable[[str], None],
    *,
    forget_ids: bool,
    moving: bool,
    sensors: Collection[Sensor],
) -> _Followed:
    tracker = Tracker(
        prior=setup.prior, size_prior=setup.size_prior, options=setup.options, shared_ground=setup.together, past=None
    )
    largest = max((int(frame.tracks.max(initial=-1)) for frame in drive.frames), default=-1)
    association = GatedAssociation(first=largest + 1)
    by_number = {frame.number: frame for frame in drive.frames}

    def sense(record: FrameRecord) -> Sequence[Evidence]:
        return _sensed(by_number[record.number], camera, sensors)

    follower = Follower(tracker, association, camera, ground=setup.ground, path=CameraPath(moving=moving), sense=sense)
    online: dict[_Key, VehicleEstimate] = {}
    ids: dict[_Key, int] = {}
    places: dict[int, Array] = {}
    numbers = {frame.number for frame in scored}
    for record in _records(scored, drive, setup, moving=moving):
        if forget_ids:
            record = replace(record, sightings=tuple(replace(one, identity=None) for one in record.sightings))
        tracked = follower(record)
        for position, one in enumerate(record.sightings):
            identity = next((i for i, box in tracked.boxes.items() if box is one.box), None)
            if identity is not None:
                ids[record.number, position] = identity
                if identity in tracked.estimates:
                    online[record.number, position] = tracked.estimates[identity]
        if tracked.world_T_camera is not None:
            places[record.number] = tracked.world_T_camera
        if record.number in numbers:
            advance(drive.name)
    smoothed = {(identity, one.time): one for identity, past in tracker.smooth().items() for one in past}
    times = {key: (ids[key], one.time) for key, one in online.items()}
    batch = {key: smoothed[time] for key, time in times.items() if time in smoothed}
    return _Followed(online, batch, ids, places, labelled_velocities(drive, places if moving else None))


def _sensed(frame: DriveFrame, camera: Camera, sensors: Collection[Sensor]) -> list[Evidence]:
    """What the tracker gets of a frame."""
    found: list[Evidence] = []
    if Sensor.LIDAR in sensors and (points := scan_of(frame)) is not None:
        found.append(points)
    if Sensor.RIGHT in sensors and file_of(frame, Sensor.RIGHT) is not None:
        found.append(stereo_depth(read_image(frame.image), camera, right_image(frame)))
    return found


def _votes(
    scored: Sequence[ScoredFrame], alone: Mapping[_Key, Reconstruction | str], ids: Mapping[_Key, int]
) -> dict[str, dict[_Key, Reconstruction | str]]:
    """The results of `vote`, vehicle by vehicle; one that was not followed votes for itself."""
    tracks: dict[int | _Key, dict[_Key, tuple[Reconstruction, Array | None]]] = {}
    for frame in scored:
        for position, one in enumerate(frame.sightings):
            key = frame.number, position
            result, directions = alone[key], None if one.observation is None else one.observation.azimuth
            if not isinstance(result, str):
                tracks.setdefault(ids.get(key, key), {})[key] = result, directions
    found = {name: dict(alone) for name in (VOTE, VOTE_BATCH, SIGN_BELIEF)}
    for track in tracks.values():
        times = [number / IMAGES_PER_SECOND for number, _ in track]
        for key, voted in zip(track, vote(list(track.values()), times), strict=True):
            for name, result in voted.items():
                found[name][key] = result
    return found


def _alone(scored: Sequence[ScoredFrame], camera: Camera, setup: Setup) -> dict[_Key, Reconstruction | str]:
    """The result of each sighting by itself, or why there is none."""
    return {
        (frame.number, position): _by_itself(one, camera, setup)
        for frame in scored
        for position, one in enumerate(frame.sightings)
    }


def _by_itself(sighting: Sighting, camera: Camera, setup: Setup) -> Reconstruction | str:
    if sighting.observation is None:
        return "no keypoints"
    try:
        return reconstruct(
            sighting.observation,
            camera,
            prior=setup.prior,
            ground=setup.ground,
            size_prior=setup.size_prior,
            options=setup.options,
        )
    except DegenerateProblemError as error:
        return str(error)


def labelled_velocities(
    drive: Drive, world_T_camera: Mapping[int, Array] | None = None
) -> dict[tuple[int, int], Array]:
    """(3,) velocity of each labelled box along the camera's axes, metres per second, by frame and track.

    It is the slope of a line through the track's labels within two frames, of which there are at least four, on both
    sides.

    Args:
        world_T_camera: (4, 4) poses of the camera by the number of the frame, for velocities over the world; between
            the labels none may be missing. None for velocities relative to the camera.
    """
    tracks: dict[int, dict[int, Array]] = {}
    for frame in drive.frames:
        for index in np.flatnonzero(frame.boxed & (frame.tracks >= 0)):
            place = frame.objects.location[index] + frame.calibration.label_offset
            tracks.setdefault(int(frame.tracks[index]), {})[frame.number] = place
    missing = set() if world_T_camera is None else {frame.number for frame in drive.frames} - set(world_T_camera)
    found: dict[tuple[int, int], Array] = {}
    for track, places in tracks.items():
        for number in places:
            near = [n for n in range(number - _ABOUT, number + _ABOUT + 1) if n in places]
            if len(near) < _FEWEST or not near[0] < number < near[-1]:
                continue
            if not missing.isdisjoint(range(near[0], near[-1] + 1)):
                continue
            points = [places[n] for n in near]
            if world_T_camera is not None:
                here = np.linalg.inv(world_T_camera[number])
                points = [transform(here @ world_T_camera[n], places[n]) for n in near]
            slope, _ = np.polyfit(np.array(near) / IMAGES_PER_SECOND, np.array(points), 1)
            found[number, track] = slope
    return found


def _moving(
    found: BoxOutcome, estimate: VehicleEstimate, velocity: Array | None, world_T_camera: Array | None
) -> BoxOutcome:
    """With the facing's probability over time, and the velocity's error over the ground."""
    found = replace(found, facing=estimate.facing_probability)
    if velocity is None or estimate.velocity is None:
        return found
    estimated = estimate.velocity if world_T_camera is None else world_T_camera[:3, :3].T @ estimate.velocity
    off = (estimated - velocity)[_OVER_GROUND]
    found = replace(found, velocity=float(np.linalg.norm(off)))
    spread = estimate.velocity_covariance
    # With the camera's pose known the covariance lacks the camera's own error.
    if spread is None or found.degrees > FLIPPED_DEGREES or world_T_camera is not None:
        return found
    over_ground = spread[np.ix_(_OVER_GROUND, _OVER_GROUND)]
    squared = normalised_squared_error(off, over_ground)
    if squared is None:
        return found
    radius = float(np.linalg.det(over_ground)) ** 0.25
    return replace(found, squared={**found.squared, "velocity": squared}, spread={**found.spread, "velocity": radius})
