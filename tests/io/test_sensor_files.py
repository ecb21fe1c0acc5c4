"""Points and depth maps of files, written as other programs write them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.sensors.pixel_files import read_depth
from fgrecon.io.sensors.points import read_points

POINTS = np.array([[1.0, 2.0, 10.0], [-3.0, 0.5, 20.25], [4.0, -1.0, 5.5]])
P2 = "700 0 600 42 0 700 180 7 0 0 1 0.01"
LIDAR = "0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3"
TURN = "0.9999239 0.00983776 -0.007445048 -0.009869795 0.9999421 -0.004278459 0.007402527 0.004351614 0.9999631"


def test_kittis_scan_in_each_of_its_layouts(tmp_path: Path) -> None:
    np.column_stack([POINTS, np.ones(3)]).astype("<f4").tofile(tmp_path / "000000.bin")
    offset = np.linalg.solve(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), [42, 7, 0.01])
    turn = np.array(TURN.split(), float).reshape(3, 3)
    lidar = np.array(LIDAR.split(), float).reshape(3, 4)
    reference = POINTS @ lidar[:, :3].T + lidar[:, 3]
    for text, rectified in (
        (f"P2: {P2}\nR0_rect: {TURN}\nTr_velo_to_cam: {LIDAR}\n", reference @ turn.T),
        (f"P2: {P2}\nR_rect {TURN}\nTr_velo_cam {LIDAR}\n", reference @ turn.T),
        (f"P2: {P2}\nTr: {LIDAR}\n", reference),
    ):
        (tmp_path / "calib.txt").write_text(text)
        found = read_points(tmp_path / "000000.bin", read_calibration(tmp_path / "calib.txt"))
        np.testing.assert_allclose(found, rectified + offset, atol=1e-5)


def test_kittis_raw_data_has_the_lidar_in_a_file_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "calib_cam_to_cam.txt").write_text(f"P_rect_02: {P2}\nR_rect_00: {TURN}\nS_rect_02: 1242 375\n")
    (tmp_path / "calib_velo_to_cam.txt").write_text("calib_time: x\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0.1 -0.2 -0.3\n")
    raw = read_calibration(tmp_path / "calib_cam_to_cam.txt").camera_T_lidar
    (tmp_path / "calib.txt").write_text(f"P2: {P2}\nR0_rect: {TURN}\nTr_velo_to_cam: {LIDAR}\n")
    np.testing.assert_allclose(raw, read_calibration(tmp_path / "calib.txt").camera_T_lidar)


def test_points_in_centimetres_are_in_kittis_rectified_frame(tmp_path: Path) -> None:
    np.savez(tmp_path / "scan.npz", points_cm=np.round(100 * POINTS).astype(np.int16), reflectance=np.zeros(3))
    (tmp_path / "calib.txt").write_text(f"P2: {P2}\n")
    calibration = read_calibration(tmp_path / "calib.txt")
    np.testing.assert_allclose(read_points(tmp_path / "scan.npz", calibration), POINTS + calibration.label_offset)
    with pytest.raises(InvalidInputError, match="rectified reference camera"):
        read_points(tmp_path / "scan.npz")


def test_others_are_in_the_cameras_frame_or_where_a_motion_puts_them(tmp_path: Path) -> None:
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.1, 0.2, 0.3]
    np.savez(tmp_path / "scan.npz", points=POINTS)
    np.save(tmp_path / "scan.npy", np.column_stack([POINTS, [1, 2, 3]]).astype(np.float32))
    for name in ("scan.npz", "scan.npy"):
        np.testing.assert_allclose(read_points(tmp_path / name), POINTS)
        np.testing.assert_allclose(
            read_points(tmp_path / name, motion), POINTS @ motion[:3, :3].T + motion[:3, 3], atol=1e-6
        )
    with pytest.raises(InvalidInputError, match="rigid"):
        read_points(tmp_path / "scan.npy", 2.0 * motion)


def test_nuscenes_scans_have_five_numbers_a_point(tmp_path: Path) -> None:
    np.column_stack([POINTS, np.ones((3, 2))]).astype("<f4").tofile(tmp_path / "scan.pcd.bin")
    np.testing.assert_allclose(read_points(tmp_path / "scan.pcd.bin", np.eye(4)), POINTS, atol=1e-6)
    with pytest.raises(InvalidInputError, match="a LiDAR"):
        read_points(tmp_path / "scan.pcd.bin")


def test_meshes_and_clouds_of_other_programs(tmp_path: Path) -> None:
    import trimesh

    trimesh.PointCloud(POINTS).export(tmp_path / "scan.ply")
    np.testing.assert_allclose(read_points(tmp_path / "scan.ply"), POINTS, atol=1e-5)


def test_point_cloud_library(tmp_path: Path) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    with_gap = np.vstack([POINTS, np.full(3, np.nan)]).astype(np.float32)
    pypcd4.PointCloud.from_xyz_points(with_gap).save(tmp_path / "scan.pcd")
    np.testing.assert_allclose(read_points(tmp_path / "scan.pcd"), POINTS, atol=1e-5)


def test_surveys(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    survey = laspy.create()
    survey.header.scales = [0.001] * 3
    survey.xyz = POINTS
    survey.write(tmp_path / "scan.las")
    np.testing.assert_allclose(read_points(tmp_path / "scan.las"), POINTS, atol=1e-3)


_NO_VERTEX = (
    b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("scan.bin", b"12345", "4 numbers of 4 bytes"),
        ("scan.bin", b"", "at least one finite point"),
        ("scan.xyz", b"1 2 3", "ends in .bin"),
        ("scan.npy", b"nothing", "unreadable"),
        ("scan.npz", b"nothing", "unreadable"),
        ("scan.ply", b"nothing", "whole file"),
        ("scan.ply", _NO_VERTEX, "at least one finite point"),
        ("scan.pcd", b"nothing", r"The reason: [^\n]+\Z"),
        ("gone.bin", None, "can be read"),
    ],
)
def test_files_that_are_none_are_refused(tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidInputError, match=message):
        read_points(tmp_path / name, np.eye(4))


def test_kittis_depth_in_16_bits_has_256_a_metre(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "depth.png"), np.array([[0, 256], [2560, 640]], np.uint16))
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.png"), [[np.nan, 1.0], [10.0, 2.5]])
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.png", 1000.0), [[np.nan, 0.256], [2.56, 0.64]])


def test_depth_in_metres(tmp_path: Path) -> None:
    depth = np.array([[np.nan, 1.5, 0.0], [10.25, -1.0, np.inf]], np.float32)
    known = [[np.nan, 1.5, np.nan], [10.25, np.nan, np.nan]]
    np.save(tmp_path / "depth.npy", depth)
    np.savez(tmp_path / "depth.npz", depth=depth)
    cv2.imwrite(str(tmp_path / "depth.tiff"), depth)
    cv2.imwrite(str(tmp_path / "depth.pfm"), depth)
    for ending in ("npy", "npz", "tiff", "pfm"):
        np.testing.assert_array_equal(read_depth(tmp_path / f"depth.{ending}"), known)


def test_depth_of_renderers(tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    depth = np.array([[1.5, 2.0], [0.0, 4.0]], np.float32)
    with exr.File({"type": exr.scanlineimage}, {"Z": depth}) as file:
        file.write(str(tmp_path / "depth.exr"))
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.exr"), [[1.5, 2.0], [np.nan, 4.0]])


def test_what_is_no_depth_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((2, 2), 9, np.uint8))
    cv2.imwrite(str(tmp_path / "colour.png"), np.full((2, 2, 3), 9, np.uint8))
    cv2.imwrite(str(tmp_path / "empty.png"), np.zeros((2, 2), np.uint16))
    np.save(tmp_path / "whole.npy", np.full((2, 2), 1500))
    for name, message in (
        ("grey.png", "16 bits"),
        ("colour.png", "one number for each pixel"),
        ("empty.png", "a depth above 0"),
        ("whole.npy", "are a metre"),
        ("depth.jpg", "ends in .png"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            read_depth(tmp_path / name)
    np.testing.assert_array_equal(read_depth(tmp_path / "whole.npy", 1000.0), np.full((2, 2), 1.5))
    for units in (0.0, -1000.0, np.nan, np.inf, 1e-300, "mm"):
        with pytest.raises(InvalidInputError, match="depth_per_metre"):
            read_depth(tmp_path / "whole.npy", units)
