"""What a bag has of a drive: the pictures of a topic, their camera and its poses, and the points of a LiDAR.

| what | from where |
|---|---|
| times | the headers; the times of recording where nobody set those |
| camera | the `CameraInfo` beside the pictures, or of their frame; with binning and region; `P` of `image_rect` |
| poses | an odometry, from its child's frame to the camera's by TF; else TF's `odom`, or the highest frame |
| points | a `PointCloud2`, brought by TF, and by the poses for the time between, into the camera's frame |

A camera's frame has z ahead (REP 103). Where it has z up instead, as that of a robot's body, x is ahead.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Points
from fgrecon.core.geometry import AHEAD, UPRIGHT, transform
from fgrecon.io.bag import NANO, Bag, open_any_bag, split
from fgrecon.io.bag_images import PICTURES, BagFrames
from fgrecon.io.bag_transforms import Transforms, frame_name, pose_of_message, series, stamp_of
from fgrecon.io.json_fields import Fields, within
from fgrecon.io.lens_fields import read_lens
from fgrecon.io.poses import CameraPoses, read_pose
from fgrecon.io.source_frames import Choice

CLOUD = "sensor_msgs/msg/PointCloud2"
_INFO, _ODOMETRY = "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_FARTHEST = 0.1  # seconds between an image and its scan: half of the slowest LiDAR's interval, and a bit
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numpy's names of a field's numbers by PointCloud2's."""


@dataclass(frozen=True)
class LidarTopic:
    """The LiDAR of a bag."""

    topic: str  # its points
    pose: Path | None = None  # file with the motion from its frame to the camera's; None for what TF tells


@dataclass
class _Index:
    """What one pass over a bag finds: times of messages (header, recording), the first of them, transforms."""

    stamps: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    recorded: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    first: dict[str, bytes] = field(default_factory=dict)
    transforms: Transforms = field(default_factory=Transforms)
    odometry: dict[str, dict[float, Array]] = field(default_factory=lambda: defaultdict(dict))
    children: dict[str, str] = field(default_factory=dict)

    def times(self, topic: str) -> list[int]:
        """Nanoseconds of each message: of the headers, else of the recording."""
        return self.stamps[topic] if any(self.stamps[topic]) else self.recorded[topic]


@dataclass(frozen=True, eq=False)
class BagDrive:
    """A drive in a bag."""

    frames: BagFrames  # the pictures that are taken
    times: tuple[int, ...]  # nanoseconds of every picture of the topic
    recorded: tuple[int, ...]  # when each was recorded, nanoseconds
    frame: str  # the frame of the pictures
    warnings: list[str]  # what may be wrong
    _index: _Index

    @cached_property
    def camera(self) -> Camera | None:
        """Of the pictures; None where the bag does not tell.

        Raises:
            InvalidInputError: It is none that is solved, or a field is malformed; names topic and field.
        """
        bag, topic = self.frames.bag, self.frames.topic
        first = self._index.first
        infos = {one: bag.message(one, first[one]) for one in bag.of_type(_INFO) if one in first}
        beside = [one for one in infos if any(one == f"{part}/camera_info" for part in _above(topic))]
        same = [one for one, info in infos.items() if frame_name(info.header.frame_id) == self.frame]
        found = beside[:1] or (same if len(same) == 1 else [])
        if not found:
            return None
        rectified = any("rect" in part.split("_") for part in topic.split("/"))
        return _camera(infos[found[0]], f"{bag.path}: {found[0]}: ", rectified=rectified)

    def poses(self, wanted: str | None) -> CameraPoses | None:
        """The camera's poses at the frames' times; None where the bag does not tell.

        Args:
            wanted: A topic of odometry, or a frame of TF; None for the only one.

        Raises:
            InvalidInputError: There is no such topic or frame, none is wanted of several topics, or TF does not lead
                from it to the camera.
        """
        world = self._world(wanted)
        return None if world is None else world.of_frames(self)

    def _world(self, wanted: str | None) -> _World | None:
        index, frame = self._index, self.frame
        if wanted is not None and wanted in index.transforms.frames:
            return _World(index.transforms, wanted)
        if wanted is not None or index.odometry:
            topics = {topic for topic in index.odometry if wanted is not None or len(index.odometry[topic]) > 1}
            if wanted is not None or len(topics) > 1:
                what = f"odometry, or a frame of TF ({', '.join(index.transforms.frames) or 'none'})"
                topics = {self.frames.bag.chosen("poses", topics, wanted, what)}
            for topic in topics:
                child = index.children[topic]
                if index.transforms.pose(child, frame, self.frames.times[0]) is not None:
                    return _World(index.transforms, child, series(index.odometry[topic]))
                no_way = f"TF does not lead from {child} ({topic}) to {frame}"
                if wanted is not None:
                    raise InvalidInputError("poses", topic, f"Give one that TF leads from: {no_way}.")
                self.warnings.append(f"{no_way}: where the camera was is not known by it.")
        if not index.transforms.moves(frame):
            return None
        chain = index.transforms.above(frame)
        return _World(index.transforms, next((one for one in chain if one.split("/")[-1] == "odom"), chain[-1]))

    @cached_property
    def frame_T_camera(self) -> Array:
        """(4, 4) from a camera's axes right, down, ahead to those of the pictures' frame."""
        pose, tree = np.eye(4), self._index.transforms
        top = tree.above(self.frame)[-1]
        times = [self.frames.times[0], self.frames.times[len(self.frames.times) // 2]]
        placed = next((one for time in times if (one := tree.pose(top, self.frame, time)) is not None), pose)
        if top != self.frame and placed[2, 2] > UPRIGHT:
            self.warnings.append(
                f"The frame {self.frame} of {self.frames.topic} has z up, and is no optical one: x is taken for ahead."
            )
            pose[:3, :3] = AHEAD
        return pose

    def clouds(self, lidar: LidarTopic, poses: str | None = None) -> BagClouds:
        """The points of a LiDAR.

        Args:
            poses: As `BagDrive.poses` takes them.

        Raises:
            InvalidInputError: There is no such topic, it has no message, or nothing tells where it is.
        """
        bag, index = self.frames.bag, self._index
        topic = bag.chosen("lidar", bag.of_type(CLOUD), lidar.topic, "points")
        if topic not in index.first:
            raise InvalidInputError("lidar", topic, f"Give a topic with messages: {bag.path} has none of it.")
        frame = frame_name(bag.message(topic, index.first[topic]).header.frame_id)
        given = None if lidar.pose is None else read_pose(lidar.pose)
        if given is None and index.transforms.pose(self.frame, frame, self.frames.times[0]) is None:
            fix = f"Give the motion from {frame} to the camera {self.frame} (--lidar-pose): TF does not lead there."
            raise InvalidInputError("lidar", topic, fix)
        order = sorted(zip(index.times(topic), index.recorded[topic], strict=True))
        return BagClouds(self, topic, frame, given, self._world(poses), tuple(order))


@dataclass(frozen=True, eq=False)
class _World:
    """Where frames are in a world: by TF below one of its frames, or below the child of an odometry."""

    transforms: Transforms
    base: str
    odometry: CameraPoses | None = None

    def pose(self, frame: str, time: float) -> Array | None:
        """(4, 4) of a frame at a time; None where it is not known."""
        rest = self.transforms.pose(self.base, frame, time)
        if self.odometry is None or rest is None:
            return rest
        base = self.odometry.at(0, time)
        return None if base is None else base @ rest

    def of_frames(self, drive: BagDrive) -> CameraPoses | None:
        """Those of the camera."""
        pairs = zip(drive.frames.numbers, drive.frames.times, strict=True)
        known = {number: pose for number, time in pairs if (pose := self.pose(drive.frame, time)) is not None}
        return CameraPoses({number: pose @ drive.frame_T_camera for number, pose in known.items()}) if known else None


@dataclass(frozen=True, eq=False)
class BagClouds:
    """A LiDAR's points."""

    drive: BagDrive
    topic: str
    frame: str
    camera_T_lidar: Array | None  # (4, 4) as it was given, or None
    world: _World | None  # where frames are, or None
    times: tuple[tuple[int, int], ...]  # nanoseconds of the scans and of their recording, growing

    def evidence(self, number: int) -> tuple[Points, ...]:
        """The points nearest to a frame, in its camera's frame; nothing where there is no scan near it.

        Raises:
            InvalidInputError: A message is no cloud of points; names the topic.
        """
        time = self.drive.times[number]
        place = bisect_left(self.times, (time, 0))
        near = min(self.times[max(place - 1, 0) : place + 1], key=lambda one: abs(one[0] - time))
        motion = None if abs(near[0] - time) > _FARTHEST * NANO else self._camera_T_lidar(time / NANO, near[0] / NANO)
        if motion is None:
            return ()
        bag = self.drive.frames.bag
        content = next((content for _, _, content in bag.messages([self.topic], at=near[1])), None)
        if content is None:
            fix = "Give a whole bag, in which what was indexed is there."
            raise InvalidInputError(f"{bag.path}: {self.topic}", f"no message at {near[1]}", fix)
        points = cloud_points(bag.message(self.topic, content), f"{bag.path}: {self.topic}: ")
        return (Points(transform(motion, points), origin=motion[:3, 3]),)

    def _camera_T_lidar(self, time: float, scanned: float) -> Array | None:
        """(4, 4) from the LiDAR when it scanned to the camera when it took its image."""
        drive, tree = self.drive, self.drive._index.transforms  # noqa: SLF001 - of this module
        camera_T_frame = np.linalg.inv(drive.frame_T_camera).astype(np.float64)
        here = self.camera_T_lidar
        if here is None:
            rigid = tree.pose(drive.frame, self.frame, time)
            here = None if rigid is None else camera_T_frame @ rigid
        if here is None or self.world is None:
            return here
        then, now = self.world.pose(drive.frame, scanned), self.world.pose(drive.frame, time)
        if then is None or now is None:
            return here
        return camera_T_frame @ np.linalg.inv(now) @ then @ drive.frame_T_camera @ here


def open_bag_drive(source: str | Path, *, choice: Choice | None = None, lidar: LidarTopic | None = None) -> BagDrive:
    """Read a bag's times and transforms, in one pass.

    Args:
        source: The bag, with the topic of the pictures behind `#` where it has several.
        choice: Which frames are taken; None for all.
        lidar: Whose points will be read, or None.

    Raises:
        InvalidInputError: It is no bag, has no such topic, or is damaged; names file and topic.
        MissingPackageError: rosbags is not installed.
    """
    path, wanted = split(source)
    bag, choice = open_any_bag(path), choice or Choice()
    pictures = [topic for topic in bag.of_type(*PICTURES) if not topic.endswith("/compressedDepth")]
    topic = bag.chosen("source", pictures, wanted, "pictures")
    index = _indexed(bag, {topic, *([] if lidar is None else [lidar.topic])})
    times = index.times(topic)
    if not times:
        raise InvalidInputError("source", f"{path}: {topic}", "Give a topic with messages.")
    warnings = [] if any(index.stamps[topic]) else [f"{topic}: no header has a time; those of the recording are taken."]
    taken = choice.chosen([(time - times[0]) / NANO for time in times])
    frames = BagFrames(bag, topic, tuple(taken), tuple(times[i] / NANO for i in taken))
    first = bag.message(topic, index.first[topic])
    frame = frame_name(first.header.frame_id if hasattr(first, "header") else first.frame_id)
    return BagDrive(frames, tuple(times), tuple(index.recorded[topic]), frame, warnings, index)


def _indexed(bag: Bag, timed: set[str]) -> _Index:
    index = _Index()
    tf, odometry, infos = bag.of_type(*_TF), bag.of_type(_ODOMETRY), bag.of_type(_INFO)
    for topic, recorded, content in bag.messages({*timed, *tf, *odometry, *infos}):
        where = f"{bag.path}: {topic}: "
        if topic in tf:
            still = topic.rstrip("/").endswith("tf_static")
            index.transforms.add(bag.message(topic, content).transforms, where, still=still)
            continue
        index.first.setdefault(topic, content)
        if topic in odometry:
            message = bag.message(topic, content)
            pose = message.pose.pose
            index.odometry[topic][stamp_of(message.header)] = pose_of_message(pose.position, pose.orientation, where)
            index.children[topic] = frame_name(message.child_frame_id)
        elif topic in timed:
            index.stamps[topic].append(bag.stamp(topic, content))
            index.recorded[topic].append(recorded)
    return index


def _above(topic: str) -> list[str]:
    """The names above a topic, the nearest first."""
    parts = topic.split("/")
    return ["/".join(parts[:i]) for i in range(len(parts) - 1, 0, -1)]


def _camera(info: Any, where: str, *, rectified: bool) -> Camera | None:
    """The camera of a `CameraInfo`; None where it was not calibrated."""
    matrix, lens_of, projection = (
        np.array(getattr(info, name.lower(), getattr(info, name, ())), dtype=np.float64) for name in "KDP"
    )
    used = projection.reshape(3, 4)[:, :3].copy() if rectified else matrix.reshape(3, 3)
    if not used.any():
        return None
    fields = Fields({"distortion_model": info.distortion_model, "d": lens_of.tolist()}, where)
    lens = {} if rectified or not lens_of.any() else read_lens(fields)
    region = info.roi
    shift = np.array([region.x_offset, region.y_offset], dtype=np.float64)
    size = np.array([region.width or info.width, region.height or info.height], dtype=np.float64)
    bins = np.array([max(info.binning_x, 1), max(info.binning_y, 1)], dtype=np.float64)
    used[:2, 2] -= shift
    used[:2] /= bins[:, None]  # as image_geometry does, which has no half pixel
    width, height = (size // bins).astype(int).tolist()
    with within(where):
        return Camera(used, image_size=(width, height) if min(width, height) > 0 else None, **lens)


def cloud_points(message: Any, where: str) -> Array:
    """(N, 3) the points of a `PointCloud2`, metres, those that are not finite left out; errors begin with a place.

    Raises:
        InvalidInputError: It has no x, y and z, or fewer bytes than points.
    """
    fields = {one.name: one for one in message.fields}
    if not {"x", "y", "z"} <= fields.keys() or any(fields[axis].datatype not in _NUMBERS for axis in "xyz"):
        raise InvalidInputError(f"{where}fields", ", ".join(fields) or "none", "Give points with x, y and z.")
    order, step, row = ">" if message.is_bigendian else "<", message.point_step, message.row_step
    try:
        kind = np.dtype(
            {
                "names": list("xyz"),
                "formats": [order + _NUMBERS[fields[axis].datatype] for axis in "xyz"],
                "offsets": [fields[axis].offset for axis in "xyz"],
                "itemsize": step,
            }
        )
        content = np.ascontiguousarray(message.data, dtype=np.uint8)
        rows = [content[i * row : i * row + message.width * step].view(kind) for i in range(message.height)]
        table = np.concatenate(rows) if rows else np.zeros(0, kind)
        if len(table) != message.width * message.height:
            raise ValueError(f"{len(table)} of {message.width * message.height} points")
    except ValueError as error:
        raise InvalidInputError(f"{where}data", f"{len(message.data)} bytes", f"Give whole clouds: {error}.") from error
    points = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return points[np.isfinite(points).all(axis=1)]
