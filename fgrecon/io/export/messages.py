"""The definitions of the messages that an MCAP file carries with it, as far as fgrecon fills them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _INTEGER, _TEXT, _FLAG = ({"type": kind} for kind in ("number", "integer", "string", "boolean"))
_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER))
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE = _object(
    type=_INTEGER,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant=_FLAG,
    points=_list(_VECTOR),
    color=_COLOUR,
    colors=_list(_COLOUR),
    indices=_list(_INTEGER),
)
_LABEL = _object(pose=_POSE, billboard=_FLAG, font_size=_NUMBER, scale_invariant=_FLAG, color=_COLOUR, text=_TEXT)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_FLAG,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    **{name: _list({"type": "object"}) for name in ("arrows", "spheres", "cylinders", "triangles", "models")},
    cubes=_list(_object(pose=_POSE, size=_VECTOR, color=_COLOUR)),
    lines=_list(_LINE),
    texts=_list(_LABEL),
)

SCENE_UPDATE: Mapping[str, Any] = {
    "title": "foxglove.SceneUpdate",
    **_object(deletions=_list(_object(timestamp=_TIME, type=_INTEGER, id=_TEXT)), entities=_list(_ENTITY)),
}
"""JSON schema of `foxglove.SceneUpdate`."""

FRAME_TRANSFORMS: Mapping[str, Any] = {
    "title": "foxglove.FrameTransforms",
    **_object(
        transforms=_list(
            _object(
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_VECTOR,
                rotation=_POSE["properties"]["orientation"],
            )
        )
    ),
}
"""JSON schema of `foxglove.FrameTransforms`."""

_DEFINITIONS = {
    "": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "vision_msgs/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
}

_RULE = f"\n{80 * '='}\n"

_OF_TRANSFORMS = {
    "": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    **{
        name: _DEFINITIONS[name]
        for name in (
            *("std_msgs/Header", "builtin_interfaces/Time"),
            *("geometry_msgs/Vector3", "geometry_msgs/Quaternion"),
        )
    },
}


def _text(definitions: Mapping[str, str]) -> str:
    """A definition, with those that it is made of."""
    return _RULE.join(f"MSG: {name}\n{text}" if name else text for name, text in definitions.items())


DETECTIONS = _text(_DEFINITIONS)
"""Definition of `vision_msgs/msg/Detection3DArray` (vision_msgs 4)."""

TRANSFORMS = _text(_OF_TRANSFORMS)
"""Definition of `tf2_msgs/msg/TFMessage`."""
