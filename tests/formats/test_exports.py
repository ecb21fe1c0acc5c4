"""What is exported, read by the data sets' own devkits: corners of the boxes as they are in the results."""

import json
import struct

import numpy as np
import pytest

from fgrecon.core.box3d import box_corners
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import FORWARD_LEFT_UP, transform
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
@pytest.mark.parametrize("kind", ["nuscenes", "nuscenes_tracking", "truckscenes"])
def test_nuscenes_devkits_read_a_submission(submitted, result, devkit, kind):
    def writer(root):
        return made_up.write_nuscenes(root, trucks=kind == "truckscenes")

    _, path, info = submitted("n.json", writer, "CAM_FRONT", kind)
    said = devkit("nuscenes", "nuscenes_submission", path, kind)
    assert said["samples"] == ["s0", "s1"]
    assert np.abs(corners_in(info.world_T_camera, result) - said["corners"][0]).max() < METRES
    if kind != "nuscenes_tracking":
        assert said["scored"] == {"mAP": pytest.approx(1.0), "mAOE": pytest.approx(0.0, abs=1e-6)}
    if kind == "truckscenes":
        assert {"use_camera", "use_future_frames", "use_tta", "method_name", "paper_url"} <= said["meta"].keys()


@pytest.mark.formats
def test_zods_evaluation_scores_boxes(submitted, result, devkit):
    _, path, info = submitted("z.json", made_up.write_zod, "frames/000000/front_blur", "zod")
    said = devkit("zod", "zod_submission", path)
    assert (said["frames"], said["kinds"]) == (["000000"], ["Vehicle_Car"])
    there = np.linalg.inv(info.world_T_vehicle) @ info.world_T_camera
    assert np.abs(corners_in(there, result) - said["corners"][0]).max() < METRES
    assert said["scored"] == {
        "mAP": pytest.approx(1.0),
        **dict.fromkeys(("mATE", "mASE", "mAOE"), pytest.approx(0.0, abs=1e-6)),
    }


def test_waymos_objects_are_boxes_upright_on_the_vehicle(submitted, result, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    _, path, info = submitted("w.bin", made_up.write_waymo, "FRONT", "waymo")
    content = path.read_bytes()
    assert info.sequence.encode() in content
    place = corners_in(np.linalg.inv(info.world_T_vehicle) @ info.world_T_camera, result).mean(axis=0)
    (start,) = (content.index(bytes([9]), i) for i in [content.index(bytes([63]))])  # after the length of seven doubles
    numbers = [struct.unpack_from("<Bd", content, start + 9 * i) for i in range(7)]
    assert [tag >> 3 for tag, _ in numbers] == [1, 2, 3, 4, 5, 6, 7]
    expected = [*place, *result.box_size[[1, 0, 2]]]
    assert np.abs(np.array([value for _, value in numbers[:6]]) - expected).max() < METRES


@pytest.mark.formats
def test_waymos_metrics_score_objects(submitted, result, devkit, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    _, path, info = submitted("w.bin", made_up.write_waymo, "FRONT", "waymo")
    said = devkit("waymo", "waymo_submission", path)
    assert said["about"] == [["7", 1, 1.0, info.sequence, int(info.sample_token)]]
    pose = np.linalg.inv(info.world_T_vehicle) @ info.world_T_camera @ result.camera_T_object
    heading = np.arctan2(pose[1, 0], pose[0, 0])
    upright = made_up.pose(
        [heading, 0.0, 0.0], corners_in(pose @ np.linalg.inv(result.camera_T_object), result).mean(0)
    )
    size = result.box_size
    ours = transform(upright, box_corners(size) @ FORWARD_LEFT_UP - [0.0, 0.0, size[2] / 2.0])
    assert np.abs(ours - said["corners"][0]).max() < METRES
    assert said["scored"] == {"same": pytest.approx([1.0, 1.0]), "flipped": pytest.approx([1.0, 0.0], abs=1e-6)}


@pytest.mark.parametrize("kind", ["kitti360", "pandaset", "ddad"])
def test_what_no_evaluation_takes_is_refused_with_the_reason(tmp_path, result, kind):
    with pytest.raises(InvalidInputError, match="Give another: "):
        export(tmp_path / "a.json", [NamedResult("7", result, image="a.png")], kind)


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
