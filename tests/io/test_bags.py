"""Bags as drives: pictures, times, camera, poses and points, written by rosbags and read back."""

from dataclasses import replace
from fractions import Fraction

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag2 import StoragePlugin

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.bag import is_bag
from fgrecon.io.bag_drive import LidarTopic, open_bag_drive
from fgrecon.io.source_frames import Choice
from tests.io import bags

WORLD_T_CAMERA = np.eye(4)
WORLD_T_CAMERA[:3, :3], WORLD_T_CAMERA[:3, 3] = bags.OPTICAL.as_matrix(), bags.MOUNT


@pytest.fixture(scope="module")
def pictures():
    return bags.frames()


@pytest.fixture(scope="module")
def drive(tmp_path_factory, pictures):
    return bags.write(tmp_path_factory.mktemp("bag") / "drive", bags.drive(pictures))


def images(opened, after=None):
    return [frame.image for frame in opened.frames.read(after)]


def test_pictures_come_at_the_times_of_their_headers(drive, pictures):
    opened = open_bag_drive(drive)
    read = list(opened.frames.read())
    assert [frame.number for frame in read] == [0, 1, 2, 3]
    assert [frame.name for frame in read] == [f"{drive.name}#{i}" for i in range(4)]
    assert opened.times == tuple(bags.START + i * bags.PERIOD for i in range(4))
    assert np.abs(np.array(opened.frames.times) - [time / 1e9 for time in opened.times]).max() < 1e-6
    assert all((frame.image == one).all() for frame, one in zip(read, pictures, strict=True))


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_files_and_folders_of_both_storages_are_read(tmp_path, pictures, storage):
    file = bags.write(tmp_path / "drive", bags.drive(pictures), storage)
    for path in (file, tmp_path / "drive"):
        assert is_bag(path)
        assert is_bag(f"{path}#/camera/image_raw")
        assert (images(open_bag_drive(path))[2] == pictures[2]).all()
    assert not is_bag(tmp_path)


def test_bags_of_ros_1_are_read(tmp_path, pictures):
    lidar = LidarTopic("/points")
    opened = open_bag_drive(bags.write_ros1(tmp_path / "drive.bag", bags.drive(pictures)), lidar=lidar)
    assert opened.times == tuple(bags.START + i * bags.PERIOD for i in range(4))
    assert (images(opened)[2] == pictures[2]).all()
    assert np.allclose(opened.camera.matrix, [[51.2, 0, 31.5], [0, 51.2, 23.5], [0, 0, 1]])
    assert np.allclose(opened.poses(None).at(0, 0.0), WORLD_T_CAMERA, atol=1e-6)
    assert len(opened.clouds(lidar).evidence(0)[0].points) == 2


def test_frames_are_chosen_as_those_of_videos(drive, pictures):
    opened = open_bag_drive(drive, choice=Choice(every=2, start=0.15))
    assert opened.frames.numbers == (2,)
    assert opened.frames.count == 1
    assert (images(opened)[0] == pictures[2]).all()
    assert [frame.number for frame in open_bag_drive(drive).frames.read(after=1)] == [2, 3]
    with pytest.raises(InvalidInputError, match=r"start.*the frames last 0\.3 seconds"):
        open_bag_drive(drive, choice=Choice(start=5.0))


def encoded(pixels):
    """A picture in every encoding, and what it is as RGB."""
    red = pixels[..., 0]
    grey = np.repeat(red[..., None], 3, axis=2)
    bayer = np.zeros(red.shape, np.uint8)
    bayer[0::2, 0::2], bayer[0::2, 1::2], bayer[1::2, 0::2], bayer[1::2, 1::2] = 200, 90, 90, 30
    mosaic = np.broadcast_to(np.array([200, 90, 30], np.uint8), pixels.shape)
    even = np.full((*red.shape, 2), 128, np.uint8)
    even[..., 1] = red
    yuyv = even[..., ::-1]
    nv12 = np.concatenate([red, np.full((len(red) // 2, red.shape[1]), 128, np.uint8)])
    alpha = np.full((*red.shape, 1), 7, np.uint8)
    yuv_grey = cv2.cvtColor(nv12, cv2.COLOR_YUV2RGB_NV12)
    return {
        "rgb8": (pixels, pixels),
        "bgr8": (pixels[..., ::-1], pixels),
        "8UC3": (pixels[..., ::-1], pixels),
        "rgba8": (np.concatenate([pixels, alpha], axis=2), pixels),
        "bgra8": (np.concatenate([pixels[..., ::-1], alpha], axis=2), pixels),
        "mono8": (red, grey),
        "mono16": (red.astype("<u2") * 256 + 5, grey),
        "bayer_rggb8": (bayer, mosaic),
        "bayer_bggr8": (bayer[::-1, ::-1], mosaic),
        "bayer_grbg8": (bayer[:, ::-1], mosaic),
        "bayer_gbrg8": (bayer[::-1], mosaic),
        "bayer_rggb16": (bayer.astype("<u2") * 256, mosaic),
        "uyvy": (even, yuv_grey),
        "yuyv": (yuyv, yuv_grey),
        "nv12": (nv12, yuv_grey),
    }


@pytest.mark.parametrize("pad", [0, 6])
@pytest.mark.parametrize("encoding", list(encoded(bags.frames(1)[0])))
def test_raw_pictures_of_every_encoding(tmp_path, encoding, pad):
    given, wanted = encoded(bags.frames(1)[0])[encoding]
    message = bags.image(np.ascontiguousarray(given), bags.START, encoding=encoding, pad=pad)
    (read,) = images(open_bag_drive(bags.write(tmp_path / "one", [("/image", bags.START, message)])))
    assert read.shape == wanted.shape
    off = np.abs(read.astype(int) - wanted)[2:-2, 2:-2]
    assert off.max() <= (2 if encoding in ("uyvy", "yuyv", "nv12") else 0)


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_compressed_pictures_are_rgb(tmp_path, pictures, ending):
    def made(pixels, time):
        return bags.compressed(pixels, time, ending=ending)

    topic = "/camera/image_raw/compressed"
    opened = open_bag_drive(bags.write(tmp_path / "drive", bags.drive(pictures, made=made, topic=topic)))
    assert opened.camera is not None  # its CameraInfo is two names above
    assert np.abs(images(opened)[1].astype(int) - pictures[1]).mean() < (0.1 if ending == ".png" else 4)


def film(pictures, codec="h264"):
    """The packets of a film, each a picture, in Annex B."""
    av = pytest.importorskip("av")
    encoder = av.CodecContext.create({"h264": "libx264"}[codec], "w")
    encoder.width, encoder.height, encoder.pix_fmt = pictures[0].shape[1], pictures[0].shape[0], "yuv420p"
    encoder.time_base, encoder.options = Fraction(1, 10), {"tune": "zerolatency", "preset": "ultrafast", "crf": "4"}
    packets = [p for one in pictures for p in encoder.encode(av.VideoFrame.from_ndarray(one, format="rgb24"))]
    return [np.frombuffer(bytes(packet), np.uint8) for packet in [*packets, *encoder.encode(None)]]


@pytest.mark.parametrize("kind", ["CompressedVideo", "CompressedImage", "FFMPEGPacket"])
def test_films_are_decoded_from_their_beginning(tmp_path, pictures, kind):
    packets = film(pictures)

    def made(i, time):
        if kind == "CompressedVideo":
            return bags.T.CompressedVideo(
                timestamp=bags.stamp(time), frame_id="camera_optical", data=packets[i], format="h264"
            )
        header = bags.header(time, "camera_optical")
        if kind == "FFMPEGPacket":
            rest = {"width": 64, "height": 48, "pts": i, "flags": 0, "is_bigendian": False}
            return bags.T.FFMPEGPacket(header=header, data=packets[i], encoding="libx264", **rest)
        return bags.T.CompressedImage(header=header, data=packets[i], format="h264")

    messages = list(bags.drive(range(4), made=made, topic="/camera/video"))
    opened = open_bag_drive(bags.write(tmp_path / "drive", messages))
    assert opened.times[3] == bags.START + 3 * bags.PERIOD
    read = images(opened)
    assert max(np.abs(one.astype(int) - wanted).mean() for one, wanted in zip(read, pictures, strict=True)) < 6
    assert (images(opened, after=1)[0] == read[2]).all()
    headless = [m for m in messages if m[0] != "/camera/video" or m[1] > bags.START + bags.PERIOD // 2]
    broken = list(open_bag_drive(bags.write(tmp_path / "headless", headless)).frames.read())
    assert [frame.image for frame in broken] == [None] * 3
    assert "/camera/video: message 0" in broken[0].problem


def test_the_camera_is_the_one_beside_the_pictures(tmp_path, drive, pictures):
    camera = open_bag_drive(drive).camera
    assert camera.image_size == (64, 48)
    assert np.allclose(camera.matrix, [[51.2, 0, 31.5], [0, 51.2, 23.5], [0, 0, 1]])
    messages = list(bags.drive(pictures, topic="/other/image_rect_color"))
    rectified = open_bag_drive(bags.write(tmp_path / "rect", messages)).camera  # of its frame
    assert np.allclose(rectified.matrix, [[46.08, 0, 32], [0, 46.08, 24], [0, 0, 1]])
    region = bags.T.RegionOfInterest(x_offset=8, y_offset=4, height=40, width=48, do_rectify=False)
    changed = {"roi": region, "binning_x": 2, "binning_y": 2, "d": np.array([0.1, 0.01, 0.0, 0.0, 0.0])}
    info = bags.camera_info(bags.START, (64, 48), **changed)
    messages = [(t, n, info if t == "/camera/camera_info" else m) for t, n, m in bags.drive(pictures)]
    camera = open_bag_drive(bags.write(tmp_path / "region", messages)).camera
    assert camera.image_size == (24, 20)
    assert np.allclose(camera.matrix, [[25.6, 0, 11.75], [0, 25.6, 9.75], [0, 0, 1]])  # as image_geometry
    assert camera.distortion[0] == 0.1
    for wrong, known in (({"k": np.zeros(9)}, None), ({"distortion_model": "omni", "d": np.ones(4)}, "omni")):
        info = bags.camera_info(bags.START, (64, 48), **wrong)
        messages = [(t, n, info if t == "/camera/camera_info" else m) for t, n, m in bags.drive(pictures)]
        opened = open_bag_drive(bags.write(tmp_path / f"wrong-{known}", messages))
        if known is None:
            assert opened.camera is None
            continue
        with pytest.raises(InvalidInputError, match=r"/camera/camera_info: distortion_model.*omni"):
            _ = opened.camera


@pytest.mark.parametrize("wanted", [None, "/odom", "odom"])
def test_poses_are_interpolated_to_the_times_of_the_pictures(drive, wanted):
    poses = open_bag_drive(drive).poses(wanted)
    for number in range(4):
        expected = WORLD_T_CAMERA.copy()
        expected[0, 3] += 0.5 * number
        assert np.allclose(poses.at(number, 0.0), expected, atol=1e-6)


def test_without_odometry_the_tree_tells_and_without_either_nothing(tmp_path, pictures):
    for left_out, known in (("/odom", True), ("/tf", True), ("/tf/odom", False)):
        messages = [m for m in bags.drive(pictures) if m[0] not in left_out.replace("/odom", " /odom").split()]
        opened = open_bag_drive(bags.write(tmp_path / left_out.replace("/", "-"), messages))
        assert (opened.poses(None) is not None) == known
    several = [*bags.drive(pictures), *((t + "/raw", n, m) for t, n, m in bags.drive(pictures) if t == "/odom")]
    opened = open_bag_drive(bags.write(tmp_path / "several", several))
    with pytest.raises(InvalidInputError, match=r"poses.*2 topics.*/odom, /odom/raw"):
        opened.poses(None)
    assert opened.poses("/odom/raw").at(0, 0.0) is not None
    with pytest.raises(InvalidInputError, match=r"#/nowhere.*base_link, camera,"):
        opened.poses("/nowhere")


def test_a_frame_with_z_up_is_a_body(tmp_path, pictures):
    def made(pixels, time):
        return bags.image(pixels, time, frame="camera")

    opened = open_bag_drive(bags.write(tmp_path / "body", bags.drive(pictures, made=made)))
    assert np.allclose(opened.poses(None).at(0, 0.0), WORLD_T_CAMERA, atol=1e-6)
    (line,) = opened.warnings
    assert "z up" in line
    assert not open_bag_drive(bags.write(tmp_path / "optical", bags.drive(pictures))).warnings


@pytest.mark.parametrize("frame", ["camera_optical", "camera"])
def test_points_stand_still_in_the_world_while_the_body_moves(tmp_path, pictures, frame):
    def made(pixels, time):
        return bags.image(pixels, time, frame=frame)

    lidar = LidarTopic("/points")
    opened = open_bag_drive(bags.write(tmp_path / "drive", bags.drive(pictures, made=made)), lidar=lidar)
    clouds = opened.clouds(lidar)
    for number in range(4):
        (points,) = clouds.evidence(number)
        pose = opened.poses(None).at(number, 0.0)
        placed = points.points @ pose[:3, :3].T + pose[:3, 3]
        scanned = bags.LIDAR + np.array([bags.SPEED * (0.1 * number + 0.025), 0, 0])
        wanted = np.array([[20.0, 1.0, -1.0], [21.0, 2.0, -0.5]]) - [0.5 * number, 0, 0] + scanned
        if number < 3:  # the last scan is after the last pose
            assert np.allclose(placed, wanted, atol=1e-5)
        assert np.allclose(points.origin, np.linalg.inv(pose)[:3] @ [*scanned, 1.0], atol=1e-5) or number == 3


def test_points_of_any_layout(tmp_path, pictures):
    from fgrecon.io.bag_drive import cloud_points

    points = np.arange(18.0).reshape(6, 3)
    for change in ({}, {"pad": 0}, {"rows": 2}, {"rows": 2, "row_pad": 8}):
        assert (cloud_points(bags.cloud(points, bags.START, **change), "") == points).all()
    message = bags.cloud(points, bags.START)
    with pytest.raises(InvalidInputError, match=r"/points: data.*whole clouds"):
        cloud_points(replace(message, data=message.data[:-10]), "/points: ")
    with pytest.raises(InvalidInputError, match=r"fields.*x, y"):
        cloud_points(replace(message, fields=message.fields[:2]), "/points: ")


def test_a_lidar_without_a_place_needs_one(tmp_path, pictures):
    messages = [m for m in bags.drive(pictures) if m[0] != "/tf_static"]
    file = bags.write(tmp_path / "drive", messages)
    opened = open_bag_drive(file, lidar=LidarTopic("/points"))
    with pytest.raises(InvalidInputError, match=r"/points.*lidar.*camera_optical.*--lidar-pose"):
        opened.clouds(LidarTopic("/points"))
    (tmp_path / "pose.txt").write_text("0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n")
    (points,) = opened.clouds(LidarTopic("/points", tmp_path / "pose.txt")).evidence(0)
    assert np.allclose(points.points[0], [-0.9, 1.2, 20.3])
    with pytest.raises(InvalidInputError, match=r"lidar.*#/nowhere.*/points"):
        opened.clouds(LidarTopic("/nowhere"))


def test_headers_without_times_are_reported_and_the_recording_counts(tmp_path, pictures):
    messages = [("/image", bags.START + i * bags.PERIOD, bags.image(one, 0)) for i, one in enumerate(pictures)]
    opened = open_bag_drive(bags.write(tmp_path / "drive", messages))
    assert opened.times == tuple(bags.START + i * bags.PERIOD for i in range(4))
    assert opened.warnings == ["/image: no header has a time; those of the recording are taken."]


def test_several_topics_are_listed(tmp_path, pictures):
    second = [("/second/image", n, m) for t, n, m in bags.drive(pictures) if t == "/camera/image_raw"]
    file = bags.write(tmp_path / "drive", [*bags.drive(pictures), *second])
    with pytest.raises(InvalidInputError, match=r"source.*2 topics of.*pictures: /camera/image_raw, /second/image"):
        open_bag_drive(file)
    assert open_bag_drive(f"{file}#/second/image").frames.topic == "/second/image"
    with pytest.raises(InvalidInputError, match=r"#/odom.*pictures: /camera/image_raw, /second/image"):
        open_bag_drive(f"{file}#/odom")


def damaged(tmp_path, pictures, change):
    def made(pixels, time):
        return change(bags.image(pixels, time))

    return list(open_bag_drive(bags.write(tmp_path / "drive", bags.drive(pictures, made=made))).frames.read())


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"encoding": "32FC1"}, r"/camera/image_raw: encoding.*32FC1.*grey, RGB"),
        ({"step": 10}, r"/camera/image_raw: data.*step 10.*3 bytes a pixel"),
        ({"data": np.zeros(7, np.uint8)}, r"data.*7 bytes"),
        ({"width": 0}, r"data.*0 x 48"),
    ],
)
def test_malformed_pictures_are_gaps(tmp_path, pictures, changed, problem):
    import re

    read = damaged(tmp_path, pictures, lambda message: replace(message, **changed))
    assert all(frame.image is None and re.search(problem, frame.problem) for frame in read)


@pytest.mark.parametrize("cut", [0, 5, 40, 400, -3])
def test_cut_bags_are_refused(tmp_path, drive, cut):
    file = tmp_path / "cut.mcap"
    file.write_bytes(drive.read_bytes()[:cut])
    with pytest.raises(InvalidInputError, match=r"source.*cut\.mcap.*mcap recover"):
        open_bag_drive(file)


def test_loops_and_quaternions_that_are_none_are_refused(tmp_path, pictures):
    loop = bags.T.TFMessage(transforms=[bags.transform(bags.START, "lidar", "odom", np.zeros(3))])
    file = bags.write(tmp_path / "loop", [*bags.drive(pictures), ("/tf_static", bags.START, loop)])
    with pytest.raises(InvalidInputError, match=r"tf.*camera_optical to camera.*without a loop"):
        open_bag_drive(file).poses("odom")
    none = bags.transform(bags.START, "odom", "thing", np.zeros(3))
    none = replace(none, transform=replace(none.transform, rotation=bags.T.Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)))
    message = bags.T.TFMessage(transforms=[none])
    file = bags.write(tmp_path / "none", [*bags.drive(pictures), ("/tf_static", bags.START, message)])
    with pytest.raises(InvalidInputError, match=r"/tf_static: odom to thing.*unit quaternion"):
        open_bag_drive(file)


def test_foxgloves_messages_are_found_by_their_schemas_alone(tmp_path):
    """A set of files in any order; `tests/formats/test_foxglove.py` has the whole drive by Foxglove's own schemas."""
    from google.protobuf import descriptor_pb2, timestamp_pb2
    from mcap.writer import Writer as McapWriter

    from fgrecon.io.bag import open_foxglove

    file = descriptor_pb2.FileDescriptorProto(name="image.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    kind = file.message_type.add(name="CompressedImage")
    for number, (name, code) in enumerate({"frame_id": 9, "data": 12, "format": 9}.items(), start=1):
        kind.field.add(name=name, number=number, type=code, label=1)
    kind.field.add(name="timestamp", number=4, type=11, label=1, type_name=".google.protobuf.Timestamp")
    stamp_file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp_file)
    schema = descriptor_pb2.FileDescriptorSet(file=[file, stamp_file]).SerializeToString()
    path = tmp_path / "drive.mcap"
    content = cv2.imencode(".png", np.full((4, 6, 3), 7, np.uint8))[1].tobytes()
    with path.open("wb") as sink:
        writer = McapWriter(sink)
        writer.start()
        known = writer.register_schema("foxglove.CompressedImage", "protobuf", schema)
        channel = writer.register_channel("/camera", "protobuf", known)
        made = b"\x0a\x03cam\x12" + _varint(len(content)) + content + b"\x1a\x03png\x22\x02\x08\x05"  # at 5 s
        writer.add_message(channel, 10, made, 10)
        writer.add_message(channel, 20, b"\xff", 20)
        writer.finish()
    bag = open_foxglove(path)
    assert dict(bag.topics) == {"/camera": "sensor_msgs/msg/CompressedImage"}
    (_, first), (_, second) = ((time, found) for _, time, found in bag.messages(["/camera"]))
    assert bag.stamp("/camera", first) == 5_000_000_000
    message = bag.message("/camera", first)
    assert (message.header.frame_id, message.format, bytes(message.data)) == ("cam", "png", content)
    with pytest.raises(InvalidInputError, match=r"/camera.*whole messages of foxglove.CompressedImage"):
        bag.message("/camera", second)


def _varint(number):
    return bytes([number & 127 | 128, number >> 7]) if number > 127 else bytes([number])
