"""A copy of a bag as MCAP, with messages of results on topics of their own."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import merge
from pathlib import Path
from typing import Any

from fgrecon.core.errors import FgreconError, InvalidInputError, MissingPackageError
from fgrecon.io.bag import BAGS, open_bag, raw_messages, split
from fgrecon.io.export.image_info import ImageInfo
from fgrecon.io.export.mcap import ros2_bytes
from fgrecon.io.export.results import NamedResult
from fgrecon.io.files import replacing


@dataclass(frozen=True, order=True)
class _Message:
    """A message of a bag: its times (nanoseconds), topic, type, definition and content."""

    recorded: int
    topic: str = field(compare=False)
    schema: tuple[str, str, bytes] = field(compare=False)  # name, encoding, definition
    encoding: str = field(compare=False)
    metadata: Mapping[str, str] = field(compare=False)
    content: bytes = field(compare=False)
    published: int = field(compare=False)
    sequence: int = field(compare=False)


def export_into_bag(
    path: str | Path, results: Sequence[NamedResult], images: Mapping[str, ImageInfo], bag: str | Path
) -> Path:
    """Write a copy of a bag with the results of its images, whole or not at all.

    Args:
        results: The vehicles, by the frames of a run on the bag.
        images: What is known of the frames, by `read_images_file` from the bag.
        bag: The bag: MCAP, `.db3`, or a folder.

    Raises:
        InvalidInputError: A result is of no image of the bag, the bag is one of ROS 1 or damaged, or the file cannot be
            written.
        MissingPackageError: mcap, or rosbags, is not installed.
    """
    target, source = Path(path), split(bag)[0]
    strangers = [item.name for item in results if images.get(item.image, ImageInfo()).bag is None]
    if strangers:
        fix = f"Give the bag that the run was on: {source} has no such image."
        raise InvalidInputError("images", f"vehicle {strangers[0]} of {len(strangers)}", fix)
    ours = ros2_bytes(results, images)
    try:
        from mcap.reader import make_reader
        from mcap.writer import Writer
    except ImportError as error:
        raise MissingPackageError("mcap>=1.2 mcap-ros2-support>=0.5", "MCAP") from error
    with replacing(target) as part, part.open("wb") as sink:
        writer = Writer(sink)
        writer.start(profile="ros2", library="fgrecon")
        copy = _Copy(writer)
        try:
            for message in merge(_messages(source), _of_mcap(make_reader(io.BytesIO(ours)))):
                copy.add(message)
            if source.suffix.lower() == BAGS[0]:
                with source.open("rb") as content:
                    _copy_rest(make_reader(content), writer)
        except (FgreconError, OSError):
            raise
        except Exception as error:  # mcap promises no kind of error for damaged content
            raise InvalidInputError("images", str(source), f"Give a whole bag. The reason: {error!r}") from error
        writer.finish()
    return target


def _messages(source: Path) -> Iterator[_Message]:
    """The messages of a bag, in order of their recording."""
    from mcap.reader import make_reader

    if source.suffix.lower() == BAGS[0]:
        with source.open("rb") as file:
            yield from _of_mcap(make_reader(file))
        return
    bag = open_bag(source)
    if bag.is_ros1:
        raise InvalidInputError("images", str(source), "Give a bag of ROS 2: `rosbags-convert` makes one of it.")
    for one, recorded, content in raw_messages(bag):
        schema = one.msgtype, "ros2msg", bag.definition(one.msgtype).encode()
        yield _Message(recorded, one.topic, schema, "cdr", {}, content, recorded, 0)


def _of_mcap(reader: Any) -> Iterator[_Message]:
    for schema, channel, message in reader.iter_messages():
        made = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
        rest = message.data, message.publish_time, message.sequence
        yield _Message(message.log_time, channel.topic, made, channel.message_encoding, channel.metadata, *rest)


def _copy_rest(reader: Any, writer: Any) -> None:
    """What an MCAP has beside messages."""
    for one in reader.iter_attachments():
        writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
    for one in reader.iter_metadata():
        writer.add_metadata(one.name, one.metadata)


class _Copy:
    """Writes messages, with their channels and schemas at the first of each."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[tuple[str, str, bytes], int] = {("", "", b""): 0}
        self._channels: dict[tuple[Any, ...], int] = {}

    def add(self, one: _Message) -> None:
        if one.schema not in self._schemas:
            self._schemas[one.schema] = self._writer.register_schema(*one.schema)
        channel = one.topic, one.encoding, self._schemas[one.schema], tuple(sorted(one.metadata.items()))
        if channel not in self._channels:
            self._channels[channel] = self._writer.register_channel(*channel[:3], metadata=dict(one.metadata))
        self._writer.add_message(self._channels[channel], one.recorded, one.content, one.published, one.sequence)
