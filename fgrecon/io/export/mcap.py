"""Results as MCAP: Foxglove's `SceneUpdate` to look at, ROS 2's `vision_msgs/Detection3DArray` to work with.

A message for each image, at its time, else ten images a second. Boxes have the axes x forward, y left, z up. Their
frame is `world` where the camera's pose is known, else `camera` (x right, y down, z forward). Both are in `map` (topic
`/tf`, before each image), which is upright: z up, x ahead, y to the left, as ROS' REP 103 and 105 have it. The world of
a video's run is the frame of its first camera, whose y axis points down: a viewer that takes z for up shows it lying on
its side. A world that is upright as it is (nuScenes') stays as it is.

A time that MCAP or ROS 2 cannot tell is an `InvalidInputError` that names the image, a package that is not installed a
`MissingPackageError`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.geometry import UPRIGHT, transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.text import distinct, whole_text
from fgrecon.core.vehicle_mesh import SURFACE
from fgrecon.io.bag import NANO
from fgrecon.io.export.image_info import (
    EVERY,
    ImageInfo,
    box_in,
    by_image,
    info_of,
    names_of,
    plain_quaternion,
    plain_vector,
    score,
)
from fgrecon.io.export.messages import FRAME_TRANSFORMS, SCENE_UPDATE, ros_definition
from fgrecon.io.export.results import NamedResult

_PERIOD = 0.1  # seconds between images whose times are not known
_MCAP_SECONDS = 2**64 // NANO  # its times are 64 bits of nanoseconds
_ROS_SECONDS = 2**31  # `builtin_interfaces/Time` has 31 bits of seconds
_LINE_LIST = 2  # pairs of points
_CAR = "car"
_CUBE, _LINES, _TEXT, _DELETE_ALL = 1, 5, 9, 3  # of `visualization_msgs/Marker`
_COLOUR = {**dict(zip("rgb", (value / 255 for value in SURFACE), strict=True)), "a": 1.0}
_FAINT = _COLOUR | {"a": 0.3}
_STILL = {"position": plain_vector([0, 0, 0]), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


@dataclass(frozen=True, eq=False)
class _Moment:
    """An image: its time and when that was recorded (nanoseconds), what is known of it, and its vehicles."""

    time: int
    info: ImageInfo
    items: list[NamedResult]

    @property
    def recorded(self) -> int:
        return self.time if self.info.bag is None else self.info.bag.recorded

    @property
    def frame(self) -> str:
        """The frame in which its boxes are given."""
        if self.info.bag is not None:
            return self.info.bag.frame
        return CAMERA if self.info.world_T_camera is None else WORLD


def scene_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """MCAP of Foxglove's scene updates (JSON), topic `/fgrecon/scene`: of each vehicle box, wireframe and name."""
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise MissingPackageError("mcap>=1.2 mcap-ros2-support>=0.5", "MCAP") from error
    sink = io.BytesIO()
    writer = Writer(sink)
    writer.start(profile="", library="fgrecon")
    content = json.dumps(SCENE_UPDATE).encode()
    schema = writer.register_schema("foxglove.SceneUpdate", "jsonschema", content)
    channel = writer.register_channel("/fgrecon/scene", "json", schema)
    content = json.dumps(FRAME_TRANSFORMS).encode()
    schema = writer.register_schema("foxglove.FrameTransforms", "jsonschema", content)
    frames = writer.register_channel("/tf", "json", schema)
    for moment, placed in _with_transforms(_moments(results, images, _MCAP_SECONDS)):
        time = moment.time
        data = json.dumps({"transforms": [_placed(one, time) for one in placed]}, allow_nan=False).encode()
        writer.add_message(frames, log_time=time, data=data, publish_time=time)
        data = json.dumps(_scene(moment, "nsec"), allow_nan=False).encode()
        writer.add_message(channel, log_time=time, data=data, publish_time=time)
    writer.finish()
    return sink.getvalue()


def detections_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """MCAP of `vision_msgs/msg/Detection3DArray` (CDR), topic `/fgrecon/detections`.

    The hypotheses of a detection are the result, with its covariance, and then its alternatives, whose covariances are
    not known (zeros). Their scores share that of the detection as their energies say.
    """
    return _ros_bytes(results, images, {name: _ROS_TOPICS[name] for name in _ROS_TOPICS if "vision" in name})


def ros2_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """The same, and markers of rviz (`/fgrecon/markers`) and Foxglove's scenes (`/fgrecon/scene`)."""
    return _ros_bytes(results, images, _ROS_TOPICS)


def _ros_bytes(
    results: Sequence[NamedResult],
    images: Mapping[str, ImageInfo],
    topics: Mapping[str, tuple[str, Callable[[_Moment], dict[str, Any]]]],
) -> bytes:
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingPackageError("mcap>=1.2 mcap-ros2-support>=0.5", "ROS 2 messages") from error
    sink = io.BytesIO()
    writer = Writer(sink)

    def register(name: str) -> Any:
        return writer.register_msgdef(name.replace("/", "/msg/"), ros_definition(name))

    schemas = {name: register(name) for name in topics}
    frames = register("tf2_msgs/TFMessage")
    moments = _with_transforms(_moments(results, images, _ROS_SECONDS))
    for number, (moment, placed) in enumerate(moments):
        times = moment.recorded, moment.time
        if moment.info.bag is None:  # in a bag its own transforms lead to the image
            stamped = {"transforms": [_stamped(one, moment.time) for one in placed]}
            writer.write_message("/tf", frames, stamped, *times, number)
        for name, (topic, message) in topics.items():
            writer.write_message(topic, schemas[name], message(moment), *times, number)
    writer.finish()
    return sink.getvalue()


def _moments(results: Sequence[NamedResult], images: Mapping[str, ImageInfo], below: int) -> Iterator[_Moment]:
    """Time in nanoseconds, what is known of the image, and vehicles, of every image.

    Images without vehicles whose times are known are among them: what was seen before is gone there.

    Args:
        below: Seconds from which on the file cannot tell the time.
    """
    found = by_image(results)
    named = {name for image in found for name in names_of(image)}
    empty: dict[str, list[NamedResult]] = {
        name: [] for name, info in images.items() if name not in named and info.timestamp is not None
    }
    moments = []
    for number, (image, items) in enumerate((found | empty).items()):
        info = info_of(image, images)
        seconds = number * _PERIOD if info.timestamp is None else info.timestamp
        if not 0.0 <= seconds < below:
            fix = f"Give seconds, from 0 to less than {below}, by a file of images (`images`, --images)."
            raise InvalidInputError(f"images.{image or EVERY}.timestamp", seconds, fix)
        if info.bag is None:
            moments.append(_Moment(round(seconds * NANO), info, items))
        else:
            moments.append(_Moment(info.bag.stamp, replace(info, world_T_camera=info.bag.frame_T_camera), items))
    yield from sorted(moments, key=lambda moment: moment.time)


def _with_transforms(moments: Iterator[_Moment]) -> Iterator[tuple[_Moment, list[FrameTransform]]]:
    """Each moment with the frames at it."""
    every = list(moments)
    grounds = [next((item.ground for item in one.items if item.ground is not None), None) for one in every]
    any_ground: Ground | None = next((ground for ground in grounds if ground is not None), None)
    known = [(one.info.world_T_camera, ground or any_ground) for one, ground in zip(every, grounds, strict=True)]
    yield from zip(every, transforms(known), strict=True)


def _placed(one: FrameTransform, time: int) -> dict[str, Any]:
    """Where a frame is, in Foxglove."""
    return {
        "timestamp": _time(time, "nsec"),
        "parent_frame_id": MAP,
        "child_frame_id": one.child,
        "translation": plain_vector(one.map_T_child[:3, 3]),
        "rotation": plain_quaternion(one.map_T_child[:3, :3]),
    }


def _stamped(one: FrameTransform, time: int) -> dict[str, Any]:
    """Where a frame is, in ROS 2."""
    content = _placed(one, time)
    return {
        "header": {"stamp": _time(time, "nanosec"), "frame_id": MAP},
        "child_frame_id": one.child,
        "transform": {"translation": content["translation"], "rotation": content["rotation"]},
    }


def _time(nanoseconds: int, rest: str) -> dict[str, int]:
    return {"sec": nanoseconds // NANO, rest: nanoseconds % NANO}


def _pose(info: ImageInfo, camera_T_object: Array, size: Array) -> dict[str, Any]:
    centre, axes = box_in(info, camera_T_object, size)
    return {"position": plain_vector(centre), "orientation": plain_quaternion(axes)}


def _scene(moment: _Moment, rest: str) -> dict[str, Any]:
    """The vehicles of an image in Foxglove's scene; `rest` is what nanoseconds are called there."""
    taken = set[str]()  # of entities with one id only the last would be shown
    named = [replace(item, name=distinct(item.name, taken)) for item in moment.items]
    clear = {"timestamp": _time(moment.time, rest), "type": 1, "id": ""}  # vehicles of the image before
    return {"deletions": [clear], "entities": [_entity(item, moment, rest) for item in named]}


def _lines(item: NamedResult, info: ImageInfo) -> list[dict[str, float]]:
    """The ends of a wireframe's edges, two and two."""
    result = item.result
    pose = result.camera_T_object if info.world_T_camera is None else info.world_T_camera @ result.camera_T_object
    return [plain_vector(point) for point in transform(pose, result.wireframe[result.shape.edges.ravel()])]


def _entity(item: NamedResult, moment: _Moment, rest: str) -> dict[str, Any]:
    """A vehicle in Foxglove's scene."""
    result, info = item.result, moment.info
    pose, size = result.camera_T_object, result.box_size
    box = _pose(info, pose, size)
    line = {"type": _LINE_LIST, "pose": _STILL, "thickness": 2.0, "scale_invariant": True}
    text = {"billboard": True, "font_size": 12.0, "scale_invariant": True, "text": item.name}
    content = {"status": result.status.value, "message": result.message, "score": f"{score(item):.3f}"}
    content |= {name: str(one) for name, one in (("class", item.kind), ("track", item.track)) if one is not None}
    return {
        "timestamp": _time(moment.time, rest),
        "frame_id": moment.frame,
        "id": item.name,
        "lifetime": _time(0, rest),
        "frame_locked": False,
        "metadata": [{"key": key, "value": value} for key, value in content.items()],
        **{name: [] for name in ("arrows", "spheres", "cylinders", "triangles", "models")},
        "cubes": [{"pose": box, "size": plain_vector(size), "color": _FAINT}],
        "lines": [line | {"points": _lines(item, info), "color": _COLOUR, "colors": [], "indices": []}],
        "texts": [text | {"pose": box, "color": _COLOUR}],
    }


def _header(moment: _Moment) -> dict[str, Any]:
    return {"stamp": _time(moment.time, "nanosec"), "frame_id": moment.frame}


def _markers(moment: _Moment) -> dict[str, Any]:
    """The vehicles of an image as markers of rviz: box, wireframe and name, after those before are gone."""
    plain = {
        "header": _header(moment),
        "ns": "",
        "id": 0,
        "type": 0,
        "action": _DELETE_ALL,
        "pose": _STILL,
        "scale": plain_vector(np.zeros(3)),
        "color": _COLOUR,
        "lifetime": _time(0, "nanosec"),
        "frame_locked": False,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "uv_coordinates": [],
        "texture": {"header": {"stamp": _time(0, "nanosec"), "frame_id": ""}, "format": "", "data": b""},
        "text": "",
        "mesh_resource": "",
        "mesh_file": {"filename": "", "data": b""},
        "mesh_use_embedded_materials": False,
    }
    markers = [plain]
    for number, item in enumerate(moment.items):
        size = item.result.box_size
        box = _pose(moment.info, item.result.camera_T_object, size)
        here = plain | {"id": number, "action": 0}
        lines, thin = _lines(item, moment.info), plain_vector([0.03, 0.0, 0.0])
        high = plain_vector([0.0, 0.0, 0.8])
        markers += [
            here | {"ns": "box", "type": _CUBE, "pose": box, "scale": plain_vector(size), "color": _FAINT},
            here | {"ns": "wireframe", "type": _LINES, "points": lines, "scale": thin},
            here | {"ns": "name", "type": _TEXT, "pose": box, "scale": high, "text": whole_text(item.name)},
        ]
    return {"markers": markers}


def _detections(moment: _Moment) -> dict[str, Any]:
    """The vehicles of an image in ROS 2."""
    header = _header(moment)
    return {"header": header, "detections": [_detection(item, moment.info, header) for item in moment.items]}


def _detection(item: NamedResult, info: ImageInfo, header: dict[str, Any]) -> dict[str, Any]:
    """A vehicle in ROS 2."""
    result = item.result
    known = np.zeros((6, 6)) if result.uncertainty.pose_covariance is None else pose_covariance(item, info)
    poses = [result.camera_T_object, *(a.camera_T_object for a in result.uncertainty.alternatives)]
    shares = score(item) * _probabilities(result)
    hypotheses = [
        {
            "hypothesis": {"class_id": (item.kind or _CAR).lower(), "score": float(share)},
            "pose": {
                "pose": _pose(info, pose, result.box_size),
                "covariance": (known if number == 0 else np.zeros((6, 6))).ravel().tolist(),
            },
        }
        for number, (pose, share) in enumerate(zip(poses, shares, strict=True))
    ]
    box = {"center": _pose(info, result.camera_T_object, result.box_size), "size": plain_vector(result.box_size)}
    return {"header": header, "results": hypotheses, "bbox": box, "id": whole_text(item.name)}


def _probabilities(result: Reconstruction) -> Array:
    """Of a result and its alternatives: as it says, or else by their energies."""
    own = result.uncertainty.pose_probability
    if np.isfinite(own):
        return np.array([own, *(other.probability for other in result.uncertainty.alternatives)])
    excess = np.array([0.0, *(other.excess for other in result.uncertainty.alternatives)])
    odds = np.where(np.isnan(excess), 0.0, np.exp(-np.nan_to_num(excess)))
    return odds / odds.sum()


def pose_covariance(item: NamedResult, info: ImageInfo) -> Array:
    """(6, 6) covariance of the box's centre (x, y, z) and of small turns about the axes of the frame of the message.

    GTSAM's is of turn and shift in the object's own frame, at its origin.
    """
    result = item.result
    assert result.uncertainty.pose_covariance is not None
    rotation = result.camera_T_object[:3, :3]
    if info.world_T_camera is not None:
        rotation = info.world_T_camera[:3, :3] @ rotation
    centre = np.array([0.0, -result.box_size[2] / 2.0, 0.0])
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3], jacobian[:3, 3:], jacobian[3:, :3] = -rotation @ np.cross(centre, np.eye(3)).T, rotation, rotation
    return jacobian @ result.uncertainty.pose_covariance @ jacobian.T


_ROS_TOPICS: Mapping[str, tuple[str, Callable[[_Moment], dict[str, Any]]]] = {
    "vision_msgs/Detection3DArray": ("/fgrecon/detections", _detections),
    "visualization_msgs/MarkerArray": ("/fgrecon/markers", _markers),
    "foxglove_msgs/SceneUpdate": ("/fgrecon/scene", lambda moment: _scene(moment, "nanosec")),
}
"""What is written of an image in ROS 2: topics and messages by their types."""


MAP, WORLD, CAMERA = "map", "world", "camera"
"""Names of the frames."""


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """Where a frame is."""

    child: str  # name of the frame; its parent is `map`
    map_T_child: Array  # (4, 4) its pose


def map_T_camera(ground: Ground | None) -> Array:
    """(4, 4) pose of a camera in an upright frame whose origin lies on the ground below it.

    Args:
        ground: The ground in its frame; None for a level camera of unknown height, which is at the origin.
    """
    up = np.array([0.0, -1.0, 0.0]) if ground is None else -ground.normal
    left = up[0] * up - [1.0, 0.0, 0.0]
    left /= np.linalg.norm(left)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(left, up), left, up])
    pose[2, 3] = 0.0 if ground is None else ground.distance
    return pose


def transforms(moments: Iterable[tuple[Array | None, Ground | None]]) -> Iterator[list[FrameTransform]]:
    """Where `world`, if there is one, and `camera` are at each of some moments.

    Args:
        moments: The pose `world_T_camera` (4, 4) and the ground in the camera's frame, as far as they are known, in
            order of time. A camera whose pose is not known, while others are, is where it was last.
    """
    known = list(moments)
    first = next(((pose, ground) for pose, ground in known if pose is not None), None)
    world = None if first is None else _map_T_world(*first)
    last: Array | None = None
    for pose, ground in known:
        if world is None or (pose is None and last is None):
            here = map_T_camera(ground)
        elif pose is None:
            assert last is not None
            here = last
        else:
            here = last = world @ pose
        yield [*([] if world is None else [FrameTransform(WORLD, world)]), FrameTransform(CAMERA, here)]


def _map_T_world(world_T_camera: Array, ground: Ground | None) -> Array:
    """(4, 4) the world's pose, by a camera in it."""
    upright = map_T_camera(ground)
    up = world_T_camera[:3, :3] @ upright[2, :3]
    if up[2] > UPRIGHT:
        return np.eye(4)
    return upright @ np.linalg.inv(world_T_camera)
