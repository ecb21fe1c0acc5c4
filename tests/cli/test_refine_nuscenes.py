"""`fgrecon refine` on nuScenes' boxes: a made-up data set of one sample, seen by two cameras."""

import json
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.box_lines import read_box_lines
from fgrecon.io.datasets.detections import read_submission
from fgrecon.io.nuscenes import open_nuscenes
from fgrecon.simulation.sample import LABEL_OFFSET
from fgrecon.simulation.vehicles import KITTI_CAMERA
from tests.command_line import run

pytest.importorskip("torch")

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From a camera's axes right, down, forward to a vehicle's forward, left, up."""
EGO = Rotation.from_euler("z", 0.7), np.array([411.3, 1180.8, 0.0])
MOUNT = np.array([1.7, 0.02, 1.65])


def wxyz(rotation):
    x, y, z, w = rotation.as_quat().tolist()
    return [w, x, y, z]


def write_tables(folder):
    """Two cameras, one ahead and one backwards, of a key frame and of a sweep."""
    width, height = KITTI_CAMERA.image_size
    views = {
        "FRONT": Rotation.from_matrix(AHEAD),
        "BACK": Rotation.from_euler("z", np.pi) * Rotation.from_matrix(AHEAD),
    }
    frames = [("d1", "FRONT", "street", True), ("d2", "BACK", "behind", True), ("d3", "FRONT", "sweep", False)]
    tables = {
        "sensor": [{"token": f"s{c}", "channel": f"CAM_{c}", "modality": "camera"} for c in views],
        "calibrated_sensor": [
            {
                "token": f"c{name}",
                "sensor_token": f"s{name}",
                "translation": MOUNT.tolist(),
                "rotation": wxyz(turn),
                "camera_intrinsic": KITTI_CAMERA.matrix.tolist(),
            }
            for name, turn in views.items()
        ],
        "ego_pose": [{"token": "e1", "timestamp": 1, "rotation": wxyz(EGO[0]), "translation": EGO[1].tolist()}],
        "sample_data": [
            {
                "token": token,
                "sample_token": "sample-1",
                "ego_pose_token": "e1",
                "calibrated_sensor_token": f"c{camera}",
                "filename": f"samples/CAM_{camera}/{name}.png",
                "width": width,
                "height": height,
                "is_key_frame": key,
            }
            for token, camera, name, key in frames
        ],
    }
    folder.mkdir()
    for name, content in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    return folder


def world_T_camera():
    pose = np.eye(4)
    pose[:3, :3] = EGO[0].as_matrix() @ AHEAD
    pose[:3, 3] = EGO[0].as_matrix() @ MOUNT + EGO[1]
    return pose


def entry_of(line):
    """A KITTI line as nuScenes has the box, in the world."""
    pose, box = world_T_camera(), line.box(LABEL_OFFSET)
    length, width, height = box.size
    centre = pose[:3, :3] @ (box.location - [0.0, height / 2, 0.0]) + pose[:3, 3]
    facing = pose[:3, :3] @ [np.cos(box.rotation_y), 0.0, -np.sin(box.rotation_y)]
    return {
        "sample_token": "sample-1",
        "translation": centre.tolist(),
        "size": [width, length, height],
        "rotation": wxyz(Rotation.from_euler("z", np.arctan2(facing[1], facing[0]))),
        "velocity": [1.5, -0.5],
        "detection_name": "car",
        "detection_score": line.score,
        "attribute_name": "vehicle.moving",
    }


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """The sample's street, its boxes as KITTI's lines and as a submission, and the tables."""
    folder = tmp_path_factory.mktemp("nuscenes")
    assert run("sample", "--out", folder / "sample", "-q").exit_code == 0
    images = folder / "images"
    images.mkdir()
    shutil.copy(folder / "sample" / "street.png", images)
    shutil.copy(folder / "sample" / "street.png", images / "behind.png")
    lines = []
    for line in (folder / "sample" / "detections.txt").read_text().splitlines():
        words = line.split()
        lines.append(" ".join([*words[:4], "-1", "-1", "-1", "-1", *words[8:]]))  # nuScenes has no 2D boxes
    (folder / "boxes.txt").write_text("\n".join(lines) + "\n")
    entries = [entry_of(line) for line in read_box_lines(folder / "boxes.txt")]
    pedestrian = entries[0] | {"detection_name": "pedestrian"}
    far = entries[0] | {"translation": [0.0, 0.0, 0.0]}
    content = {"meta": {"use_camera": True}, "results": {"sample-0": [far], "sample-1": [pedestrian, *entries]}}
    (folder / "boxes.json").write_text(json.dumps(content))
    write_tables(folder / "v1.0-made-up")
    return folder


def test_a_submission_gives_the_boxes_that_kittis_lines_give(sample, tmp_path):
    out, report = tmp_path / "refined.json", tmp_path / "report.json"
    boxes, tables = sample / "boxes.json", sample / "v1.0-made-up"
    done = run("refine", boxes, sample / "images", "--camera", tables, "--out", out, "--json", report)
    assert done.exit_code == 0, done.output
    kitti = run(
        *("refine", sample / "boxes.txt", sample / "sample" / "street.png", "--out", tmp_path / "refined.txt"),
        *("--calib", sample / "sample" / "calib.txt"),
    )
    assert kitti.exit_code == 0, kitti.output
    before, after = (json.loads(path.read_text()) for path in (boxes, out))
    assert after["meta"] == before["meta"]
    assert after["results"]["sample-0"] == before["results"]["sample-0"]
    assert after["results"]["sample-1"][0] == before["results"]["sample-1"][0]
    expected = [entry_of(line) for line in read_box_lines(tmp_path / "refined.txt")]
    for old, new, same in zip(
        before["results"]["sample-1"][1:], after["results"]["sample-1"][1:], expected, strict=True
    ):
        assert new != old
        for field in ("translation", "size"):
            assert new[field] == pytest.approx(same[field], abs=2e-3), field
        turn = np.abs(np.dot(new["rotation"], same["rotation"]))
        assert turn == pytest.approx(1.0, abs=1e-5)
        kept = ("velocity", "detection_score", "attribute_name", "sample_token", "detection_name")
        assert {name: new[name] for name in kept} == {name: old[name] for name in kept}
    front, back = json.loads(report.read_text())["images"]
    assert (front["image"], back["image"], back["boxes"]) == ("street", "behind", [])
    assert [box["index"] for box in front["boxes"]] == [1, 2, 3]
    assert {box["sample_token"] for box in front["boxes"]} == {"sample-1"}


def test_a_box_goes_to_the_camera_and_back_to_the_last_bits(sample):
    (front, _) = read_submission(
        sample / "boxes.json", sample / "images", open_nuscenes(sample / "v1.0-made-up")
    ).images
    line = read_box_lines(sample / "boxes.txt")[0]
    one, expected = front.objects[1], line.box(LABEL_OFFSET)
    seen = one.box(np.zeros(3))
    assert seen.location == pytest.approx(expected.location, abs=1e-9)
    assert (seen.rotation_y, *seen.size) == pytest.approx((expected.rotation_y, *expected.size), abs=1e-9)
    again = one.with_box(seen, np.zeros(3))
    for field in ("translation", "size", "rotation"):
        assert again[field] == pytest.approx(one.entry[field], abs=1e-9)
    turned = one.with_box(Box3D(seen.location, seen.rotation_y + 0.3, seen.size), np.zeros(3))
    yaws = [Rotation.from_quat(np.roll(e["rotation"], -1)).as_euler("zyx")[0] for e in (one.entry, turned)]
    assert yaws[1] - yaws[0] == pytest.approx(-0.3)  # about the axis up, not down


def test_what_is_refused(sample, tmp_path):
    out, tables = tmp_path / "out.json", sample / "v1.0-made-up"

    def refused(boxes, images, *options):
        done = run("refine", boxes, images, "--out", out, *options)
        assert isinstance(done.exception, InvalidInputError), done.output
        assert not out.exists()
        return str(done.exception)

    assert "nuScenes' tables" in refused(sample / "boxes.json", sample / "images")
    nothing = tmp_path / "none"
    nothing.mkdir()
    shutil.copy(sample / "images" / "street.png", nothing / "other.png")
    assert "sample_data.json" in refused(sample / "boxes.json", nothing, "--camera", tables)
    content = json.loads((sample / "boxes.json").read_text())
    (bad := tmp_path / "bad.json").write_text(json.dumps({"results": []}))
    assert "submission" in refused(bad, sample / "images", "--camera", tables)
    content["results"]["sample-1"][2]["size"] = [1.0, "wide", 2.0]
    bad.write_text(json.dumps(content))
    assert "results.sample-1[2].size[1]" in refused(bad, sample / "images", "--camera", tables)
