"""Foxglove's own messages, written by its schemas: pictures, camera, poses and points as they were."""

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.bag_drive import LidarTopic, open_bag_drive

pytestmark = pytest.mark.formats
pytest.importorskip("rosbags")
pytest.importorskip("mcap")

TIMES = [1_700_000_000_123_456_789 + i * 100_000_000 for i in range(3)]
OPTICAL = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
MOUNTS = {"camera": ([1.5, 0.1, 1.65], OPTICAL), "lidar": ([0.5, 0.0, 2.0], Rotation.from_euler("z", 0.3))}
POINTS = [[10.0, 1.0, -0.5], [20.0, -2.0, 0.25], [15.5, 3.0, 0.75]]
CLOUD = ([0.1, -0.2, 0.3], Rotation.from_euler("x", 0.2))
SIZE = 64, 48
PIXELS = np.arange(48 * 64 * 3, dtype=np.uint32).astype(np.uint8).reshape(48, 64, 3)


def _pose(place, turn):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), place
    return matrix


@pytest.fixture(params=["protobuf", "json"])
def bag(tmp_path, devkit, request):
    path = tmp_path / "drive.mcap"
    poses = [([0.5 * i, 0.1 * i, 0.0], Rotation.from_euler("z", 0.1 * i)) for i in range(3)]
    plain = {name: (place, turn.as_quat().tolist()) for name, (place, turn) in MOUNTS.items()}
    given = {
        "times": TIMES,
        "poses": [(place, turn.as_quat().tolist()) for place, turn in poses],
        "mounts": plain,
        "size": SIZE,
        "K": [50.0, 0, 31.5, 0, 51.0, 23.5, 0, 0, 1],
        "D": [0.01, -0.002, 0.003, -0.001],
        "image": cv2.imencode(".png", np.ascontiguousarray(PIXELS[..., ::-1]))[1].tobytes().hex(),
        "points": POINTS,
        "cloud_pose": (CLOUD[0], CLOUD[1].as_quat().tolist()),
    }
    devkit("foxglove", "foxglove_writes", path, request.param, given=json.dumps(given))
    return path, [_pose(*one) for one in poses]


def test_pictures_camera_poses_and_points(bag):
    path, bodies = bag
    drive = open_bag_drive(f"{path}#/camera/image", lidar=LidarTopic("/points"))
    frames = list(drive.frames.read())
    assert [frame.time for frame in frames] == pytest.approx([time * 1e-9 for time in TIMES])
    assert all((frame.image == PIXELS).all() for frame in frames)
    assert (drive.camera.distortion_model, drive.camera.image_size) == ("fisheye", SIZE)
    assert drive.camera.matrix.tolist() == [[50.0, 0.0, 31.5], [0.0, 51.0, 23.5], [0.0, 0.0, 1.0]]
    poses = drive.poses(None)
    clouds = drive.clouds(LidarTopic("/points"))
    for number, body in enumerate(bodies):
        expected = body @ _pose(*MOUNTS["camera"])
        assert np.abs(poses.by_frame[number] - expected).max() < 1e-9
        camera_T_lidar = np.linalg.inv(_pose(*MOUNTS["camera"])) @ _pose(*MOUNTS["lidar"])
        (points,) = clouds.evidence(number)
        wanted = transform(camera_T_lidar @ _pose(*CLOUD), np.array(POINTS))
        assert np.abs(points.points - wanted).max() < 1e-6
    assert not drive.warnings


def test_topics_are_listed_and_raw_pictures_are_read(bag):
    path, _ = bag
    with pytest.raises(InvalidInputError, match=r"/camera/image, /raw/image"):
        open_bag_drive(path)
    assert not next(open_bag_drive(f"{path}#/raw/image").frames.read()).image.any()


def test_a_cut_file_is_refused(bag):
    path, _ = bag
    path.write_bytes(path.read_bytes()[:-900])
    with pytest.raises(InvalidInputError, match="mcap recover"):
        open_bag_drive(path)
