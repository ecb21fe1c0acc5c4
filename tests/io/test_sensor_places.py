"""Which file of a sensor belongs to an image, and where a LiDAR is."""

import json
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.nuscenes import open_nuscenes, sweep_of
from fgrecon.io.sensors.points import CLOUDS, lidar_place
from fgrecon.io.sensors.sensor_files import SensorFiles

P2 = "700 0 600 0 0 700 180 0 0 0 1 0"
LIDAR = "0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3"


def test_files_named_as_the_images(tmp_path: Path) -> None:
    for name in ("000004.bin", "000012.bin", "a.pcd.bin", "notes.txt"):
        (tmp_path / name).touch()
    files = SensorFiles("lidar", str(tmp_path), CLOUDS)
    assert files.of("000012.png") == tmp_path / "000012.bin"
    assert files.of("12.jpg") == tmp_path / "000012.bin"  # a frame of a video
    assert files.of("a.png") == tmp_path / "a.pcd.bin"
    assert files.of("000005.png") is None
    assert len(files.all()) == 3


def test_a_pattern_and_a_file_alone(tmp_path: Path) -> None:
    for name in ("000004.npz", "000004.bin"):
        (tmp_path / name).touch()
    with pytest.raises(InvalidInputError, match="one file for each image"):
        SensorFiles("lidar", str(tmp_path), CLOUDS).of("000004.png")
    assert SensorFiles("lidar", f"{tmp_path}/*.npz", CLOUDS).of("000004.png") == tmp_path / "000004.npz"
    alone = SensorFiles("lidar", str(tmp_path / "000004.bin"), CLOUDS)
    assert alone.of("whatever.png") == tmp_path / "000004.bin"
    with pytest.raises(InvalidInputError, match="that exists"):
        SensorFiles("lidar", str(tmp_path / "gone.npz"), CLOUDS).of("000004.png")
    with pytest.raises(InvalidInputError, match="end in"):
        SensorFiles("lidar", str(tmp_path), ("ply",)).of("000004.png")


def test_a_pose_goes_before_calibrations_and_those_before_what_lies_beside(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    (drive / "image_02").mkdir(parents=True)
    image, cloud = drive / "image_02" / "000004.png", drive / "000004.bin"
    assert lidar_place(cloud, image, CameraSource()) is None
    (drive / "calib.txt").write_text(f"P2: {P2}\nTr_velo_cam {LIDAR}\n")
    beside = lidar_place(cloud, image, CameraSource())
    assert isinstance(beside, KittiCalibration)
    np.testing.assert_allclose(beside.camera_T_lidar[:3], np.array(LIDAR.split(), float).reshape(3, 4))
    (tmp_path / "given.txt").write_text(f"P2: {P2}\n")
    given = lidar_place(cloud, image, CameraSource(calib=tmp_path / "given.txt"))
    assert isinstance(given, KittiCalibration)
    assert given.camera_T_lidar is None
    (tmp_path / "pose.txt").write_text(LIDAR)
    np.testing.assert_allclose(
        lidar_place(cloud, image, CameraSource(), tmp_path / "pose.txt")[:3],
        np.array(LIDAR.split(), float).reshape(3, 4),
    )
    (tmp_path / "pose.txt").write_text(f"{LIDAR}\n{LIDAR}")
    with pytest.raises(InvalidInputError, match="one motion"):
        lidar_place(cloud, image, CameraSource(), tmp_path / "pose.txt")


def test_nuscenes_tables_carry_a_sweep_to_the_time_of_the_image(tmp_path: Path) -> None:
    still = {"rotation": [1, 0, 0, 0]}
    ahead = [0.5, -0.5, 0.5, -0.5]  # of a camera that looks along the vehicle's x
    tables = {
        "calibrated_sensor": [
            {"token": "cam", "translation": [1.5, 0, 1.6], "rotation": ahead},
            {"token": "lid", "translation": [1.0, 0, 1.8], **still},
        ],
        "ego_pose": [
            {"token": "e1", "translation": [10, 0, 0], **still},
            {"token": "e2", "translation": [10.5, 0, 0], **still},
        ],
        "sample_data": [
            {"token": "1", "filename": "samples/CAM/i.jpg", "sample_token": "s", "is_key_frame": True,
             "calibrated_sensor_token": "cam", "ego_pose_token": "e1"},
            {"token": "2", "filename": "samples/LIDAR/p.pcd.bin", "sample_token": "s", "is_key_frame": True,
             "calibrated_sensor_token": "lid", "ego_pose_token": "e2"},
        ],
    }  # fmt: skip
    for name, rows in tables.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(rows))
    assert sweep_of(open_nuscenes(tmp_path), "i.jpg") == "p.pcd.bin"
    motion = lidar_place(Path("p.pcd.bin"), Path("i.jpg"), CameraSource(file=str(tmp_path)))
    point = np.array([20.0, 3.0, -1.0, 1.0])  # of the LiDAR: 20 ahead, 3 to the left
    np.testing.assert_allclose((motion @ point)[:3], [-3.0, 0.8, 20.0], atol=1e-9)
