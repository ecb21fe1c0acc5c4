"""The service behind `fgrecon run`, from request to folder: `prepare_video`, `track_video`, `write_tracks`.

VideoRequest ---- prepare_video (read, check, find the camera) ---- VideoJob ---- track_video ---- VideoRun
"""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.batch.parts import refuse_batch
from fgrecon.batch.vehicle_tasks import check_of_file
from fgrecon.core.camera import DEFAULT_FIELD_OF_VIEW, Camera
from fgrecon.core.choices import BoxModel, ClassSource
from fgrecon.core.errors import InvalidInputError, UncoveredFramesWarning
from fgrecon.core.evidence import Evidence
from fgrecon.core.input_warnings import (
    InputWarnings,
    camera_warning_of,
    input_warning_of,
    interval_warning,
    summed_up,
)
from fgrecon.core.text import counted
from fgrecon.io.bag import is_bag
from fgrecon.io.bag_drive import BagDrive, LidarTopic, open_bag_drive
from fgrecon.io.cameras.camera_source import CameraSource, assumed_focal_length
from fgrecon.io.datasets import is_data_set, open_video
from fgrecon.io.export.formats import table_file
from fgrecon.io.files import check_folder, text_file
from fgrecon.io.frames import FrameSource, ImageFrames, NumberedFrames, numbered_frames, open_frames, timed_frames
from fgrecon.io.images import read_photograph
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.kitti_files import Drive
from fgrecon.io.poses import CameraPoses, read_poses
from fgrecon.io.run_settings import RunSettings, content_hash
from fgrecon.io.source_frames import DEFAULT_RATE, Choice, SourceFrame
from fgrecon.io.video_frames import VideoFrames, check_video, packet_times
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.sessions import at_most, threads_of_networks
from fgrecon.perception.sensor_source import SensorSource
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.solve.box_check import boxes_warning
from fgrecon.solve.tracker import Tracker
from fgrecon.video.association import GatedAssociation
from fgrecon.video.camera_path import CameraPath, MotionEstimator
from fgrecon.video.coverage import check_coverage, planned_frames
from fgrecon.video.focal import estimate_camera
from fgrecon.video.follow import Follower
from fgrecon.video.frame_detector import FrameDetector
from fgrecon.video.given import Given, in_words, read_given
from fgrecon.video.image_tracker import SingleImageTracker
from fgrecon.video.newest import LiveFrames, as_max_delay
from fgrecon.video.records import FrameRecord
from fgrecon.video.rows import flattened, frame_lines, rows_of, tracking_text
from fgrecon.video.run import VideoRun, run_video
from fgrecon.video.stages import rare_collections

Warn = Callable[[str], None]
"""Called with each warning."""


@dataclass(frozen=True)
class VideoRequest:
    """What is requested of a video."""

    # a video; images: their folder, or a pattern; a camera of a data set (`fgrecon.io.datasets`); a topic of a bag
    # (`fgrecon.io.bag_drive`); or a file of keypoints alone (json)
    source: str
    out: Path  # folder of the results
    settings: RunSettings  # what holds for every vehicle
    camera: CameraSource = field(default_factory=CameraSource)  # the given camera
    fps: float | None = None  # frames per second of images without times, or None
    every: int = 1  # every so many frames
    start: float = 0.0  # seconds after the first frame before which none is taken
    end: float | None = None  # seconds after the first frame from which on none is taken, or None
    poses: Path | None = None  # file of the camera's poses; of a bag a topic of odometry, or a frame of TF; or None
    # whether the camera's motion is estimated; None where that makes results better
    estimate_motion: bool | None = None
    tracks: Path | None = None  # file of vehicles detected by others, or None
    forget_ids: bool = False  # whether those are given ids anew
    box_model: BoxModel | None = None  # what 2D boxes enclose; None for what their source says
    weights: Path | None = None  # keypoint network, or None for the shipped one
    device: str = "cpu"  # where the networks run: `cpu`, `cuda` or `cuda:1`
    online: bool = False  # whether estimates stay as they were when their frame came
    alone: bool = False  # whether every image is taken on its own: no motion, no smoothing
    # frames come as from a camera, and none has its estimates later than so many seconds after that, as far as possible
    # (`run_video`); needs one of the two before. None: each comes when it is wanted.
    max_delay: float | None = None
    together: bool = True  # whether the vehicles of an image share its ground
    video: Path | None = None  # annotated video that is to be written afterwards, or None
    picture_frame: int | None = None  # frame that is to be drawn afterwards, or None
    sensors: SensorSource | LidarTopic | None = None  # other sensors' files; of a bag its LiDAR; or None

    @property
    def choice(self) -> Choice:
        """Which frames are taken."""
        return Choice(self.every, self.start, self.end)


@dataclass(frozen=True)
class VideoJob:
    """What is to be done, all of it checked."""

    request: VideoRequest  # what was requested
    source: FrameSource
    camera: Camera
    label_offset: NDArray[np.float64] | None  # (3,) of KITTI's labels in its frame, or None
    settings: RunSettings  # what holds for every vehicle
    given: Given | None  # vehicles detected by others, or None
    poses: CameraPoses | None  # of the camera, or None
    moving: bool  # whether the camera's motion is estimated
    # what other sensors say of a frame; None where there are none
    sense: Callable[[FrameRecord], Sequence[Evidence]] | None = None

    @cached_property
    def records_depend_on(self) -> dict[str, Any]:
        """What the stored records depend on: priors and options may change, and networks need not look again."""
        ask = self.request
        files = {"source": Path(ask.source), "tracks": ask.tracks, "weights": ask.weights}
        return {
            **{name: None if path is None else _place(path) for name, path in files.items()},
            **{f"{name}_sha256": content_hash(path) for name, path in files.items()},
            "fps": DEFAULT_RATE if self.source.assumed_rate else ask.fps,
            "every": ask.every,
            "start": ask.start,
            "end": ask.end,
            "category": self.settings.prior.category.name,
            "forget_ids": ask.forget_ids,
            **({"scale_to_image": True} if ask.camera.scale_to_image else {}),
            **({} if (classes := ask.settings.classes) is None else {"classes": classes.value}),
        }


def _place(path: Path) -> str:
    """Where something is; a pattern of files, or the name of shipped weights, as it is."""
    return str(path.resolve() if path.exists() else path)


def prepare_video(request: VideoRequest, warn: Warn) -> VideoJob:
    """Read what is requested, refuse what cannot be done, and find the camera, before the work; warn of assumptions.

    Raises:
        InvalidInputError: Something cannot be used; names it.
        MissingPackageError: A package for videos is not installed.
    """
    check_folder(request.out)
    refuse_batch(request.out)
    if request.video is not None:
        check_video(request.video)
    if as_max_delay(request.max_delay) is not None and not (request.online or request.alone):
        fix = "Give `online` or `alone` (--online, --alone): smoothed estimates are there when vehicles have gone."
        raise InvalidInputError("max_delay", request.max_delay, fix)
    ground, options = request.settings.ground, request.settings.options
    if ground is not None and ground.is_vague:
        fix = "Give the plane, NX,NY,NZ,D, or leave it out: vehicles are distinguished by where they stand."
        raise InvalidInputError("ground", ground.distance, fix)
    drive = _open_drive(request)
    source, given = _open_source(request, drive)
    _check_classes(request, source, given)
    sense = _sense(request, source, drive)
    if source.assumed_rate:
        warn(
            f"No frame rate (`fps`, --fps) is given: {DEFAULT_RATE:g} frames per second are assumed; speeds go with it."
        )
    if given is not None and given.left_out:
        taken = " and ".join(given.kinds)
        warn(f"{request.tracks}: {in_words(given.left_out)} are left out; {taken} of the frames are taken.")
    source_has = BoxModel.DETECTED if given is None else BoxModel.CUBOID if given.cuboids else BoxModel.SURFACE
    box = replace(options.box, model=request.box_model or source_has)
    settings = replace(request.settings, options=replace(options, box=box))
    poses = _poses(request, drive)
    moving = _is_moving(request, source, poses)
    if request.picture_frame is not None and not _may_have(source, request.picture_frame):
        raise InvalidInputError("picture_frame", request.picture_frame, "Give the number of one of the frames.")
    if poses or given:
        check_coverage(planned_frames(source) or (), poses, None if given is None else given.vehicles.keys())
    camera, offset = _camera(request, source, given, drive, settings, warn)
    if given is not None:
        given = given.fitted(camera.image_size, scale=request.camera.scale_to_image)
    for line in drive.warnings if isinstance(drive, BagDrive) else ():
        warn(line)
    return VideoJob(request, source, camera, offset, settings, given, poses, moving, sense)


def _check_classes(request: VideoRequest, source: FrameSource, given: Given | None) -> None:
    """Refuse classes that nobody can say."""
    classes = request.settings.classes
    if classes is ClassSource.LABELS:
        every = () if given is None else given.vehicles.values()
        if all(one.vehicle_class is None for some in every for one in some):
            fix = "Give vehicles whose class is known (--tracks); what the detector says is `detected`."
            raise InvalidInputError("classes", classes.value, fix)
    elif isinstance(source, NumberedFrames) or (classes is ClassSource.KEYPOINTS and given and given.complete):
        check_of_file(classes)


def _open_drive(request: VideoRequest) -> Drive | BagDrive | None:
    """The data set or bag that the source is; None of others."""
    lidar = request.sensors if isinstance(request.sensors, LidarTopic) else None
    if is_bag(request.source):
        return open_bag_drive(request.source, choice=request.choice, lidar=lidar)
    if lidar is not None:
        raise InvalidInputError("lidar", lidar.topic, "Give files, or a bag that has such a topic.")
    return open_video(request.source) if is_data_set(request.source) else None


def _may_have(source: FrameSource, number: int) -> bool:
    """Whether there can be a frame of this number; of a video by its packets, since its head often errs."""
    if not isinstance(source, VideoFrames):
        return number in source.numbers
    return number >= 0 and number % source.choice.every == 0 and number < len(packet_times(source.path))


def _poses(request: VideoRequest, drive: Drive | BagDrive | None) -> CameraPoses | None:
    """The given poses of the camera, else those of a data set or bag."""
    if isinstance(drive, BagDrive) and not (request.poses is not None and request.poses.exists()):
        wanted = None if request.poses is None else str(request.poses)
        return None if wanted is None and request.estimate_motion else drive.poses(wanted)
    if request.poses is not None:
        return read_poses(request.poses)
    assert not isinstance(drive, BagDrive)
    known = {} if drive is None else {f.number: f.world_T_camera for f in drive.frames if f.world_T_camera is not None}
    return CameraPoses(known) if known else None


def _is_moving(request: VideoRequest, source: FrameSource, poses: CameraPoses | None) -> bool:
    """Whether the camera's motion is estimated: where it makes results better, if nothing is said."""
    images, ground = not isinstance(source, NumberedFrames), request.settings.ground
    if request.estimate_motion is None:
        return images and not request.alone and poses is None and ground is not None
    if request.estimate_motion:
        if not images:
            raise InvalidInputError("estimate_motion", request.source, "Give images: keypoints alone have none.")
        if request.poses is not None:
            raise InvalidInputError(
                "poses", str(request.poses), "Give either `poses` (--poses) or `estimate_motion` (--estimate-motion)."
            )
        if ground is None:
            fix = "Give the ground (--camera-height, --ground): how far the camera goes is measured on the ground."
            raise InvalidInputError("estimate_motion", "no ground", fix)
    return request.estimate_motion


def _open_source(request: VideoRequest, drive: Drive | BagDrive | None) -> tuple[FrameSource, Given | None]:
    """The frames, and the vehicles that others have detected, beside the images or in their place."""
    path, category = Path(request.source), request.settings.prior.category
    how: dict[str, Any] = {"forget_ids": request.forget_ids, "all_classes": request.settings.classes is not None}
    if path.suffix.lower() == ".json":
        if request.tracks is not None:
            raise InvalidInputError("tracks", str(request.tracks), "Leave it out: keypoints are given already.")
        given = read_given(path, category, **how)
        if request.video is not None:
            raise InvalidInputError("video", request.source, "Give images: keypoints alone have none.")
        return numbered_frames(path, given.vehicles, request.choice, times=given.times, rate=request.fps), given
    if request.forget_ids and request.tracks is None:
        raise InvalidInputError("forget_ids", value=True, fix="Give `tracks` (--tracks) as well, or leave it out.")
    if drive is not None and request.fps is not None:
        raise InvalidInputError("fps", request.fps, "Leave it out: the source has the times of its images.")
    source: FrameSource
    if isinstance(drive, BagDrive):
        source = drive.frames
    elif drive is not None:
        source = timed_frames([f.image for f in drive.frames], [f.seconds for f in drive.frames], request.choice)
    else:
        part: dict[str, Any] = {"every": request.every, "start": request.start, "end": request.end}
        source = open_frames(request.source, rate=request.fps, **part)
    if request.tracks is None:
        return source, None
    return source, read_given(request.tracks, category, source=source, **how)


def _camera(
    request: VideoRequest,
    source: FrameSource,
    given: Given | None,
    drive: Drive | BagDrive | None,
    settings: RunSettings,
    warn: Warn,
) -> tuple[Camera, NDArray[np.float64] | None]:
    """The camera, with the size of the first image that can be read, and the offset of KITTI's labels."""
    frame = next((frame for frame in source.read() if frame.image is not None), None)
    image = None if frame is None else frame.image
    if image is None and (given is None or not given.complete):
        raise InvalidInputError("source", request.source, "Give frames of which at least one can be read.")
    camera, offset = request.camera.camera(source.first_file.name)
    if camera is None and given is not None:
        camera = given.camera
    if camera is None and drive is not None:
        camera = drive.camera if isinstance(drive, BagDrive) else drive.calibration.camera
    if camera is None and (beside := calibration_beside(source.first_file)) is not None:
        camera, offset = beside.camera, beside.label_offset
    size = None if image is None else (image.shape[1], image.shape[0])
    whole = None if camera is not None or size is None else request.camera.whole_of(size)
    if whole is not None and frame is not None and isinstance(source, ImageFrames):
        file = source.paths[source.numbers.index(frame.number)]
        camera = read_photograph(file, whole)[1]  # by its EXIF data
    known = camera is not None
    if camera is None and whole is not None:
        camera = Camera.of_unknown(*whole)
    if camera is None:
        raise InvalidInputError("camera", "none", "Give a camera file or intrinsics (--camera, --intrinsics).")
    camera = request.camera.complete(camera, declared=False)
    if size is not None:
        camera = replace(camera, image_size=size)
    if not known:
        frame_detector = _detector(request, settings, given)
        camera = _estimated_camera(source, frame_detector, settings, camera, warn)
    return replace(camera, focal_sigma=0.0), offset  # one focal length for all frames


def _estimated_camera(
    source: FrameSource, frame_detector: FrameDetector, settings: RunSettings, unknown: Camera, warn: Warn
) -> Camera:
    """The camera estimated from the vehicles of some frames, or one with a usual field of view."""
    found = estimate_camera(source, frame_detector, unknown, **settings.arguments())
    if found is None:
        warn(
            f"No camera is given, and no car shows it: a field of view of {DEFAULT_FIELD_OF_VIEW:g} degrees is "
            "assumed, and distances are rough. Give a camera file or intrinsics (--camera, --intrinsics)."
        )
        return unknown
    cars = f"{counted(found.vehicles, 'car')} of {counted(found.images, 'frame')}"
    warn(assumed_focal_length(found.camera, None, cars))
    return found.camera


def _detector(request: VideoRequest, settings: RunSettings, given: Given | None) -> FrameDetector:
    """What looks at the frames."""
    whole, classes = given is not None and given.complete, settings.classes
    looks = given is None or classes is ClassSource.DETECTED
    return FrameDetector(
        settings.prior.category,
        vehicle_detector=NanodetVehicleDetector(device=request.device) if looks else None,
        keypoint_detector=None if whole else KeypointCascade(request.weights, device=request.device),
        given=None if given is None else given.vehicles,
        classes=classes,
    )


def track_video(
    job: VideoJob,
    warn: Warn,
    *,
    go_on: Callable[[VideoRun, SourceFrame | None], bool] = lambda run, frame: True,  # noqa: ARG005 - to the end
    smoothing: Callable[[VideoRun], None] = lambda run: None,  # noqa: ARG005 - of interest to progress alone
    window_graph: bool = False,
    estimated: bool = True,
) -> VideoRun:
    """Look at the frames, follow the vehicles, and smooth the estimates of each when it has gone.

    Args:
        go_on: Called after each frame, as that of `fgrecon.video.run_video`.
        smoothing: Called when the vehicles that have not gone are smoothed next.
        window_graph: Whether frames keep the factor graph of the tracker's window, for a viewer.
        estimated: Whether a frame has estimates when `go_on` is called; else those alone that know what came after
            it, once its vehicles have gone, which takes less time. Online it always has.

    Raises:
        InvalidInputError: The folder holds another run.
    """
    request, given = job.request, job.given
    arguments = job.settings.arguments()
    ground = arguments.pop("ground")
    tracker = SingleImageTracker(**arguments) if request.alone else Tracker(**arguments, shared_ground=request.together)
    gone: list[int] = []
    ids: dict[str, Any] = {} if given is None else {"settings": given.association, "first": given.largest_id + 1}
    follower = Follower(
        *(tracker, GatedAssociation(**ids, given_up=gone.append), job.camera),
        ground=ground,
        path=CameraPath(job.poses, moving=job.moving),
        window_graph=tracker.window_graph if isinstance(tracker, Tracker) and window_graph else None,
        sense=job.sense,
        estimated=estimated or request.online or request.alone,
    )
    with warnings.catch_warnings(), summed_up(), _threads_beside_solving(0 if request.max_delay else 1):
        warnings.simplefilter("ignore", UncoveredFramesWarning)  # said below
        run = run_video(
            job.source,
            _detector(request, job.settings, given),
            follower,
            request.out,
            settings=job.records_depend_on,
            motion=MotionEstimator(job.camera, ground) if job.moving and ground is not None else None,
            online=True if request.max_delay is None else LiveFrames(request.max_delay),
            go_on=_settling(job, follower, gone, go_on),
        )
    if not (request.online or request.alone):
        smoothing(run)
        with rare_collections():
            run.smooth(follower)
    if isinstance(tracker, Tracker) and (off := tracker.boxes_off()) is not None:
        warn(boxes_warning(off))
    for line in run.warnings + _frame_warnings(run, alone=request.alone) + _keypoint_warnings(job, run):
        warn(line)
    return run


def _settling(
    job: VideoJob, follower: Follower, gone: list[int], go_on: Callable[[VideoRun, SourceFrame | None], bool]
) -> Callable[[VideoRun, SourceFrame | None], bool]:
    """The same to be called after each frame; vehicles that have gone for good are smoothed, and forgotten.

    Args:
        gone: Ids of those that have gone; it is emptied. Given ids go with their last frame.
    """
    ends = deque(({} if job.given is None else job.given.ends).items())
    tracker, online = follower.tracker, job.request.online

    def each(run: VideoRun, frame: SourceFrame | None) -> bool:
        while ends and ends[0][1] <= run.frames.heads[-1].number:
            gone.append(ends.popleft()[0])
        while gone:
            identity = gone.pop()
            if isinstance(tracker, Tracker) and not online:
                run.put(follower, identity, tracker.smooth([identity]).get(identity, ()))
            if isinstance(tracker, Tracker | SingleImageTracker):
                tracker.forget(identity)
        return go_on(run, frame)

    return each


@contextmanager
def _threads_beside_solving(cores: int) -> Iterator[None]:
    """Within it networks that are made, and OpenCV, leave so many of the free cores to the solver."""
    import cv2

    threads, before = max(1, threads_of_networks() - cores), cv2.getNumThreads()
    cv2.setNumThreads(min(before, threads))
    try:
        with at_most(threads):
            yield
    finally:
        cv2.setNumThreads(before)


def _sense(
    request: VideoRequest, source: FrameSource, drive: Drive | BagDrive | None
) -> Callable[[FrameRecord], Sequence[Evidence]] | None:
    """What other sensors say of a frame, by its record; None where there are none."""
    sensors = request.sensors
    if sensors is None:
        return None
    if isinstance(sensors, LidarTopic):
        assert isinstance(drive, BagDrive)
        by_file = request.poses is not None and request.poses.exists()
        wanted = None if request.poses is None or by_file else str(request.poses)
        clouds = drive.clouds(sensors, wanted)
        return lambda record: clouds.evidence(record.number)
    if isinstance(source, ImageFrames):
        sensors.check(path.name for path in source.paths)

    def of_files(record: FrameRecord) -> Sequence[Evidence]:
        path = Path(record.name)
        if isinstance(source, ImageFrames):
            path = source.paths[source.numbers.index(record.number)]
        elif not isinstance(source, NumberedFrames):
            path = Path(str(record.number))
        return sensors.evidence(path)

    return of_files


def _frame_warnings(run: VideoRun, *, alone: bool) -> list[str]:
    """What to warn of frames that could not be used, and of the times of all."""
    found = []
    if run.gaps:
        first = next(iter(run.gaps.values()))
        found.append(f"{counted(len(run.gaps), 'frame')} could not be used, the first: {first}")
    interval = interval_warning([head.time for head in run.frames.heads])
    return found + ([] if interval is None or alone else [interval])


def _keypoint_warnings(job: VideoJob, run: VideoRun) -> list[str]:
    """What to warn of keypoints that were given, and of the camera."""
    warnings, given = InputWarnings(), job.given is not None and job.given.complete
    if not given:  # boxes at most, in which the network has detected them
        warnings.add(job.request.source, camera_warning_of(job.camera))
    for frame in run.frames if given or job.sense is not None else ():
        for identity, observation in frame.observations.items():
            name = f"{identity} in {frame.name}"
            if given:
                warnings.add(name, input_warning_of(observation, job.camera))
            if (estimate := frame.estimates.get(identity)) is not None:
                warnings.add_result(name, observation, estimate.reconstruction, str(identity))
    return warnings.lines()


def write_tracks(job: VideoJob, run: VideoRun) -> None:
    """Write tables and frames into the folder of the results, each file whole."""
    out, ground = job.request.out, job.settings.ground
    names = [out / "tracks.csv", out / "tracks.parquet"]
    with ExitStack() as files:
        tracks, lines = (files.enter_context(text_file(out / name)) for name in ("tracks.txt", "frames.jsonl"))
        tables = [files.enter_context(table_file(name)) for name in names if run.estimates]
        for frame in run.frames:
            tracks(tracking_text([frame], job.label_offset))
            lines("".join(frame_lines([frame], ground)))
            if tables:
                rows = rows_of([frame])
                for add, some in zip(tables, (flattened(rows), rows), strict=True):
                    add(some)
    if not run.estimates:  # no columns without a row, and a table of the run before would be taken for this one's
        for name in names:
            name.unlink(missing_ok=True)
