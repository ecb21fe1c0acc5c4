"""Waymo's messages (protocol buffers) for results, as far as its metrics read them: `label.proto`, `metrics.proto`."""

from __future__ import annotations

from functools import cache
from typing import Any

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
