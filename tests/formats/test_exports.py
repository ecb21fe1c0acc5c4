"""What is exported, read by the data sets' own devkits: corners of the boxes as they are in the results."""

import json

import numpy as np
import pytest

from fgrecon.core.box3d import box_corners
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.export import export, read_images_file
from fgrecon.io.export.results import NamedResult
from tests.viz.made_up import make_example

from . import made_up

METRES = 1e-6


@pytest.fixture(scope="module")
def result():
    return make_example().reconstruction


def corners_in(pose, result):
    return transform(pose @ result.camera_T_object, box_corners(result.box_size))


@pytest.fixture
def submitted(tmp_path, result):
    """Writes a kind of file for a data set, of one car in the first image that a camera took."""

    def write(name, writer, camera, kind, folder=""):
        root = writer(tmp_path / "data")
        images = read_images_file(f"{root}{folder}#{camera}")
        file, info = next((file, info) for file, info in images.items() if info.sample_token)
        car = NamedResult("7", result, image=file, kind="Car", score=1, velocity=np.array([1.0, 2.0, 0.0]))
        return root, export(tmp_path / name, [car], kind, images), info

    return write


def test_nuscenes_boxes_and_tracks(submitted, result):
    _, path, info = submitted("n.json", made_up.write_nuscenes, "CAM_FRONT", "nuscenes_tracking")
    found = json.loads(path.read_text())["results"]
    assert {token: len(boxes) for token, boxes in found.items()} == {"s0": 1, "s1": 0}
    (box,) = found["s0"]
    assert (box["tracking_id"], box["tracking_name"], box["velocity"]) == ("7", "car", [1.0, 2.0])
    assert isinstance(box["tracking_score"], float)
    middle = corners_in(info.world_T_camera, result).mean(axis=0)
    assert np.abs(middle - box["translation"]).max() < METRES


@pytest.mark.formats
@pytest.mark.parametrize("kind", ["nuscenes", "nuscenes_tracking"])
def test_nuscenes_devkit_reads_a_submission(submitted, result, devkit, kind):
    _, path, info = submitted("n.json", made_up.write_nuscenes, "CAM_FRONT", kind)
    said = devkit("nuscenes", "nuscenes_submission", path, kind)
    assert said["samples"] == ["s0", "s1"]
    assert np.abs(corners_in(info.world_T_camera, result) - said["corners"][0]).max() < METRES


def test_argoverse_rows(submitted, result):
    from pyarrow import feather

    _, path, info = submitted("d.feather", made_up.write_argoverse2, "ring_front_center", "argoverse2")
    (row,) = feather.read_table(path).to_pylist()
    assert (row["timestamp_ns"], row["category"], row["score"]) == (made_up.TIMES_NS[0], "REGULAR_VEHICLE", 1.0)
    there = np.linalg.inv(info.world_T_vehicle) @ info.world_T_camera
    place = corners_in(there, result).mean(axis=0)
    assert np.abs(place - [row["tx_m"], row["ty_m"], row["tz_m"]]).max() < METRES


@pytest.mark.formats
def test_argoverse_devkit_reads_detections(submitted, result, devkit):
    _, path, info = submitted("d.feather", made_up.write_argoverse2, "ring_front_center", "argoverse2")
    said = devkit("argoverse2", "argoverse2_submission", path)
    there = np.linalg.inv(info.world_T_vehicle) @ info.world_T_camera
    assert np.abs(corners_in(there, result) - said["corners"][0]).max() < METRES


@pytest.mark.formats
def test_cityscapes_devkit_reads_boxes(submitted, result, devkit):
    _, path, info = submitted("aachen.json", made_up.write_cityscapes3d, "aachen", "cityscapes3d")
    said = devkit("cityscapes3d", "cityscapes3d_submission", path)
    assert np.abs(corners_in(info.world_T_camera, result) - said["corners"][0]).max() < METRES
    assert said["score"] == [1.0]


def test_openlabel_names_what_an_image_shows(submitted, result):
    _, path, _ = submitted("o.json", made_up.write_nuscenes, "CAM_FRONT", "openlabel")
    content = json.loads(path.read_text())["openlabel"]
    assert list(content["objects"]) == ["7"]
    assert content["objects"]["7"]["frame_intervals"] == [{"frame_start": 0, "frame_end": 0}]
    data = content["frames"]["0"]["objects"]["7"]["object_data"]
    assert len(data["cuboid"][0]["val"]) == 10
    assert data["cuboid"][0]["coordinate_system"] == "world"
    assert [point["name"] for point in data["point2d"]][:1] == ["left_front_wheel"]


def test_the_path_of_the_camera(submitted, tmp_path, devkit):
    _, path, _ = submitted("p.txt", made_up.write_argoverse2, "ring_front_center", "tum")
    rows = np.loadtxt(path)
    expected = [
        made_up.world_T_vehicle(t + made_up.SHIFT_NS) @ made_up.CAMERAS[0].vehicle_T_camera for t in made_up.TIMES_NS
    ]
    assert np.abs(rows[:, 1:4] - [pose[:3, 3] for pose in expected]).max() < 1e-8
    assert rows[:, 0] == pytest.approx([(t + made_up.SHIFT_NS) * 1e-9 for t in made_up.TIMES_NS])


@pytest.mark.formats
@pytest.mark.parametrize("kind", ["tum", "kitti_poses"])
def test_evo_reads_the_path(submitted, devkit, kind):
    _, path, _ = submitted("p.txt", made_up.write_argoverse2, "ring_front_center", kind)
    said = devkit("evo", "evo_reads", path, kind)
    assert said["valid"], said
    expected = [
        made_up.world_T_vehicle(t + made_up.SHIFT_NS) @ made_up.CAMERAS[0].vehicle_T_camera for t in made_up.TIMES_NS
    ]
    assert np.abs(np.array(said["poses"]) - expected).max() < METRES


def test_what_is_not_known_is_named(tmp_path, result):
    car = NamedResult("7", result, image="a.png")
    for kind, name, field in (
        ("argoverse2", "d.feather", "sample_token"),
        ("nuscenes_tracking", "n.json", "sample_token"),
        ("cityscapes3d", "c.json", "world_T_camera"),
    ):
        with pytest.raises(InvalidInputError, match=f"images.a.png.{field}"):
            export(tmp_path / name, [car], kind, {})
    with pytest.raises(InvalidInputError, match="camera moves"):
        export(tmp_path / "p.txt", [car], "tum", {})
