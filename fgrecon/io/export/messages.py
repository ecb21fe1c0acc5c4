"""The definitions of messages, as far as fgrecon fills them: what an MCAP file carries with it, and Waymo's."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
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

_ROS: Mapping[str, str] = {
    "vision_msgs/Detection3DArray": "std_msgs/Header header, vision_msgs/Detection3D[] detections",
    "vision_msgs/Detection3D": "std_msgs/Header header, vision_msgs/ObjectHypothesisWithPose[] results, "
    "vision_msgs/BoundingBox3D bbox, string id",
    "vision_msgs/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis, "
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/ObjectHypothesis": "string class_id, float64 score",
    "vision_msgs/BoundingBox3D": "geometry_msgs/Pose center, geometry_msgs/Vector3 size",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "visualization_msgs/Marker": "std_msgs/Header header, string ns, int32 id, int32 type, int32 action, "
    "geometry_msgs/Pose pose, geometry_msgs/Vector3 scale, std_msgs/ColorRGBA color, "
    "builtin_interfaces/Duration lifetime, bool frame_locked, geometry_msgs/Point[] points, "
    "std_msgs/ColorRGBA[] colors, string texture_resource, sensor_msgs/CompressedImage texture, "
    "visualization_msgs/UVCoordinate[] uv_coordinates, string text, string mesh_resource, "
    "visualization_msgs/MeshFile mesh_file, bool mesh_use_embedded_materials",
    "visualization_msgs/UVCoordinate": "float32 u, float32 v",
    "visualization_msgs/MeshFile": "string filename, uint8[] data",
    "foxglove_msgs/SceneUpdate": "foxglove_msgs/SceneEntityDeletion[] deletions, foxglove_msgs/SceneEntity[] entities",
    "foxglove_msgs/SceneEntityDeletion": "builtin_interfaces/Time timestamp, uint8 type, string id",
    "foxglove_msgs/SceneEntity": "builtin_interfaces/Time timestamp, string frame_id, string id, "
    "builtin_interfaces/Duration lifetime, bool frame_locked, foxglove_msgs/KeyValuePair[] metadata, "
    "foxglove_msgs/ArrowPrimitive[] arrows, foxglove_msgs/CubePrimitive[] cubes, "
    "foxglove_msgs/SpherePrimitive[] spheres, foxglove_msgs/CylinderPrimitive[] cylinders, "
    "foxglove_msgs/LinePrimitive[] lines, foxglove_msgs/TriangleListPrimitive[] triangles, "
    "foxglove_msgs/TextPrimitive[] texts, foxglove_msgs/ModelPrimitive[] models",
    "foxglove_msgs/KeyValuePair": "string key, string value",
    "foxglove_msgs/Color": "float64 r, float64 g, float64 b, float64 a",
    "foxglove_msgs/ArrowPrimitive": "geometry_msgs/Pose pose, float64 shaft_length, float64 shaft_diameter, "
    "float64 head_length, float64 head_diameter, foxglove_msgs/Color color",
    "foxglove_msgs/CubePrimitive": "geometry_msgs/Pose pose, geometry_msgs/Vector3 size, foxglove_msgs/Color color",
    "foxglove_msgs/SpherePrimitive": "geometry_msgs/Pose pose, geometry_msgs/Vector3 size, foxglove_msgs/Color color",
    "foxglove_msgs/CylinderPrimitive": "geometry_msgs/Pose pose, geometry_msgs/Vector3 size, float64 bottom_scale, "
    "float64 top_scale, foxglove_msgs/Color color",
    "foxglove_msgs/LinePrimitive": "uint8 type, geometry_msgs/Pose pose, float64 thickness, bool scale_invariant, "
    "geometry_msgs/Point[] points, foxglove_msgs/Color color, foxglove_msgs/Color[] colors, uint32[] indices",
    "foxglove_msgs/TriangleListPrimitive": "geometry_msgs/Pose pose, geometry_msgs/Point[] points, "
    "foxglove_msgs/Color color, foxglove_msgs/Color[] colors, uint32[] indices",
    "foxglove_msgs/TextPrimitive": "geometry_msgs/Pose pose, bool billboard, float64 font_size, bool scale_invariant, "
    "foxglove_msgs/Color color, string text",
    "foxglove_msgs/ModelPrimitive": "geometry_msgs/Pose pose, geometry_msgs/Vector3 scale, foxglove_msgs/Color color, "
    "bool override_color, string url, string media_type, uint8[] data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/TransformStamped": "std_msgs/Header header, string child_frame_id, "
    "geometry_msgs/Transform transform",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose, float64[36] covariance",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "sensor_msgs/CompressedImage": "std_msgs/Header header, string format, uint8[] data",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
}
"""Messages of ROS 2 by their fields: vision_msgs 4, visualization_msgs of Humble and later, foxglove_msgs."""

_RULE = f"\n{80 * '='}\n"


def ros_definition(name: str) -> str:
    """A message's definition, such as of `vision_msgs/Detection3DArray`, with those that it is made of."""
    needed = [name]
    for one in needed:  # grows on the way
        kinds = (field.split()[0].partition("[")[0] for field in _ROS[one].split(", "))
        needed += dict.fromkeys(kind for kind in kinds if kind in _ROS and kind not in needed)
    texts = ["\n".join(_ROS[one].split(", ")) for one in needed]
    return _RULE.join([texts[0], *(f"MSG: {one}\n{text}" for one, text in zip(needed[1:], texts[1:], strict=True))])


_MESSAGES = {
    "Box": (
        "double center_x = 1",
        "double center_y = 2",
        "double center_z = 3",
        "double width = 4",
        "double length = 5",
        "double height = 6",
        "double heading = 7",
    ),
    "Label": ("Box box = 1", "int32 type = 3", "string id = 4"),
    "Object": ("Label object = 1", "float score = 2", "string context_name = 4", "int64 frame_timestamp_micros = 5"),
    "Objects": ("repeated Object objects = 1",),
}
"""Fields by message, as a schema has them. `type` is an enumeration there, which is written alike."""


@cache
def objects_class() -> Any:
    """The class of `Objects`, of ONNX Runtime's own protobuf."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    file = FileDescriptorProto(name="objects.proto", package="waymo")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for text in fields:
            *repeated, kind, field, _, number = text.split()
            label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
            added = message.field.add(name=field, number=int(number), label=label)
            if kind in _MESSAGES:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".waymo.{kind}"
            else:
                added.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("waymo.Objects"))
