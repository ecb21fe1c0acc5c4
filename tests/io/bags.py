"""Bags of a made-up drive, written by rosbags: a car body with a camera and a LiDAR goes ahead at 5 m/s."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NANO = 1_000_000_000
START = 1_700_000_000 * NANO + 123_456_789
PERIOD = NANO // 10
SPEED = 5.0
OPTICAL = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
MOUNT = np.array([1.5, 0.1, 1.65])  # of the camera on the body
LIDAR = np.array([0.5, 0.0, 2.0])
VIDEO = """builtin_interfaces/Time timestamp
string frame_id
uint8[] data
string format"""
PACKET = """std_msgs/Header header
int32 width
int32 height
string encoding
uint64 pts
uint8 flags
bool is_bigendian
uint8[] data"""

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(VIDEO, "foxglove_msgs/msg/CompressedVideo"))
STORE.register(get_types_from_msg(PACKET, "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"))
T = SimpleNamespace(**{name.rsplit("/", 1)[1]: kind for name, kind in STORE.types.items()})


def stamp(time):
    return T.Time(sec=int(time // NANO), nanosec=int(time % NANO))


def header(time, frame):
    return T.Header(stamp=stamp(time), frame_id=frame)


def image(pixels, time, frame="camera_optical", encoding="rgb8", pad=0):
    """An `Image` of pixels (H, W, ...), its rows longer than they are by so many bytes."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, pad)), constant_values=77)
    return T.Image(
        header=header(time, frame),
        height=len(pixels) * 2 // 3 if encoding.startswith("nv") else len(pixels),
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.ravel(),
    )


def compressed(pixels, time, frame="camera_optical", ending=".png"):
    """A `CompressedImage` of RGB pixels."""
    content = cv2.imencode(ending, np.ascontiguousarray(pixels[..., ::-1]))[1].ravel()
    return T.CompressedImage(header=header(time, frame), format=f"rgb8; {ending[1:]} compressed bgr8", data=content)


def camera_info(time, size, frame="camera_optical", **changed):
    width, height = size
    focal = 0.8 * width
    k = np.array([focal, 0, (width - 1) / 2, 0, focal, (height - 1) / 2, 0, 0, 1.0])
    p = np.array([0.9 * focal, 0, width / 2, 0, 0, 0.9 * focal, height / 2, 0, 0, 0, 1.0, 0])
    roi = T.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    values = {"height": height, "width": width, "distortion_model": "plumb_bob", "d": np.zeros(5), "k": k, "p": p}
    values |= {"r": np.eye(3).ravel(), "binning_x": 0, "binning_y": 0, "roi": roi} | changed
    return T.CameraInfo(header=header(time, frame), **values)


def placed(place, turn=None):
    x, y, z, w = (turn or Rotation.identity()).as_quat()
    return SimpleNamespace(place=np.asarray(place, dtype=float), quaternion=T.Quaternion(x=x, y=y, z=z, w=w))


def transform(time, parent, child, place, turn=None):
    made = placed(place, turn)
    x, y, z = made.place
    return T.TransformStamped(
        header=header(time, parent),
        child_frame_id=child,
        transform=T.Transform(translation=T.Vector3(x=x, y=y, z=z), rotation=made.quaternion),
    )


def odometry(time, place, turn=None, child="base_link"):
    made = placed(place, turn)
    x, y, z = made.place
    none = T.Vector3(x=0.0, y=0.0, z=0.0)
    pose = T.Pose(position=T.Point(x=x, y=y, z=z), orientation=made.quaternion)
    return T.Odometry(
        header=header(time, "odom"),
        child_frame_id=child,
        pose=T.PoseWithCovariance(pose=pose, covariance=np.zeros(36)),
        twist=T.TwistWithCovariance(twist=T.Twist(linear=none, angular=none), covariance=np.zeros(36)),
    )


def cloud(points, time, frame="lidar", pad=3, row_pad=0, rows=1):
    """A `PointCloud2` of points (N, 3), each with bytes behind it that are none of them."""
    names = [T.PointField(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyz")]
    content = np.ascontiguousarray(points, dtype="<f4").view(np.uint8).reshape(len(points), 12)
    content = np.pad(content, ((0, 0), (0, pad)), constant_values=9).reshape(rows, -1)
    content = np.pad(content, ((0, 0), (0, row_pad)), constant_values=9)
    return T.PointCloud2(
        header=header(time, frame),
        height=rows,
        width=len(points) // rows,
        fields=names,
        is_bigendian=False,
        point_step=12 + pad,
        row_step=content.shape[1],
        data=content.ravel(),
        is_dense=True,
    )


def write(path, messages, storage=StoragePlugin.MCAP):
    """A bag's folder of (topic, time of recording, message), and its one file."""
    with Writer(path, version=9, storage_plugin=storage) as bag:
        topics = {}
        for topic, time, message in messages:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(topics[topic], time, STORE.serialize_cdr(message, kind))
    return next(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))


def write_ros1(path, messages):
    """A bag of ROS 1 of the same messages: headers have a number there, and a camera's matrices other names."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))

    def old(message):
        if not hasattr(message, "__msgtype__"):
            return [old(one) for one in message] if isinstance(message, list) else message
        kind = store.types[message.__msgtype__]
        values = {name: old(value) for name, value in vars(message).items()}
        if message.__msgtype__.endswith("/Header"):
            values["seq"] = 0
        if message.__msgtype__.endswith("/CameraInfo"):
            values |= {name.upper(): values.pop(name) for name in "dkrp"}
        return kind(**values)

    with Writer1(path) as bag:
        topics = {}
        for topic, time, message in messages:
            name = message.__msgtype__
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, name, typestore=store)
            bag.write(topics[topic], time, store.serialize_ros1(old(message), name))
    return path


def frames(count=4, size=(64, 48)):
    """RGB pictures, each another one."""
    width, height = size
    across, down = np.meshgrid(np.linspace(0, 200, width), np.linspace(0, 200, height))
    return [np.stack([across, down, np.full_like(across, 40 * i)], axis=2).astype(np.uint8) for i in range(count)]


def body(time):
    """Place of the body at a time of a header."""
    return np.array([SPEED * (time - START) / NANO, 0.0, 0.0])


def rig(time):
    """What stands still."""
    return [
        transform(time, "base_link", "camera", MOUNT),
        transform(time, "camera", "camera_optical", np.zeros(3), OPTICAL),
        transform(time, "base_link", "lidar", LIDAR),
    ]


def drive(pictures, *, made=image, topic="/camera/image_raw", size=(64, 48), late=3_000_000):
    """The messages of a drive; headers are so much (ns) older than the recording."""
    yield "/tf_static", START, T.TFMessage(transforms=rig(START))
    yield "/camera/camera_info", START, camera_info(START, size)
    for i in range(-1, 2 * len(pictures) + 1):  # the body at twice the rate
        time = START + i * PERIOD // 2 - 11_000_000
        yield "/tf", time + late, T.TFMessage(transforms=[transform(time, "odom", "base_link", body(time))])
        yield "/odom", time + late, odometry(time, body(time))
    for i, one in enumerate(pictures):
        time = START + i * PERIOD
        yield topic, time + late, made(one, time)
        scanned = time + PERIOD // 4
        points = np.array([[20.0, 1.0, -1.0], [21.0, 2.0, -0.5], [np.nan, 0.0, 0.0]]) - [SPEED * 0.1 * i, 0.0, 0.0]
        yield "/points", scanned + late, cloud(points, scanned)
