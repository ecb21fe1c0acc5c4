"""Bags of ROS 2 (and ROS 1): MCAP and SQLite files, and the folders of `ros2 bag record`; read by rosbags.

What is meant of a bag is one of its topics: `drive.mcap#/camera/image_raw`.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgrecon.core.errors import FgreconError, InvalidInputError, MissingPackageError

BAGS = (".mcap", ".db3", ".bag")
"""Endings of bags that are a file; a folder has `metadata.yaml`."""

NANO = 1_000_000_000

_FIX = "Give a whole bag of ROS 2: `mcap recover FILE` mends one whose end is missing, `ros2 bag reindex` a folder."


def is_bag(source: str | Path) -> bool:
    """Whether a path, with or without a topic behind it, is a bag."""
    path = split(source)[0]
    return (path.suffix.lower() in BAGS and path.is_file()) or (path / "metadata.yaml").is_file()


def split(source: str | Path) -> tuple[Path, str | None]:
    """Path and topic, None where none is named; a file may have the sign in its own name."""
    text, sign, topic = str(source).rpartition("#")
    return (Path(source), None) if not (sign and topic) or Path(source).exists() else (Path(text), topic)


@dataclass(frozen=True, eq=False)
class Bag:
    """A bag."""

    path: Path  # the file or folder
    topics: Mapping[str, str]  # the type of message of each topic, such as `sensor_msgs/msg/Image`
    types: Any  # what makes objects of messages: rosbags' typestore
    is_ros1: bool  # whether it is one of ROS 1

    def of_type(self, *types: str) -> tuple[str, ...]:
        """The topics of some types."""
        return tuple(topic for topic, kind in self.topics.items() if kind in types)

    def messages(self, topics: Collection[str], at: int | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of recording (nanoseconds) and content of messages, in order of these times.

        Args:
            topics: Which are read.
            at: The time of those that are read; None for all.

        Raises:
            InvalidInputError: The bag is damaged.
        """
        if not topics:
            return
        with _reader(self.path) as reader:
            chosen = [one for one in reader.connections if one.topic in topics]
            end = None if at is None else at + 1
            for one, time, content in reader.messages(chosen, start=at, stop=end):
                yield one.topic, time, bytes(content)

    def message(self, topic: str, content: bytes) -> Any:
        """A message as an object.

        Raises:
            InvalidInputError: It is none of the topic's type, or that is not known; names the topic.
        """
        kind = self.topics[topic]
        try:
            made = self.types.deserialize_ros1 if self.is_ros1 else self.types.deserialize_cdr
            return made(content, kind)
        except Exception as error:  # rosbags promises no kind of error for damaged content
            fix = f"Give whole messages of {kind}, with its definition. The reason: {error!r}"
            raise InvalidInputError(f"{self.path}: {topic}", "a message that is none", fix) from error

    def definition(self, kind: str) -> str:
        """The definition of a type of messages, with those that it is made of.

        Raises:
            InvalidInputError: It is not known.
        """
        try:
            return str(self.types.generate_msgdef(kind, ros_version=2)[0])
        except Exception as error:  # as above
            raise InvalidInputError(f"{self.path}: {kind}", "no definition", "Give a bag that defines it.") from error

    def stamp(self, topic: str, content: bytes) -> int:
        """Nanoseconds of a message's header, which is what it begins with; 0 where nobody set it.

        Raises:
            InvalidInputError: It is too short.
        """
        big = not self.is_ros1 and content[1:2] == b"\x00"  # the second byte of CDR tells the order of bytes
        try:
            seconds, rest = struct.unpack_from(">iI" if big else "<iI", content, 4)
        except struct.error as error:
            fix = f"Give whole messages of {self.topics[topic]}."
            raise InvalidInputError(f"{self.path}: {topic}", f"{len(content)} bytes", fix) from error
        return int(seconds) * NANO + int(rest)

    def chosen(self, field: str, topics: Collection[str], wanted: str | None, what: str) -> str:
        """The topic that is wanted, or the only one.

        Raises:
            InvalidInputError: There is none, it is none of these, or none is wanted of several; lists them.
        """
        if wanted in topics:
            return str(wanted)
        if wanted is None and len(topics) == 1:
            return next(iter(topics))
        listed = ", ".join(sorted(topics)) or "there is none"
        value = f"{self.path}#{wanted}" if wanted else f"{len(topics)} topics of {self.path}"
        raise InvalidInputError(field, value, f"Name a topic of {what}: {listed}.")


def open_bag(path: Path) -> Bag:
    """A bag's topics; no message is read yet.

    Raises:
        InvalidInputError: It cannot be read.
        MissingPackageError: rosbags is not installed.
    """
    with _reader(path) as reader:
        topics = {one.topic: one.msgtype for one in reader.connections}
        return Bag(path, topics, _types(reader, path), is_ros1=not reader.is2)


def raw_messages(bag: Bag) -> Iterator[tuple[Any, int, bytes]]:
    """All messages of a bag, in order of their recording: connection, time (nanoseconds) and content.

    Raises:
        InvalidInputError: The bag is damaged.
    """
    with _reader(bag.path) as reader:
        for one, time, content in reader.messages():
            yield one, time, bytes(content)


def _types(reader: Any, path: Path) -> Any:
    """The types of the bag's messages; of those that it does not define, ROS' own."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY if reader.is2 else Stores.ROS1_NOETIC)
    own = {name: fields for name, fields in reader.typestore.fielddefs.items() if name not in types.fielddefs}
    try:
        types.register(own)
    except Exception as error:  # as above
        raise InvalidInputError("source", str(path), f"{_FIX} The reason: {error!r}") from error
    return types


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """The reader of a bag."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingPackageError("fgrecon[bags]", "Reading a bag") from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield reader
    except (FgreconError, GeneratorExit):
        raise
    except Exception as error:  # rosbags promises no kind of error for damaged content
        raise InvalidInputError("source", str(path), f"{_FIX} The reason: {error!r}") from error
