"""Video, picture and recording of tracked frames, read once more, with the estimates drawn into them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from queue import Queue
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import transform
from fgrecon.core.result_fields import Status
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.frames import FrameSource
from fgrecon.io.video_frames import write_video
from fgrecon.video.follow import TrackedFrame
from fgrecon.video.frame_store import FrameStore
from fgrecon.video.rows import motion_of
from fgrecon.viz.describe import SIGMAS, state_in_words
from fgrecon.viz.entities import SIZES
from fgrecon.viz.overlay import annotated
from fgrecon.viz.picture import save_picture
from fgrecon.viz.scene_picture import scene_picture
from fgrecon.viz.subjects import DrawnVehicle, RecordedFrame, detection_words

Advance = Callable[[str, int, int | None], None]
"""Called with what is being done, how much of it is done, and how much there is."""

Image = NDArray[np.uint8]

_AHEAD = 2  # frames that wait to be drawn, while others come
_RATE = 10.0  # for players; the frames have times of their own
_TRAIL = 100  # frames that a vehicle's path is drawn
_STANDING = 1.0  # m/s: to so much the speed of what stands is worth writing


class Showing:
    """Turns tracked frames, in order, into what is drawn of them."""

    def __init__(self, *, beside_table: bool = False) -> None:
        """Nothing was shown yet; a table beside it may have distances and what became of each vehicle."""
        self._beside_table = beside_table
        self._trails: dict[int, list[Array]] = {}  # where each vehicle was, in the world
        self._seen: set[int] = set()

    def vehicles(self, frame: TrackedFrame) -> tuple[DrawnVehicle, ...]:
        """The vehicles of a frame as they are drawn."""
        shown = []
        for identity, box in frame.boxes.items():
            estimate = frame.estimates.get(identity)
            detection = detection_words(frame.kinds.get(identity), frame.scores.get(identity))
            if estimate is None:
                shown.append(DrawnVehicle(identity, box, detection=detection))
                continue
            trail = None if frame.world_T_camera is None else self._trail(estimate, frame.world_T_camera)
            words = self._words(estimate)
            shown.append(DrawnVehicle(identity, box, estimate.reconstruction, words, trail, detection=detection))
        return tuple(shown)

    def _trail(self, estimate: VehicleEstimate, world_T_camera: Array) -> Array | None:
        """(T, 3) where a vehicle was as far as that is known, in the camera's frame."""
        places = self._trails.setdefault(estimate.id, [])
        if estimate.world_T_object is not None and estimate.reconstruction.status.determined:
            places.append(estimate.world_T_object[:3, 3])
            del places[:-_TRAIL]
        return transform(np.linalg.inv(world_T_camera).astype(np.float64), np.array(places)) if places else None

    def _words(self, estimate: VehicleEstimate) -> str:
        """Distance and speed, or that there is neither."""
        result, words = estimate.reconstruction, []
        if not result.status.determined:
            return "" if self._beside_table else result.status.value
        if not self._beside_table:
            words.append(f"{np.linalg.norm(result.location):.0f} m")
        speed, sigma = estimate.speed, estimate.speed_sigma or 0.0
        moves = estimate.world_T_object is not None and result.status is not Status.AMBIGUOUS
        if speed is not None and moves:  # from the camera alone it means little, and of another pose it is another one
            words += [f"{3.6 * speed:.0f} km/h"] if 2.0 * sigma <= max(speed, 2.0 * _STANDING) else []
        return ", ".join(words)

    def frame(self, frame: TrackedFrame, image: NDArray[np.uint8] | None) -> RecordedFrame:
        """A frame as it is recorded."""
        states: dict[int, str | None] = dict.fromkeys(self._seen - set(frame.boxes))
        states |= {identity: _state(frame.estimates.get(identity)) for identity in frame.boxes}
        self._seen = set(frame.boxes)
        return RecordedFrame(
            number=frame.number,
            time=frame.time,
            image=image,
            vehicles=self.vehicles(frame),
            world_T_camera=frame.world_T_camera,
            problem=frame.problem,
            values={identity: values_of(estimate) for identity, estimate in frame.estimates.items()},
            states=states,
            window=frame.window,
        )


def film(path: Path, source: FrameSource, frames: FrameStore, camera: Camera, advance: Advance) -> Path:
    """Write the annotated video, whole or not at all; frames that could not be used are left out.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    with write_video(path, rate=_rate([head.time for head in frames.heads])) as add:
        for frame, image in _drawn(_with_images(source, frames, advance, "Filming"), camera):
            add(image, frame.time)
    return path


def _rate(times: Sequence[float]) -> float:
    """Frames a second, by their times."""
    passed = np.diff(times)
    return 1.0 / float(np.median(passed)) if len(passed) and np.median(passed) > 0 else _RATE


def _drawn(frames: Iterable[tuple[TrackedFrame, Image | None]], camera: Camera) -> Iterator[tuple[TrackedFrame, Image]]:
    """The frames of a video with what is drawn into them; those that could not be used are left out."""
    showing, size = Showing(), None
    for frame, image in frames:
        if image is None or frame.problem is not None:
            continue
        size = image.shape if size is None else size
        if image.shape == size:  # videos may change it on their way
            caption = f"frame {frame.number}, {frame.time:.2f} s"
            yield frame, annotated(image, showing.vehicles(frame), camera, caption=caption)


class LiveFilm:
    """The annotated video of frames whose estimates stay as they come: drawn and encoded meanwhile, beside the caller.

    Attributes:
        finished: Whether it is written, whole.
    """

    def __init__(self, path: Path, camera: Camera) -> None:
        """Begin with the first frame."""
        self.finished = False
        self._path, self._camera = path, camera
        self._frames: Queue[tuple[TrackedFrame, Image] | None] = Queue(_AHEAD)
        self._thread = Thread(target=self._write, daemon=True)
        self._whole = True
        self._error: Exception | None = None

    def add(self, frame: TrackedFrame, image: Image | None, *, read: bool = True) -> None:
        """Take the next frame; where its image was not `read`, there will be no film."""
        self._whole &= read
        if not self._whole or image is None or frame.problem is not None:
            return
        if self._thread.ident is None:
            self._thread.start()
        self._frames.put((frame, image))

    def end(self, *, whole: bool) -> None:
        """End it; there is none where it is not the whole one, or had no frame.

        Raises:
            InvalidInputError: The file cannot be written.
        """
        self._whole &= whole
        if self._thread.is_alive():
            self._frames.put(None)
            self._thread.join()
            if self._error is not None and self._whole:
                raise self._error
            self.finished = self._whole

    def _write(self) -> None:
        frames = iter(self._frames.get, None)
        first = list(islice(frames, 2))
        try:
            with suppress(_Left), write_video(self._path, rate=_rate([frame.time for frame, _ in first])) as add:
                for frame, image in _drawn(chain(first, frames if len(first) == 2 else ()), self._camera):
                    add(image, frame.time)
                if not self._whole:
                    raise _Left
        except Exception as error:  # noqa: BLE001 - raised by `end`
            self._error = error
            for _ in frames:  # whoever adds must not wait
                pass


class _Left(Exception):  # noqa: N818 - no error
    """A film is not to be written."""


def still(
    path: Path,
    source: FrameSource,
    frames: FrameStore,
    camera: Camera,
    ground: Ground | None,
    number: int | None,
) -> bool:
    """Draw a frame as `fgrecon.viz.scene_picture` does, with the paths of its vehicles up to it.

    Args:
        path: File to write.
        source: The frames' images.
        frames: What was estimated in them.
        ground: The ground plane, or None.
        number: Which frame; None for the first of those with the most estimates.

    Returns:
        Whether there is a vehicle in it; nothing is written where there is none.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    if number is None and frames:
        number = max(frames.heads, key=lambda head: (len(head.found), len(head.identities))).number
    showing = Showing(beside_table=True)
    for frame in frames:
        vehicles = showing.vehicles(frame)
        if frame.number == number and vehicles:
            picture = next((p for p in source.read(number - 1) if p.number == number), None)
            image = None if picture is None else picture.image
            save_picture(path, scene_picture(image, vehicles, camera, ground=ground))
            return True
    return False


def recorded(source: FrameSource, frames: FrameStore, advance: Advance) -> Iterator[RecordedFrame]:
    """The frames as they are recorded, read once more."""
    showing = Showing()
    for frame, image in _with_images(source, frames, advance, "Recording"):
        yield showing.frame(frame, image)


def _with_images(
    source: FrameSource, frames: FrameStore, advance: Advance, doing: str
) -> Iterator[tuple[TrackedFrame, NDArray[np.uint8] | None]]:
    """The frames with their images, which are read once more."""
    index = {head.number: i for i, head in enumerate(frames.heads)}
    for done, picture in enumerate(source.read(), start=1):
        if not frames.heads or picture.number > frames.heads[-1].number:  # of a run that was stopped
            break
        advance(doing, done, len(frames))
        if picture.number in index:
            yield frames[index[picture.number]], picture.image


def values_of(estimate: VehicleEstimate) -> dict[str, tuple[float, ...]]:
    """What is plotted of a vehicle: numbers, those of yaw, speed and size with their bands of 95 %.

    Nothing where it has no pose.
    """
    result = estimate.reconstruction
    if not result.status.determined:
        return {}
    sizes, sigma = result.uncertainty.size_covariance, result.heading_sigma
    spreads = np.full(3, np.nan) if sizes is None else np.sqrt(np.diag(sizes))
    motion = motion_of(estimate)
    del motion["speed_sigma"]  # the band of the speed
    known = {name: (value,) for name, value in motion.items() if value is not None}
    return {
        "yaw": _band(np.degrees(result.rotation_y), None if sigma is None else np.degrees(sigma)),
        **{name: _band(*pair) for name, *pair in zip(SIZES, result.box_size, spreads, strict=True)},
        "distance": (float(np.linalg.norm(result.location)),),
        **known,
        **({} if estimate.speed is None else {"speed": _band(estimate.speed, estimate.speed_sigma)}),
    }


def _band(value: float, sigma: float | None) -> tuple[float, ...]:
    """A value with its band of 95 %, which is NaN where that is not known."""
    sigma = np.nan if sigma is None else sigma
    return (float(value), float(value - SIGMAS * sigma), float(value + SIGMAS * sigma))


def _state(estimate: VehicleEstimate | None) -> str:
    """Status, and whether the camera is ahead of the vehicle or behind it."""
    if estimate is None:
        return "refused"
    return state_in_words(estimate.reconstruction.status.value, estimate.reconstruction.camera_T_object)
