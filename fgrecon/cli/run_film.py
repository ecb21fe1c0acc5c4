"""Video, picture and recording of `fgrecon run`: frames once more, with the estimates drawn into them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli.progress import Advance
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import transform
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.frames import FrameSource
from fgrecon.io.video import write_video
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.rows import motion_of
from fgrecon.viz import save_picture, scene_picture
from fgrecon.viz.overlay import Shown, annotated
from fgrecon.viz.overview import state_in_words
from fgrecon.viz.video_recording import ShownFrame

__all__ = ["Showing", "film", "recorded", "still"]

_RATE = 10.0  # told to players; the frames have times of their own
_TRAIL = 100  # frames that a vehicle's path is drawn


class Showing:
    """Turns tracked frames, in order, into what is drawn of them."""

    def __init__(self) -> None:
        """Nothing was shown yet."""
        self._trails: dict[int, list[NDArray[np.float64]]] = {}  # where each vehicle was, in the world
        self._seen: set[int] = set()

    def vehicles(self, frame: TrackedFrame) -> tuple[Shown, ...]:
        """The vehicles of a frame as they are drawn."""
        shown = []
        for identity, box in frame.boxes.items():
            estimate = frame.estimates.get(identity)
            if estimate is None:
                shown.append(Shown(identity, box))
                continue
            in_world, trail = estimate.world_T_object, None
            if in_world is not None and frame.world_T_camera is not None:
                places = self._trails.setdefault(identity, [])
                places.append(in_world[:3, 3])
                del places[:-_TRAIL]
                trail = transform(np.linalg.inv(frame.world_T_camera).astype(np.float64), np.array(places))
            shown.append(Shown(identity, box, estimate.reconstruction, _words(estimate), trail))
        return tuple(shown)

    def frame(self, frame: TrackedFrame, image: NDArray[np.uint8] | None) -> ShownFrame:
        """A frame as it is recorded."""
        states: dict[int, str | None] = dict.fromkeys(self._seen - set(frame.boxes))
        states |= {identity: _state(frame.estimates.get(identity)) for identity in frame.boxes}
        self._seen = set(frame.boxes)
        return ShownFrame(
            number=frame.number,
            time=frame.time,
            image=image,
            vehicles=self.vehicles(frame),
            world_T_camera=frame.world_T_camera,
            problem=frame.problem,
            values={identity: _values(estimate) for identity, estimate in frame.estimates.items()},
            states=states,
        )


def film(path: Path, source: FrameSource, frames: Sequence[TrackedFrame], camera: Camera, advance: Advance) -> Path:
    """Write the annotated video, whole or not at all; frames that could not be used are left out.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    by_number = {frame.number: frame for frame in frames}
    showing = Showing()
    passed = [b.time - a.time for a, b in pairwise(frames)]
    rate = 1.0 / float(np.median(passed)) if passed and np.median(passed) > 0 else _RATE
    size: tuple[int, ...] | None = None
    with write_video(path, rate=rate) as add:
        for done, picture in enumerate(source.read(), start=1):
            advance("Video", done, len(frames))
            frame = by_number.get(picture.number)
            if picture.image is None or frame is None or frame.problem is not None:
                continue
            size = picture.image.shape if size is None else size
            if picture.image.shape != size:  # videos may change it on their way
                continue
            caption = f"frame {frame.number}, {frame.time:.2f} s"
            add(annotated(picture.image, showing.vehicles(frame), camera, caption=caption), frame.time)
    return path


def still(
    path: Path,
    source: FrameSource,
    frames: Sequence[TrackedFrame],
    camera: Camera,
    ground: Ground | None,
    number: int | None,
) -> bool:
    """Draw a frame as `fgrecon.viz.scene_picture` does, with the paths of its vehicles up to it.

    Args:
        path: File to write.
        source: The frames' images.
        frames: What was found in them.
        camera: Their camera.
        ground: The ground plane, or None.
        number: Which frame; None for the first of those with the most estimates.

    Returns:
        Whether there is a vehicle in it; nothing is written where there is none.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    if number is None and frames:
        number = max(frames, key=lambda frame: (len(frame.estimates), len(frame.boxes))).number
    showing = Showing()
    for frame in frames:
        vehicles = showing.vehicles(frame)
        if frame.number == number and vehicles:
            picture = next((p for p in source.read(number - 1) if p.number == number), None)
            image = None if picture is None else picture.image
            save_picture(path, scene_picture(image, vehicles, camera, ground=ground))
            return True
    return False


def recorded(source: FrameSource, frames: Sequence[TrackedFrame]) -> Iterator[ShownFrame]:
    """The frames as they are recorded, read once more."""
    by_number = {frame.number: frame for frame in frames}
    showing = Showing()
    for picture in source.read():
        if (frame := by_number.get(picture.number)) is not None:
            yield showing.frame(frame, picture.image)


def _values(estimate: VehicleEstimate) -> dict[str, tuple[float, ...]]:
    """What is plotted: the yaw with its band of 95 %, and numbers."""
    result = estimate.reconstruction
    yaw, covariance = float(np.degrees(result.rotation_y)), result.pose_covariance
    band = 0.0 if covariance is None else float(np.degrees(1.96 * np.sqrt(covariance[1, 1])))  # about the own y axis
    known = {name: (value,) for name, value in motion_of(estimate).items() if value is not None}
    length = float(result.box_size[0])
    return {
        "yaw": (yaw, yaw - band, yaw + band),
        "distance": (float(np.linalg.norm(result.location)),),
        "length": (length,),
        **known,
    }


def _state(estimate: VehicleEstimate | None) -> str:
    """Status, and whether the camera is ahead of the vehicle or behind it."""
    if estimate is None:
        return "refused"
    return state_in_words(estimate.reconstruction.status.value, estimate.reconstruction.camera_T_object)


def _words(estimate: VehicleEstimate) -> str:
    place = f"{np.linalg.norm(estimate.reconstruction.location):.0f} m"
    if estimate.speed is None or estimate.world_T_object is None:  # a speed seen from the camera tells nobody much
        return place
    return f"{place} {3.6 * estimate.speed:.0f} km/h"
