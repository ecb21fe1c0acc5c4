"""Files of other sensors as evidence of an image: placed by whatever says where the sensor is."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.choices import DepthScale
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.images import write_png
from fgrecon.perception.sensor_source import SensorSource

POINTS = np.array([[20.0, 3.0, -1.0], [15.0, -2.0, 0.5]])  # of a LiDAR: ahead, left, up
LIDAR = "0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3"
P2 = "700 0 600 0 0 700 180 0 0 0 1 0"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.column_stack([POINTS, np.ones(2)]).astype("<f4").tofile(tmp_path / "000004.bin")
    (tmp_path / "calib.txt").write_text(f"P2: {P2}\nTr_velo_cam {LIDAR}\n")
    return tmp_path


def test_a_scan_is_placed_and_knows_where_its_sensor_is(folder: Path) -> None:
    given = CameraSource(calib=folder / "calib.txt")
    source = SensorSource(lidar=str(folder), camera=given)
    source.check(["000003.png", "000004.png"])
    (points,) = source.evidence(Path("000004.png"))
    np.testing.assert_allclose(points.points, [[-2.9, 0.8, 19.7], [2.1, -0.7, 14.7]], atol=1e-5)
    np.testing.assert_allclose(points.origin, [0.1, -0.2, -0.3])
    assert source.evidence(Path("000005.png")) == ()
    (folder / "pose.txt").write_text(LIDAR)
    again = SensorSource(lidar=str(folder / "000004.bin"), lidar_pose=folder / "pose.txt")
    np.testing.assert_allclose(again.evidence(Path("any.png"))[0].points, points.points)


def test_an_empty_scan_among_others_says_nothing(folder: Path) -> None:
    """By itself it is refused."""
    (folder / "000005.bin").write_bytes(b"")
    given = CameraSource(calib=folder / "calib.txt")
    with pytest.warns(UserWarning, match=r"000005\.bin has no finite point"):
        (points,) = SensorSource(lidar=str(folder), camera=given).evidence(Path("000005.png"))
    assert not len(points.points)
    with pytest.raises(InvalidInputError, match="finite point"):
        SensorSource(lidar=str(folder / "000005.bin"), camera=given).evidence(Path("000005.png"))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lidar_pose": Path("pose.txt")}, "--lidar"),
        ({"lidar": "nowhere"}, "that exists"),
        ({"depth": "nowhere"}, "that exists"),
        ({"depth_scale": DepthScale.SCALE}, "--depth"),
        ({"depth_per_metre": 1000.0}, r"\(--depth\)"),
        ({"depth_per_metre": 0.0}, "1000 of millimetres"),
        ({"depth": ".", "depth_per_metre": 1000.0, "depth_inverse": True}, "Leave it out"),
        ({"depth": ".", "depth_per_metre": 1000.0, "depth_scale": DepthScale.SCALE}, "Leave it out"),
        ({"right_pose": Path("pose.txt")}, "--right"),
        ({"right_camera": "right.yaml"}, "--right"),
    ],
)
def test_what_does_not_fit_is_refused(folder: Path, monkeypatch, given: dict, message: str) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(InvalidInputError, match=message):
        SensorSource(**given)


def test_files_of_other_images_are_refused(folder: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"such as 000007\.png"):
        SensorSource(lidar=str(folder)).check(["000007.png"])


def test_points_of_another_frame_are_refused_with_the_cause(folder: Path) -> None:
    import fgrecon

    camera = Camera(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), image_size=(1200, 360))
    np.save(folder / "000009.npy", POINTS)
    evidence = SensorSource(lidar=str(folder / "000009.npy")).evidence(Path("000009.png"))
    with pytest.raises(InvalidInputError, match="LiDAR's frame"):
        fgrecon.reconstruct(np.full((14, 2), np.nan), camera, box=[500, 150, 700, 250], evidence=evidence)


def _write_pair(left: Path, right: Path) -> None:
    """An image of noise in either folder, 15 pixels apart."""
    texture = np.random.default_rng(0).integers(0, 255, (120, 320, 3), dtype=np.uint8)
    for folder, image in ((left, texture), (right, np.roll(texture, -15, axis=1))):
        folder.mkdir()
        write_png(folder / "000000.png", image)


def test_a_right_image_makes_a_depth_map(tmp_path: Path) -> None:
    _write_pair(tmp_path / "image_02", tmp_path / "image_03")
    (tmp_path / "calib.txt").write_text("P2: 300 0 160 0 0 300 60 0 0 0 1 0\nP3: 300 0 160 -150 0 300 60 0 0 0 1 0\n")
    for source in (
        SensorSource(right=str(tmp_path / "image_03")),
        SensorSource(right=str(tmp_path / "image_03"), camera=CameraSource(calib=tmp_path / "calib.txt")),
    ):
        (depth,) = source.evidence(tmp_path / "image_02" / "000000.png")
        assert np.nanmedian(depth.depth) == pytest.approx(10.0, abs=0.1)  # 300 px * 0.5 m / 15 px
        with pytest.raises(InvalidInputError, match="right"):
            source.evidence(Path("000000.png"))


def test_a_right_camera_may_have_files_of_its_own(tmp_path: Path) -> None:
    _write_pair(tmp_path / "left", tmp_path / "right")
    (tmp_path / "pose.txt").write_text("1 0 0 -0.5 0 1 0 0 0 0 1 0")
    cameras = "".join(
        f"cam{i}:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n"
        f"  intrinsics: [300, 300, {middle}, 60]\n  resolution: [320, 120]\n"
        for i, middle in enumerate((160, 165))
    )
    (tmp_path / "rig.yaml").write_text(cameras)
    image = tmp_path / "left" / "000000.png"
    right = {"right": str(tmp_path / "right"), "right_pose": tmp_path / "pose.txt"}
    alike = SensorSource(camera=CameraSource(intrinsics=(300, 300, 160, 60)), **right)
    assert np.nanmedian(alike.evidence(image)[0].depth) == pytest.approx(10.0, abs=0.1)  # 300 px * 0.5 m / 15 px
    rig = CameraSource(file=f"{tmp_path / 'rig.yaml'}#cam0")
    apart = SensorSource(camera=rig, right_camera=f"{tmp_path / 'rig.yaml'}#cam1", **right)
    assert np.nanmedian(apart.evidence(image)[0].depth) == pytest.approx(7.5, abs=0.1)  # 20 px
    assert apart.to_dict()["right_pose"] == str(tmp_path / "pose.txt")
    with pytest.raises(InvalidInputError, match=r"right_pose.*--camera"):
        SensorSource(**right).evidence(image)
    (tmp_path / "pose.txt").write_text("1 0 0")
    with pytest.raises(InvalidInputError, match="3 numbers"):
        alike.evidence(image)


def test_masks_are_of_ids_or_of_coco(tmp_path: Path) -> None:
    ids = np.zeros((40, 60), dtype=np.uint16)
    ids[8:21, 10:31], ids[5:15, 40:50], ids[30:, :] = 26001, 26002, 10000
    folder = tmp_path / "masks"
    folder.mkdir()
    cv2.imwrite(str(folder / "000004.png"), ids)
    one, other = SensorSource(masks=str(folder)).evidence(Path("000004.jpg"))
    assert one.box.tolist() == [10, 8, 30, 20]
    assert other.box.tolist() == [40, 5, 49, 14]
    assert SensorSource(masks=str(folder)).evidence(Path("000005.jpg")) == ()
    columns = (ids == 26001).T.ravel()
    ends = np.flatnonzero(np.diff(columns.astype(int))) + 1
    rle = {"size": [40, 60], "counts": np.diff([0, *ends, columns.size]).tolist()}
    polygon = [[40, 5, 49, 5, 49, 14, 40, 14]]
    coco = {
        "images": [{"id": 7, "file_name": "000004.jpg", "width": 60, "height": 40}, {"id": 8, "file_name": "b.jpg"}],
        "categories": [{"id": 3, "name": "car"}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 8, 21, 13], "segmentation": rle},
            {"id": 2, "image_id": 7, "category_id": 3, "bbox": [40, 5, 10, 10], "segmentation": polygon},
            {"id": 3, "image_id": 8, "category_id": 3, "bbox": [0, 0, 10, 10], "segmentation": polygon},
            {"id": 4, "image_id": 7, "category_id": 3, "bbox": [0, 0, 10, 10]},
        ],
    }
    file = tmp_path / "coco.json"
    file.write_text(json.dumps(coco))
    again = SensorSource(masks=str(file)).evidence(Path("000004.jpg"))
    assert [mask.box.tolist() for mask in again] == [one.box.tolist(), other.box.tolist()]
    assert SensorSource(masks=str(file)).to_dict() == {"masks": str(file)}
    del coco["annotations"][:2]
    file.write_text(json.dumps(coco))
    with pytest.raises(InvalidInputError, match=r"segmentation: got missing"):
        SensorSource(masks=str(file)).evidence(Path("000004.jpg"))
    coco["annotations"] = [{"image_id": 7, "category_id": 3, "segmentation": {"size": [40, 60], "counts": [3]}}]
    file.write_text(json.dumps(coco))
    with pytest.raises(InvalidInputError, match=r"coco\.json: \[0\]\.segmentation"):
        SensorSource(masks=str(file)).evidence(Path("000004.jpg"))
    cv2.imwrite(str(folder / "000004.png"), np.zeros((40, 60, 3), np.uint8))
    with pytest.raises(InvalidInputError, match=r"masks.*3 channels"):
        SensorSource(masks=str(folder)).evidence(Path("000004.jpg"))
