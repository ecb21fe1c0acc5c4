"""The commands on a data set: a made-up log of Argoverse 2, whose images are the sample's street."""

import json

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.box_lines import read_box_lines
from fgrecon.simulation.sample import LABEL_OFFSET
from fgrecon.simulation.vehicles import KITTI_CAMERA
from tests.command_line import run

pytest.importorskip("torch")

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
STAMPS = 315968867_000_000_000, 315968867_100_000_000


def write(path, columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pa.table(columns), path)


def upright(count):
    return {"qw": [1.0] * count, "qx": [0.0] * count, "qy": [0.0] * count, "qz": [0.0] * count}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of two sweeps; the sample's detections, which are near the truth, are its labels."""
    folder = tmp_path_factory.mktemp("argoverse")
    assert run("sample", "--out", folder / "sample", "-q").exit_code == 0
    log = folder / "log"
    image = cv2.imread(str(folder / "sample" / "street.png"))
    for stamp in STAMPS:
        path = log / "sensors/cameras/ring_front_center" / f"{stamp}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 98])
    height, width = image.shape[:2]
    place = {"tx_m": [0.0] * 2, "ty_m": [0.0] * 2, "tz_m": [0.0] * 2}
    write(log / "city_SE3_egovehicle.feather", {"timestamp_ns": list(STAMPS), **upright(2), **place})
    mount = {"qw": [0.5], "qx": [-0.5], "qy": [0.5], "qz": [-0.5], "tx_m": [0.0], "ty_m": [0.0], "tz_m": [1.65]}
    write(log / "calibration/egovehicle_SE3_sensor.feather", {"sensor_name": ["ring_front_center"], **mount})
    (fx, _, cx), (_, fy, cy), _ = KITTI_CAMERA.matrix.tolist()
    size = {"height_px": [height], "width_px": [width]}
    lens = {"fx_px": [fx], "fy_px": [fy], "cx_px": [cx], "cy_px": [cy]}
    write(log / "calibration/intrinsics.feather", {"sensor_name": ["ring_front_center"], **lens, **size})
    rows = []
    for stamp in STAMPS:
        for number, line in enumerate(read_box_lines(folder / "sample" / "detections.txt")):
            box = line.box(LABEL_OFFSET)
            x, y, z = AHEAD @ (box.location - [0.0, box.size[2] / 2, 0.0])
            half = (-np.pi / 2 - box.rotation_y) / 2
            turn = (float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
            rows.append((stamp, f"car-{number}", "REGULAR_VEHICLE", *box.size, *turn, x, y, z + 1.65))
    names = ("timestamp_ns", "track_uuid", "category", "length_m", "width_m", "height_m")
    names += ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
    write(log / "annotations.feather", dict(zip(names, map(list, zip(*rows, strict=True)), strict=True)))
    return log


@pytest.fixture(scope="module")
def followed(log, tmp_path_factory):
    """The folder of a run on the log."""
    out = tmp_path_factory.mktemp("run")
    done = run("run", f"{log}#ring_front_center", "--out", out, "--camera-height", "1.65", "-q")
    assert done.exit_code == 0, done.output
    return out


def test_a_run_takes_camera_poses_and_times_from_the_data_set(followed):
    frames = [json.loads(line) for line in (followed / "frames.jsonl").read_text().splitlines()]
    assert [frame["time"] for frame in frames] == pytest.approx([stamp * 1e-9 for stamp in STAMPS])
    assert np.allclose(np.array(frames[0]["world_T_camera"])[:3, :3], AHEAD)
    cars = frames[1]["vehicles"]
    assert len(cars) == 3
    assert {round(car["speed"]) for car in cars} == {0}


def test_a_data_set_has_no_frame_rate_of_ours(log, tmp_path):
    refused = run("run", f"{log}#ring_front_center", "--fps", "5", "--out", tmp_path / "out")
    assert isinstance(refused.exception, InvalidInputError)
    assert "has the times of its images" in str(refused.exception)


def test_boxes_of_a_run_are_scored_against_its_labels(log, followed):
    done = run("evaluate", "boxes", f"{log}#ring_front_center", f"run={followed}", "--verbose")
    assert done.exit_code == 0, done.output
    assert "2 images" in done.output
    assert done.output.count("no box") == 0


def test_its_vehicles_are_labelled_with_keypoints(log, tmp_path):
    out = tmp_path / "labels.json"
    done = run("keypoints", "label", f"{log}#ring_front_center", "--out", out, "-q")
    assert done.exit_code == 0, done.output
    labels = json.loads(out.read_text())
    assert len(labels["annotations"]) == 6
    assert {a["cuboid"]["source"] for a in labels["annotations"]} == {"labelled"}


def test_a_batch_has_a_row_for_each_vehicle_with_the_camera(log, tmp_path):
    done = run("batch", log, "--out", tmp_path / "out", "-q")
    assert done.exit_code == 0, done.output
    rows = pq.read_table(tmp_path / "out").to_pylist()
    assert len(rows) == 6
    assert {row["status"] for row in rows} <= {"converged", "weak"}


def test_what_is_there_is_listed_where_nothing_is_named(log, tmp_path):
    refused = run("run", f"{log}#ring_side_left", "--out", tmp_path / "out")
    assert isinstance(refused.exception, InvalidInputError)
    assert "Name a camera: ring_front_center" in str(refused.exception)
