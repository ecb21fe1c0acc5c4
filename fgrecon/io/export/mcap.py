"""Results as MCAP: Foxglove's `SceneUpdate` to look at, ROS 2's `vision_msgs/Detection3DArray` to work with.

A message for each image, at its time, else ten images a second. Boxes have the axes x forward, y left, z up. Their
frame is `world` where the camera's pose is known, else `camera` (x right, y down, z forward). Both are in `map`, which
is upright (`fgrecon.io.export.upright`): topic `/tf`, before each image.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.text import distinct, whole_text
from fgrecon.core.vehicle_mesh import SURFACE
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
from fgrecon.io.export.messages import DETECTIONS, FRAME_TRANSFORMS, SCENE_UPDATE, TRANSFORMS
from fgrecon.io.export.results import NamedResult
from fgrecon.io.export.upright import CAMERA, MAP, WORLD, FrameTransform, transforms

_PERIOD = 0.1  # seconds between images whose times are not known
_NANO = 1_000_000_000
_MCAP_SECONDS = 2**64 // _NANO  # its times are 64 bits of nanoseconds
_ROS_SECONDS = 2**31  # `builtin_interfaces/Time` has 31 bits of seconds
_LINE_LIST = 2  # pairs of points
_CAR = "car"

Array = NDArray[np.float64]
_Moment = tuple[int, ImageInfo, list[NamedResult]]


def scene_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """MCAP of Foxglove's scene updates (JSON), topic `/fgrecon/scene`: of each vehicle box, wireframe and name.

    Raises:
        InvalidInputError: An image's time is none that MCAP can tell; names it.
        MissingPackageError: mcap is not installed.
    """
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
    for (time, info, items), placed in _with_transforms(_moments(results, images, _MCAP_SECONDS)):
        data = json.dumps({"transforms": [_placed(one, time) for one in placed]}, allow_nan=False).encode()
        writer.add_message(frames, log_time=time, data=data, publish_time=time)
        taken = set[str]()  # of entities with one id only the last would be shown
        entities = [_entity(replace(item, name=distinct(item.name, taken)), info, time) for item in items]
        clear = {"timestamp": _time(time, "nsec"), "type": 1, "id": ""}  # vehicles of the image before
        data = json.dumps({"deletions": [clear], "entities": entities}, allow_nan=False).encode()
        writer.add_message(channel, log_time=time, data=data, publish_time=time)
    writer.finish()
    return sink.getvalue()


def detections_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """MCAP of `vision_msgs/msg/Detection3DArray` (CDR), topic `/fgrecon/detections`.

    The hypotheses of a detection are the result, with its covariance, and then its alternatives, whose covariances are
    not known (zeros). Their scores share that of the detection as their energies say.

    Raises:
        InvalidInputError: An image's time is none that ROS 2 can tell; names it.
        MissingPackageError: mcap-ros2-support is not installed.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingPackageError("mcap>=1.2 mcap-ros2-support>=0.5", "ROS 2 messages") from error
    sink = io.BytesIO()
    writer = Writer(sink)
    schema = writer.register_msgdef("vision_msgs/msg/Detection3DArray", DETECTIONS)
    frames = writer.register_msgdef("tf2_msgs/msg/TFMessage", TRANSFORMS)
    moments = _with_transforms(_moments(results, images, _ROS_SECONDS))
    for number, ((time, info, items), placed) in enumerate(moments):
        stamped = {"transforms": [_stamped(one, time) for one in placed]}
        writer.write_message("/tf", frames, stamped, time, time, number)
        header = {"stamp": _time(time, "nanosec"), "frame_id": _frame(info)}
        message = {"header": header, "detections": [_detection(item, info, header) for item in items]}
        writer.write_message("/fgrecon/detections", schema, message, time, time, number)
    writer.finish()
    return sink.getvalue()


def _moments(results: Sequence[NamedResult], images: Mapping[str, ImageInfo], below: int) -> Iterator[_Moment]:
    """Time in nanoseconds, what is known of the image, and vehicles, of every image.

    Images without vehicles whose times are known are among them: what was seen before is gone there.

    Args:
        results: The vehicles.
        images: What is known of their images.
        below: Seconds from which on the file cannot tell the time.

    Raises:
        InvalidInputError: An image's time is negative or too late.
    """
    found = by_image(results)
    seen = {name for image in found for name in names_of(image)}
    empty: dict[str, list[NamedResult]] = {
        name: [] for name, info in images.items() if name not in seen and info.timestamp is not None
    }
    moments = []
    for number, (image, items) in enumerate((found | empty).items()):
        info = info_of(image, images)
        seconds = number * _PERIOD if info.timestamp is None else info.timestamp
        if not 0.0 <= seconds < below:
            fix = f"Give seconds, from 0 to less than {below}, by a file of images (`images`, --images)."
            raise InvalidInputError(f"images.{image or EVERY}.timestamp", seconds, fix)
        moments.append((round(seconds * _NANO), info, items))
    yield from sorted(moments, key=lambda moment: moment[0])


def _with_transforms(moments: Iterator[_Moment]) -> Iterator[tuple[_Moment, list[FrameTransform]]]:
    """Each moment with the frames at it."""
    every = list(moments)
    grounds = [next((item.ground for item in items if item.ground is not None), None) for _, _, items in every]
    any_ground: Ground | None = next((ground for ground in grounds if ground is not None), None)
    known = [(info.world_T_camera, ground or any_ground) for (_, info, _), ground in zip(every, grounds, strict=True)]
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
    return {"sec": nanoseconds // _NANO, rest: nanoseconds % _NANO}


def _frame(info: ImageInfo) -> str:
    return CAMERA if info.world_T_camera is None else WORLD


def _pose(info: ImageInfo, camera_T_object: Array, size: Array) -> dict[str, Any]:
    centre, axes = box_in(info, camera_T_object, size)
    return {"position": plain_vector(centre), "orientation": plain_quaternion(axes)}


def _entity(item: NamedResult, info: ImageInfo, time: int) -> dict[str, Any]:
    """A vehicle in Foxglove's scene."""
    result = item.result
    pose, size = result.camera_T_object, result.box_size
    placed = pose if info.world_T_camera is None else info.world_T_camera @ pose
    points = transform(placed, result.wireframe[result.shape.edges.ravel()])
    red, green, blue = (value / 255 for value in SURFACE)
    colour = {"r": red, "g": green, "b": blue}
    box = _pose(info, pose, size)
    still = {"position": plain_vector([0, 0, 0]), "orientation": plain_quaternion(np.eye(3))}
    line = {"type": _LINE_LIST, "pose": still, "thickness": 2.0, "scale_invariant": True}
    text = {"billboard": True, "font_size": 12.0, "scale_invariant": True, "text": item.name}
    content = {"status": result.status.value, "message": result.message, "score": f"{score(item):.3f}"}
    return {
        "timestamp": _time(time, "nsec"),
        "frame_id": _frame(info),
        "id": item.name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [{"key": key, "value": value} for key, value in content.items()],
        **{name: [] for name in ("arrows", "spheres", "cylinders", "triangles", "models")},
        "cubes": [{"pose": box, "size": plain_vector(size), "color": colour | {"a": 0.3}}],
        "lines": [
            line
            | {"points": [plain_vector(point) for point in points], "color": colour | {"a": 1.0}}
            | {"colors": [], "indices": []}
        ],
        "texts": [text | {"pose": box, "color": colour | {"a": 1.0}}],
    }


def _detection(item: NamedResult, info: ImageInfo, header: dict[str, Any]) -> dict[str, Any]:
    """A vehicle in ROS 2."""
    result = item.result
    known = np.zeros((6, 6)) if result.uncertainty.pose_covariance is None else pose_covariance(item, info)
    poses = [result.camera_T_object, *(a.camera_T_object for a in result.uncertainty.alternatives)]
    shares = score(item) * _probabilities(result)
    hypotheses = [
        {
            "hypothesis": {"class_id": _CAR, "score": float(share)},
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
    shares: Array = odds / odds.sum()
    return shares


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
    covariance: Array = jacobian @ result.uncertainty.pose_covariance @ jacobian.T
    return covariance
