"""Foxglove's own messages in MCAP (protobuf or JSON) as if they were those of ROS.

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
from base64 import b64decode
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import quaternion_pose, transform
from fgrecon.io.bag import BAGS, NANO, Bag, open_bag

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
