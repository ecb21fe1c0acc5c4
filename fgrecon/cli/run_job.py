"""What `fgrecon run` is asked for, read and checked before the work."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.batch.parts import refuse_batch
from fgrecon.cli.common import about_camera, check_folder
from fgrecon.cli.options import SceneOptions
from fgrecon.cli.run_options import FrameOptions, MotionOptions
from fgrecon.cli.settings import CameraSource, Settings, content_hash
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import DEFAULT_FIELD_OF_VIEW, Camera
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.core.text import counted
from fgrecon.io.frames import (
    DEFAULT_RATE,
    FrameSource,
    ImageFrames,
    NumberedFrames,
    VideoFrames,
    numbered_frames,
    open_frames,
)
from fgrecon.io.images import read_photograph
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.poses import CameraPoses, read_poses
from fgrecon.io.video import check_video
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.video import FrameDetector, read_given
from fgrecon.video.focal import estimate_camera
from fgrecon.video.given import Given

__all__ = ["Job", "Request", "prepare"]


@dataclass(frozen=True)
class Request:
    """What the command line asks for; the fields are its options."""

    source: str
    out: Path
    frames: FrameOptions
    motion: MotionOptions
    camera: CameraSource
    scene: SceneOptions
    tracks: Path | None
    forget_ids: bool
    box_model: BoxModel | None
    weights: Path | None
    online: bool
    alone: bool
    together: bool
    video: Path | None
    picture: Path | None
    picture_frame: int | None


@dataclass(frozen=True)
class Job:
    """What is to be done, all of it checked.

    Attributes:
        request: What was asked for.
        source: The frames.
        camera: Their camera.
        label_offset: (3,) of KITTI's labels in its frame, or None.
        settings: What holds for every vehicle.
        given: Vehicles found by others, or None.
        poses: Of the camera, or None.
        moving: Whether the camera's motion is estimated.
    """

    request: Request
    source: FrameSource
    camera: Camera
    label_offset: NDArray[np.float64] | None
    settings: Settings
    given: Given | None
    poses: CameraPoses | None
    moving: bool

    @cached_property
    def records_depend_on(self) -> dict[str, Any]:
        """What the stored records depend on: priors and options may change, and networks need not look again."""
        ask = self.request
        files = {"source": Path(ask.source), "tracks": ask.tracks, "weights": ask.weights}
        return {
            **{name: None if path is None else _place(path) for name, path in files.items()},
            **{f"{name}_sha256": content_hash(path) for name, path in files.items()},
            "fps": DEFAULT_RATE if self.source.assumed_rate else ask.frames.fps,
            "every": ask.frames.every,
            "start": ask.frames.start,
            "end": ask.frames.end,
            "category": self.settings.prior.category.name,
            "forget_ids": ask.forget_ids,
        }

    @property
    def look(self) -> FrameDetector:
        """What looks at the frames."""
        return _look(self.request, self.settings, self.given)


def _place(path: Path) -> str:
    """Where something is; a pattern of files, or the name of shipped weights, as it is."""
    return str(path.resolve() if path.exists() else path)


def prepare(ask: Request, screen: Screen) -> Job:
    """Read what is asked for and refuse what cannot be done, before the work.

    Raises:
        InvalidInputError: Something cannot be used; names it.
        MissingPackageError: A package for videos is not installed.
    """
    check_folder(ask.out)
    refuse_batch(ask.out)
    if ask.video is not None:
        check_video(ask.video)
    if ask.picture is None and ask.picture_frame is not None:
        raise InvalidInputError("picture_frame", "without --picture", "Say with --picture where it is to be written.")
    motion = ask.motion
    settings = ask.scene.settings(Options(strategy=ask.scene.strategy, keep_history=False))
    if settings.ground is not None and settings.ground.is_vague:
        fix = "Give the plane, NX,NY,NZ,D, or leave it out: vehicles are told apart by where they stand."
        raise InvalidInputError("ground", ask.scene.ground, fix)
    source, given = _source(ask, settings)
    if source.assumed_rate:
        screen.warn(f"No --fps is given: {DEFAULT_RATE:g} frames per second are assumed; speeds go with it.")
    source_has = BoxModel.DETECTED if given is None else BoxModel.CUBOID if given.cuboids else BoxModel.SURFACE
    model = ask.box_model or source_has
    settings = replace(settings, options=replace(settings.options, box=replace(settings.options.box, model=model)))
    moving = _moving(ask, source, settings)
    if ask.picture_frame is not None and not _may_have(source, ask.picture_frame):
        raise InvalidInputError("picture_frame", ask.picture_frame, "Give the number of one of the frames.")
    poses = None if motion.poses is None else read_poses(motion.poses)
    camera, offset = _camera(ask, source, given, settings, screen)
    return Job(ask, source, camera, offset, settings, given, poses, moving)


def _may_have(source: FrameSource, number: int) -> bool:
    """Whether there can be a frame of this number; what a video's head tells may be a frame too few."""
    if not isinstance(source, VideoFrames):
        return number in source.numbers
    every, starts = source.choice.every, source.choice.start == 0.0
    last = source.count * every if starts and source.count is not None else number
    return 0 <= number <= last and number % every == 0


def _moving(ask: Request, source: FrameSource, settings: Settings) -> bool:
    """Whether the camera's motion is estimated: where it makes results better, if nothing is said."""
    motion, images = ask.motion, not isinstance(source, NumberedFrames)
    if motion.estimate_motion is None:
        return images and not ask.alone and motion.poses is None and settings.ground is not None
    if motion.estimate_motion:
        if not images:
            raise InvalidInputError("estimate_motion", ask.source, "Give images: keypoints alone have none.")
        if motion.poses is not None:
            raise InvalidInputError("poses", str(motion.poses), "Give either --poses or --estimate-motion.")
        if settings.ground is None:
            fix = "Give --camera-height or --ground: the ground tells how far the camera goes."
            raise InvalidInputError("estimate_motion", "no ground", fix)
    return motion.estimate_motion


def _source(ask: Request, settings: Settings) -> tuple[FrameSource, Given | None]:
    """The frames, and the vehicles that others have found, beside the images or in their place."""
    path, category, frames = Path(ask.source), settings.prior.category, ask.frames
    choice: dict[str, Any] = {"rate": frames.fps, "every": frames.every, "start": frames.start, "end": frames.end}
    if path.suffix.lower() == ".json":
        if ask.tracks is not None:
            raise InvalidInputError("tracks", str(ask.tracks), "Leave it out: keypoints are given already.")
        given = read_given(path, category, forget_ids=ask.forget_ids)
        if ask.video is not None:
            raise InvalidInputError("video", ask.source, "Give images: keypoints alone have none.")
        return numbered_frames(path, given.vehicles, times=given.times, **choice), given
    if ask.forget_ids and ask.tracks is None:
        raise InvalidInputError("forget_ids", value=True, fix="Give --tracks as well, or leave it out.")
    source = open_frames(ask.source, **choice)
    if ask.tracks is None:
        return source, None
    return source, read_given(ask.tracks, category, forget_ids=ask.forget_ids, source=source)


def _camera(
    ask: Request, source: FrameSource, given: Given | None, settings: Settings, screen: Screen
) -> tuple[Camera, NDArray[np.float64] | None]:
    """The camera, with the size of the first image that can be read, and the offset of KITTI's labels."""
    frame = next((frame for frame in source.read() if frame.image is not None), None)
    image = None if frame is None else frame.image
    if image is None and (given is None or not given.complete):
        raise InvalidInputError("source", ask.source, "Give frames of which at least one can be read.")
    camera, offset = ask.camera.camera(source.first_file.name)
    if camera is None and given is not None:
        camera = given.camera
    if camera is None and (beside := calibration_beside(source.first_file)) is not None:
        camera, offset = beside.camera, beside.label_offset
    size = None if image is None else (image.shape[1], image.shape[0])
    whole = None if camera is not None or size is None else ask.camera.whole(size)
    if whole is not None and frame is not None and isinstance(source, ImageFrames):
        file = source.paths[source.numbers.index(frame.number)]
        camera = read_photograph(file, whole)[1]  # by its EXIF data
    told = camera is not None
    if camera is None and whole is not None:
        camera = Camera.of_unknown(*whole)
    if camera is None:
        raise InvalidInputError("camera", "none", "Give --camera or --intrinsics.")
    camera = ask.camera.complete(camera, declared=False)
    if size is not None:
        camera = replace(camera, image_size=size)
    if not told:
        camera = _found(ask, source, given, settings, camera, screen)
    return replace(camera, focal_sigma=0.0), offset  # one focal length for all frames


def _found(
    ask: Request, source: FrameSource, given: Given | None, settings: Settings, unknown: Camera, screen: Screen
) -> Camera:
    """The camera that the vehicles of some frames tell, or one with a usual field of view."""
    arguments = {"prior": settings.prior, "size_prior": settings.size_prior, "options": settings.options}
    found = estimate_camera(source, _look(ask, settings, given), unknown, ground=settings.ground, **arguments)
    if found is None:
        screen.warn(
            f"No camera is given, and no car tells: a horizontal field of view of {DEFAULT_FIELD_OF_VIEW:g} degrees is "
            "assumed, and distances are rough. Give --camera or --intrinsics."
        )
        return unknown
    screen.warn(
        about_camera(found.camera, None, f"{counted(found.vehicles, 'car')} of {counted(found.images, 'frame')}")
    )
    return found.camera


def _look(ask: Request, settings: Settings, given: Given | None) -> FrameDetector:
    """What looks at the frames."""
    return FrameDetector(
        settings.prior.category,
        vehicle_detector=NanodetVehicleDetector() if given is None else None,
        keypoint_detector=None if given is not None and given.complete else KeypointCascade(ask.weights),
        given=None if given is None else given.vehicles,
    )
