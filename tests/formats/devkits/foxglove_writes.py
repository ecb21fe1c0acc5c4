"""A drive of Foxglove's messages: FILE protobuf|json < JSON of times (ns), poses of the body, image (hex), points."""

import json
import sys
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.json_format import MessageToDict
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer as PlainWriter
from mcap_protobuf.writer import Writer

given = json.load(sys.stdin)


def stamp(time):
    return Timestamp(seconds=time // 10**9, nanos=time % 10**9)


def put(message, place, turn):
    for name, value in zip("xyz", place, strict=True):
        setattr(message[0], name, value)
    for name, value in zip("xyzw", turn, strict=True):
        setattr(message[1], name, value)


PLAIN = {"use_integers_for_enums": True, "always_print_fields_with_no_presence": True}


def as_json(message):
    """As Foxglove's JSON schemas have it: as protobuf's own mapping, but for times and numbers of kinds."""
    found = MessageToDict(message, preserving_proto_field_name=True, **PLAIN)
    found["timestamp"] = {"sec": message.timestamp.seconds, "nsec": message.timestamp.nanos}
    for one in (found, *found.get("transforms", ())):
        one["timestamp"] = found["timestamp"]
    return json.dumps(found).encode()


class JsonWriter:
    """As the writer of protobuf."""

    def __init__(self, file):
        self.writer, self.channels = PlainWriter(file), {}
        self.writer.start()

    def write_message(self, topic, message, log_time, publish_time):
        if topic not in self.channels:
            schema = self.writer.register_schema(message.DESCRIPTOR.full_name, "jsonschema", b"{}")
            self.channels[topic] = self.writer.register_channel(topic, "json", schema)
        self.writer.add_message(self.channels[topic], log_time, as_json(message), publish_time)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.writer.finish()


with Path(sys.argv[1]).open("wb") as file, (JsonWriter if sys.argv[2] == "json" else Writer)(file) as writer:

    def write(topic, message, time):
        message.timestamp.CopyFrom(stamp(time))
        writer.write_message(topic, message, time + 3_000_000, time + 2_000_000)

    first = given["times"][0]
    for child, (place, turn) in given["mounts"].items():
        still = FrameTransform(parent_frame_id="body", child_frame_id=child)
        put((still.translation, still.rotation), place, turn)
        write("/mounts", still, first)
    width, height = given["size"]
    info = CameraCalibration(frame_id="camera", width=width, height=height, distortion_model="kannala_brandt")
    info.K.extend(given["K"])
    info.D.extend(given["D"])
    write("/camera/calibration", info, first)
    for time, (place, turn) in zip(given["times"], given["poses"], strict=True):
        odometry = Odometry(frame_id="odom", body_frame_id="body")
        put((odometry.pose.position, odometry.pose.orientation), place, turn)
        write("/odometry", odometry, time)
        image = bytes.fromhex(given["image"])
        write("/camera/image", CompressedImage(frame_id="camera", format="png", data=image), time)
        raw = RawImage(frame_id="camera", width=width, height=height, encoding="rgb8", step=3 * width)
        raw.data = bytes(3 * width * height)
        write("/raw/image", raw, time)
        points = np.array(given["points"])
        table = np.zeros(len(points), dtype=[("tag", "u2"), ("x", "<f8"), ("y", "<f8"), ("z", "<f4")])
        table["x"], table["y"], table["z"] = points.T
        kinds = {"tag": 3, "x": 8, "y": 8, "z": 7}
        fields = [PackedElementField(name=n, offset=table.dtype.fields[n][1], type=k) for n, k in kinds.items()]
        cloud = PointCloud(frame_id="lidar", point_stride=table.itemsize, fields=fields, data=table.tobytes())
        put((cloud.pose.position, cloud.pose.orientation), *given["cloud_pose"])
        write("/points", cloud, time)
