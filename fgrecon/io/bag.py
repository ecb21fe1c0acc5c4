"""Bags of ROS 2 (and ROS 1), read by rosbags: MCAP and SQLite files, and the folders of `ros2 bag record`.

What is meant of a bag is one of its topics: `drive.mcap#/camera/image_raw`. Foxglove's own messages in MCAP (protobuf
or JSON) are taken as if they were those of ROS:

| schema | is taken for |
|---|---|
| `foxglove.CompressedImage`, `RawImage`, `CompressedVideo` | the pictures |
| `foxglove.CameraCalibration` | a `CameraInfo` of the whole image |
| `foxglove.FrameTransform`, `FrameTransforms` | TF |
| `foxglove.Odometry` | an odometry |
| `foxglove.PointCloud` | a `PointCloud2`; its points are where its own `pose` puts them in its frame |

Schemas of protobuf come with the file; JSON has the same fields, with bytes in base64. Other channels are left out.
"""

from __future__ import annotations

import json
import struct
from base64 import b64decode
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fgrecon.core.errors import FgreconError, InvalidInputError, MissingPackageError
from fgrecon.core.geometry import quaternion_pose, transform

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
            at: The time of those that are read; None for all.
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
        """The definition of a type of messages, with those that it is made of."""
        try:
            return str(self.types.generate_msgdef(kind, ros_version=2)[0])
        except Exception as error:  # as above
            raise InvalidInputError(f"{self.path}: {kind}", "no definition", "Give a bag that defines it.") from error

    def stamp(self, topic: str, content: bytes) -> int:
        """Nanoseconds of a message's header, which is what it begins with; 0 where nobody set it."""
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
    """All messages of a bag, in order of their recording: connection, time (nanoseconds) and content."""
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


_KINDS = {
    "foxglove.CompressedImage": "sensor_msgs/msg/CompressedImage",
    "foxglove.RawImage": "sensor_msgs/msg/Image",
    "foxglove.CompressedVideo": "foxglove_msgs/msg/CompressedVideo",
    "foxglove.CameraCalibration": "sensor_msgs/msg/CameraInfo",
    "foxglove.FrameTransform": "tf2_msgs/msg/TFMessage",
    "foxglove.FrameTransforms": "tf2_msgs/msg/TFMessage",
    "foxglove.Odometry": "nav_msgs/msg/Odometry",
    "foxglove.PointCloud": "sensor_msgs/msg/PointCloud2",
}
_NUMBERS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
"""numpy's names of a field's numbers by Foxglove's, which has those without a sign first; ROS has them second."""
_PLAIN: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("frame_id", "parent_frame_id", "child_frame_id", "body_frame_id"), "".__add__),
    **dict.fromkeys(("encoding", "format", "distortion_model", "name"), "".__add__),
    **dict.fromkeys(("sec", "nsec", "width", "height", "step", "point_stride", "offset", "type"), int),
    **dict.fromkeys("xyzw", float),
    **dict.fromkeys("KDP", lambda values: [float(value) for value in values]),
}
"""What JSON must have by the names of fields; each raises where it is something else."""
_F8 = 8  # ROS' number of float64


@dataclass(frozen=True, eq=False)
class FoxgloveBag(Bag):
    """An MCAP file of Foxglove's messages; `types` has the schema of each topic, and what parses its messages."""

    def messages(self, topics: Collection[str], at: int | None = None) -> Iterator[tuple[str, int, bytes]]:
        """As `Bag.messages`."""
        from mcap.reader import make_reader

        try:
            with self.path.open("rb") as file:
                found = make_reader(file).iter_messages(sorted(topics), starting_at=at, ending_at=at)
                for _, channel, message in found:
                    yield channel.topic, message.log_time, message.data
        except Exception as error:  # mcap promises no kind of error for damaged content
            fix = f"Give a whole file: `mcap recover FILE` mends one. The reason: {error!r}"
            raise InvalidInputError("source", str(self.path), fix) from error

    def message(self, topic: str, content: bytes) -> Any:
        """As `Bag.message`."""
        with self._whole(topic):
            name, parse = self.types[topic]
            found = parse(content)
            if self.topics[topic] == _KINDS["foxglove.FrameTransform"]:
                return SimpleNamespace(transforms=[_transform(one) for one in getattr(found, "transforms", [found])])
            return _as_ros(found, name, f"{self.path}: {topic}: ")

    def stamp(self, topic: str, content: bytes) -> int:
        """As `Bag.stamp`."""
        with self._whole(topic):
            time = self.types[topic][1](content).timestamp
            return int(time.seconds) * NANO + int(time.nanos)

    @contextmanager
    def _whole(self, topic: str) -> Iterator[None]:
        try:
            yield
        except InvalidInputError:
            raise
        except Exception as error:  # neither protobuf nor what lacks a field promises a kind of error
            fix = f"Give whole messages of {self.types[topic][0]}. The reason: {error!r}"
            raise InvalidInputError(f"{self.path}: {topic}", "a message that is none", fix) from error


def open_any_bag(path: Path) -> Bag:
    """A bag of ROS, or one of Foxglove's messages, as `fgrecon.io.bag.open_bag` opens those of ROS.

    Raises:
        InvalidInputError: It cannot be read.
        MissingPackageError: rosbags is not installed.
    """
    try:
        return open_bag(path)
    except InvalidInputError:
        found = open_foxglove(path) if path.suffix.lower() == BAGS[0] else None
        if found is None:
            raise
        return found


def open_foxglove(path: Path) -> FoxgloveBag | None:
    """The topics of an MCAP file that have Foxglove's messages; None where it has none, or nothing reads it here."""
    try:
        from mcap.reader import make_reader
    except ImportError:
        return None
    topics, types = {}, {}
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        for channel in () if summary is None else summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is not None and schema.name in _KINDS and channel.message_encoding in ("protobuf", "json"):
                topics[channel.topic] = _KINDS[schema.name]
                is_json = channel.message_encoding == "json"
                parse = _of_json if is_json else _class_of(schema.name, schema.data).FromString
                types[channel.topic] = schema.name, parse
    except Exception:  # noqa: BLE001 - neither package promises a kind of error for damaged content
        return None
    return FoxgloveBag(path, topics, types, is_ros1=False) if topics else None


def _of_json(content: bytes) -> SimpleNamespace:
    """A message in JSON with the fields that one of protobuf has."""
    found = json.loads(content, object_hook=_object)
    if hasattr(found, "data"):
        found.data = b64decode(found.data)
    return found


def _object(fields: dict[str, Any]) -> SimpleNamespace:
    for name in fields.keys() & _PLAIN.keys():
        fields[name] = _PLAIN[name](fields[name])
    if fields.keys() == {"sec", "nsec"}:
        return SimpleNamespace(seconds=fields["sec"], nanos=fields["nsec"])
    return SimpleNamespace(**fields)


def _has(found: Any, name: str) -> bool:
    """Whether a message has a message inside."""
    return bool(found.HasField(name) if hasattr(found, "HasField") else hasattr(found, name))


def _class_of(name: str, schema: bytes) -> Any:
    """The class of messages of a schema, which is a set of files that may come in any order."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    pool, files = DescriptorPool(), {one.name: one for one in FileDescriptorSet.FromString(schema).file}

    def add(file: str) -> None:
        found = files.pop(file, None)
        if found is not None:
            for other in found.dependency:
                add(other)
            pool.Add(found)

    while files:
        add(next(iter(files)))
    return GetMessageClass(pool.FindMessageTypeByName(name))


def _header(found: Any, frame: str) -> SimpleNamespace:
    stamp = SimpleNamespace(sec=found.timestamp.seconds, nanosec=found.timestamp.nanos)
    return SimpleNamespace(stamp=stamp, frame_id=frame)


def _transform(found: Any) -> SimpleNamespace:
    motion = SimpleNamespace(translation=found.translation, rotation=found.rotation)
    header = _header(found, found.parent_frame_id)
    return SimpleNamespace(header=header, child_frame_id=found.child_frame_id, transform=motion)


def _as_ros(found: Any, name: str, where: str) -> SimpleNamespace:
    """A message with the fields that ROS' has."""
    header = _header(found, found.frame_id)
    if name == "foxglove.CameraCalibration":
        region = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
        parts: dict[str, Any] = {
            "k": found.K,
            "d": found.D,
            "p": getattr(found, "P", None) or [0.0] * 12,
            "distortion_model": found.distortion_model,
        }
        size = {"width": found.width, "height": found.height, "binning_x": 0, "binning_y": 0, "roi": region}
        return SimpleNamespace(header=header, **parts, **size)
    if name == "foxglove.Odometry":
        pose = SimpleNamespace(position=found.pose.position, orientation=found.pose.orientation)
        return SimpleNamespace(header=header, child_frame_id=found.body_frame_id, pose=SimpleNamespace(pose=pose))
    if name == "foxglove.PointCloud":
        return _cloud(found, header, where)
    content = np.frombuffer(found.data, dtype=np.uint8)
    if name == "foxglove.RawImage":
        size = {"width": found.width, "height": found.height, "step": found.step, "is_bigendian": 0}
        return SimpleNamespace(header=header, encoding=found.encoding, data=content, **size)
    return SimpleNamespace(header=header, format=found.format, data=content)


def _cloud(found: Any, header: SimpleNamespace, where: str) -> SimpleNamespace:
    """The points in the frame, as three float64 each."""
    fields = {one.name: (one.offset, _NUMBERS.get(one.type)) for one in found.fields}
    kinds = [fields.get(axis, (0, None)) for axis in "xyz"]
    if any(kind is None for _, kind in kinds):
        raise InvalidInputError(f"{where}fields", ", ".join(fields) or "none", "Give points with x, y and z.")
    layout: Any = {"names": list("xyz"), "itemsize": found.point_stride}
    layout |= {"formats": [f"<{kind}" for _, kind in kinds], "offsets": [at for at, _ in kinds]}
    try:
        table: Any = np.frombuffer(found.data, np.dtype(layout))
    except ValueError as error:
        value = f"{len(found.data)} bytes, {found.point_stride} a point"
        raise InvalidInputError(f"{where}data", value, "Give whole clouds.") from error
    points = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if _has(found, "pose") and _has(found.pose, "orientation"):
        (x, y, z), turn = ((getattr(found.pose.position, a) for a in "xyz"), found.pose.orientation)
        points = transform(quaternion_pose(np.array([turn.w, turn.x, turn.y, turn.z]), np.array([x, y, z])), points)
    axes = [SimpleNamespace(name=axis, offset=8 * i, datatype=_F8) for i, axis in enumerate("xyz")]
    size = {"width": len(points), "height": 1, "point_step": 24, "row_step": 24 * len(points), "is_bigendian": 0}
    content = np.frombuffer(points.astype("<f8").tobytes(), np.uint8)
    return SimpleNamespace(header=header, fields=axes, data=content, **size)
