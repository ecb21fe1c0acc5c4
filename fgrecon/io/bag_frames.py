"""The pictures of a bag's topic as frames: numbered by their messages, at the times of their headers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.bag import Bag
from fgrecon.io.bag_images import FILMS, BagPicture, codec_of, film, still
from fgrecon.io.source_frames import SourceFrame, sized


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
