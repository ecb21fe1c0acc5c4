"""The pictures of a bag's topic as frames: raw, compressed one by one, or as a film (H.264 and others, by PyAV).

They are numbered by their messages, at the times of their headers.

| type | content |
|---|---|
| `sensor_msgs/msg/Image` | rows of `step` bytes: grey, RGB, BGR, with alpha or without, Bayer, YUV 4:2:2, NV12 |
| `sensor_msgs/msg/CompressedImage` | JPEG or PNG; a film where its `format` is that of one |
| `foxglove_msgs/msg/CompressedVideo`, `ffmpeg_image_transport_msgs/msg/FFMPEGPacket` | a film |
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.bag import Bag
from fgrecon.io.source_frames import SourceFrame, sized

Pixels = NDArray[np.uint8]

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
FILMS = ("foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket")
PICTURES = (RAW, COMPRESSED, *FILMS)
"""Types of messages that hold a picture."""

_CODECS = {"h264": "h264", "libx264": "h264", "avc": "h264", "h265": "hevc", "hevc": "hevc", "libx265": "hevc"} | {
    "av1": "av1",
    "vp9": "vp9",
}
_PLAIN = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "8UC4": 4, "mono16": 2}
_PLAIN |= {"16UC1": 2}
"""Bytes of a pixel by encoding; without a name of colours OpenCV's order, BGR, is meant, as in cv_bridge."""
_YUV = {"uyvy": "UYVY", "yuv422": "UYVY", "yuyv": "YUY2", "yuv422_yuy2": "YUY2"}
_BAYER = {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}
"""ROS names the upper left pixels, OpenCV those of the second row and column."""


@dataclass(frozen=True, eq=False)
class BagPicture:
    """A picture of a topic."""

    place: int  # of its message in the topic, from 0
    image: Pixels | None  # (H, W, 3) RGB bytes; None where there is none
    problem: str | None = None  # why not, or None


def codec_of(message: Any) -> str | None:
    """FFmpeg's name of a message's codec; None where it is a picture by itself."""
    name = str(getattr(message, "format", "") or getattr(message, "encoding", "")).lower()
    return next((codec for part in name.replace(";", " ").split() if (codec := _CODECS.get(part))), None)


def still(message: Any, where: str) -> Pixels:
    """The picture (H, W, 3) RGB of a message that holds one by itself.

    Args:
        message: Of `Image` or `CompressedImage`.
    """
    if hasattr(message, "encoding"):
        return _raw(message, where)
    import cv2

    content = np.asarray(message.data, dtype=np.uint8)
    if "compresseddepth" in str(message.format).lower():
        raise InvalidInputError(f"{where}format", message.format, "Name a topic of pictures: this one has depths.")
    found = cv2.imdecode(content, cv2.IMREAD_COLOR) if len(content) else None
    if found is None:
        raise InvalidInputError(f"{where}data", message.format, "Give JPEG or PNG.")
    return np.ascontiguousarray(found[..., ::-1], dtype=np.uint8)


def _raw(message: Any, where: str) -> Pixels:
    """The picture of an `Image`; its rows may be longer than their pixels."""
    import cv2

    encoding, height, width, step = message.encoding, message.height, message.width, message.step
    content = np.asarray(message.data, dtype=np.uint8)
    bayer = encoding.removeprefix("bayer_").removesuffix("8").removesuffix("16") if "bayer" in encoding else ""
    deep = 2 if bayer and encoding.endswith("16") else 1
    rows = height * 3 // 2 if encoding in ("nv12", "nv21") else height
    size = deep if bayer else 2 if encoding in _YUV else 1 if rows != height else _PLAIN.get(encoding, 0)
    if not size or (bayer and bayer not in _BAYER):
        fix = "Name a topic of pictures: grey, RGB, BGR, Bayer, YUV 4:2:2, NV12 or NV21."
        raise InvalidInputError(f"{where}encoding", encoding, fix)
    if min(height, width) < 1 or step < width * size or len(content) < (rows - 1) * step + width * size:
        value = f"{len(content)} bytes, {width} x {height} pixels, step {step}"
        raise InvalidInputError(f"{where}data", value, f"Give all rows: {size} bytes a pixel, `step` bytes a row.")
    whole = np.zeros(rows * step, dtype=np.uint8)
    whole[: min(len(content), len(whole))] = content[: len(whole)]
    table = whole.reshape(rows, step)[:, : width * size]
    if deep == 2 or encoding in ("mono16", "16UC1"):
        table = table[:, int(not message.is_bigendian) :: 2]  # the higher byte
    pixels = np.ascontiguousarray(table)
    if bayer:
        found = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_Bayer{_BAYER[bayer]}2RGB"))
    elif encoding in _YUV:
        found = cv2.cvtColor(pixels.reshape(height, width, 2), getattr(cv2, f"COLOR_YUV2RGB_{_YUV[encoding]}"))
    elif rows != height:
        found = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_YUV2RGB_{encoding.upper()}"))
    elif size in (1, 2):
        found = np.repeat(pixels[..., None], 3, axis=2)
    else:
        found = pixels.reshape(height, width, size)[..., :3]
        found = found if encoding.startswith("rgb") else found[..., ::-1]
    return np.ascontiguousarray(found, dtype=np.uint8)


def film(messages: Iterable[Any], codec: str, where: str) -> Iterator[BagPicture]:
    """The pictures of a film, a message each, in order; messages before the first whole one have none.

    Raises:
        MissingPackageError: PyAV is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise MissingPackageError("av>=14", "Reading a film of a bag") from error
    decoder: Any = av.CodecContext.create(codec, "r")
    waiting: list[BagPicture] = []  # messages whose pictures have not come yet

    def come(pictures: Iterable[Any]) -> Iterator[BagPicture]:
        for picture in pictures:
            while waiting and waiting[0].place < picture.pts:
                yield waiting.pop(0)
            if waiting and waiting[0].place == picture.pts:
                waiting.pop(0)
                yield BagPicture(picture.pts, picture.to_ndarray(format="rgb24"))

    for place, message in enumerate(messages):
        packet: Any = av.Packet(bytes(np.asarray(message.data, dtype=np.uint8)))
        packet.pts = packet.dts = place
        waiting.append(BagPicture(place, None, f"{where}message {place}: no picture of {codec}"))
        try:
            yield from come(decoder.decode(packet))
        except av.error.FFmpegError as error:
            waiting[-1] = BagPicture(place, None, f"{where}message {place}: {error.strerror}")
    with suppress(av.error.FFmpegError):  # the rest has no pictures
        yield from come(decoder.decode(None))
    yield from waiting


@dataclass(frozen=True, eq=False)
class BagFrames:
    """A topic's pictures."""

    bag: Bag
    topic: str
    numbers: tuple[int, ...]  # of the messages that are taken, from 0
    times: tuple[float, ...]  # of each, seconds
    assumed_rate: bool = False

    @property
    def first_file(self) -> Path:
        """The bag."""
        return self.bag.path

    @property
    def count(self) -> int:
        """How many are taken."""
        return len(self.numbers)

    def name(self, number: int) -> str:
        """What a frame is called."""
        return f"{self.bag.path.name}#{number}"

    def read(self, after: int | None = None) -> Iterator[SourceFrame]:
        """The frames in order, from the first with a number above `after`; those of another size are gaps."""
        times = dict(zip(self.numbers, self.times, strict=True))
        size: tuple[int, ...] | None = None
        for picture in self._pictures(times, after):
            if picture.place not in times:
                continue
            size = picture.image.shape if size is None and picture.image is not None else size
            if after is None or picture.place > after:
                name, time = self.name(picture.place), times[picture.place]
                frame = SourceFrame(picture.place, time, name, picture.image, picture.problem)
                yield sized(frame, size, f"{self.bag.path.name}: {self.topic}: message {picture.place}")

    def _pictures(self, times: dict[int, float], after: int | None) -> Iterator[BagPicture]:
        """The pictures that are needed: of a film all, of others those that are taken, and the first."""
        where, last = f"{self.bag.path}: {self.topic}: ", self.numbers[-1]
        contents = (content for _, _, content in self.bag.messages([self.topic]))
        films = self.bag.topics[self.topic] in FILMS
        first = next(contents)
        codec = codec_of(self._message(first, films=films))
        if films and codec is None:
            raise InvalidInputError(f"{where}format", "no codec that is known", "Give H.264, H.265, VP9 or AV1.")
        if codec is not None:
            messages = (self.bag.message(self.topic, one) for one in chain([first], contents))
            for picture in film(messages, codec, where):
                if picture.place > last:
                    return
                yield picture
            return
        sized_yet = False
        for place, content in enumerate(chain([first], contents)):
            if place > last:
                return
            if place in times and (after is None or place > after or not sized_yet):
                picture = self._still(place, content, where)
                sized_yet = sized_yet or picture.image is not None
                yield picture

    def _message(self, content: bytes, *, films: bool) -> Any:
        """The first message; one that is none is no film."""
        try:
            return self.bag.message(self.topic, content)
        except InvalidInputError:
            if films:
                raise
            return None

    def _still(self, place: int, content: bytes, where: str) -> BagPicture:
        try:
            return BagPicture(place, still(self.bag.message(self.topic, content), where))
        except InvalidInputError as error:
            return BagPicture(place, None, str(error))
