"""`fgrecon batch` on other programs' files and names: the vehicles that `fgrecon reconstruct` makes of them."""

import json
import os
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgrecon.core.errors import InvalidInputError
from tests.cars import CAMERA
from tests.cli.conftest import INTRINSICS, car
from tests.command_line import run
from tests.io.formats import CATEGORY, in_scheme, pascal_file
from tests.solve.test_box_check import scaled
from tests.solve.test_scene import street

POINTS = np.array(car()["keypoints"])


def batch(file, out, *options):
    """Poses of the rows, by their ids."""
    done = run("batch", file, INTRINSICS, "--out", out, "-q", *options)
    assert done.exit_code == 0, done.output
    rows = pq.read_table(out).to_pylist()
    return {row["id"]: row["camera_T_object"] for row in rows}


def alone(file, *options):
    """What `fgrecon reconstruct` makes of the file, with the digits that it writes."""
    done = run("reconstruct", file, INTRINSICS, "--json", "-", *options)
    assert done.exit_code == 0, done.output
    return {e["id"]: np.ravel(e["result"]["camera_T_object"]) for e in json.loads(done.stdout)["instances"]}


def same(found, expected):
    assert found.keys() == expected.keys()
    for name, pose in expected.items():
        np.testing.assert_allclose(found[name], pose, atol=1e-4, err_msg=name)


def carfusion(path):
    lines = [f"{u},{v},{k},7,1\n" for k, (u, v) in enumerate(in_scheme(POINTS, "carfusion"), start=1) if np.isfinite(u)]
    path.write_text("".join(lines))
    return path


def pascal(path):
    return pascal_file(path, POINTS, np.array(car()["box"], dtype=np.float64))


@pytest.mark.parametrize(("make", "name"), [(carfusion, "1_0001.txt"), (pascal, "2008_000001.mat")])
def test_files_that_are_no_json(tmp_path, make, name):
    file = make(tmp_path / name)
    found = batch(file, tmp_path / "out")
    assert len(found) == 1
    same(found, alone(file))


def test_a_folder_has_such_files_where_there_are_no_others(tmp_path):
    (tmp_path / "gt").mkdir()
    carfusion(tmp_path / "gt" / "1_0001.txt")
    assert len(batch(tmp_path / "gt", tmp_path / "out")) == 1
    (tmp_path / "gt" / "cars.json").write_text(json.dumps([car(), car()]))
    assert len(batch(tmp_path / "gt", tmp_path / "again")) == 2


def test_names_that_the_user_tells(tmp_path):
    """Points by names of nobody, and points by their numbers: pairs, and a file of names in order."""
    pairs = ",".join(f"p{k}={name}" for k, name in enumerate(CATEGORY.keypoints))
    cars = [car(), car(0.4, (3.0, 1.65, 16.0))]
    own = [{"id": f"c{n}", "keypoints": one["keypoints"]} for n, one in enumerate(cars)]
    named = [{"id": one["id"], "keypoints": {f"p{k}": uv for k, uv in enumerate(one["keypoints"])}} for one in own]
    (ours := tmp_path / "ours.json").write_text(json.dumps(own))
    (theirs := tmp_path / "theirs.jsonl").write_text("".join(f"{json.dumps(one)}\n" for one in named))
    expected = batch(ours, tmp_path / "ours")
    assert batch(theirs, tmp_path / "theirs", "--names", pairs) == expected
    backwards = [one | {"keypoints": [*reversed(one["keypoints"]), [5.0, 5.0]]} for one in own]
    (listed := tmp_path / "listed.json").write_text(json.dumps(backwards))
    (order := tmp_path / "order.json").write_text(json.dumps([*reversed(CATEGORY.keypoints), None]))
    assert batch(listed, tmp_path / "listed", "--names", order) == expected
    done = run("batch", theirs, INTRINSICS, "--out", tmp_path / "theirs", "-q")
    assert isinstance(done.exception, InvalidInputError)
    assert "other settings" in str(done.exception)
    refused = run("batch", theirs, INTRINSICS, "--out", tmp_path / "none", "--names", "p0=left_wing")
    assert isinstance(refused.exception, InvalidInputError)
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (1.2, True)])
def test_boxes_that_are_all_too_large_are_reported(tmp_path, factor, warned):
    seen = [scaled(one, factor) for one in street(5, count=6)[1]]
    cars = [{"keypoints": one.keypoints.tolist(), "box": one.box.tolist(), "id": str(i)} for i, one in enumerate(seen)]
    (tmp_path / "cars.json").write_text(json.dumps({"K": CAMERA.matrix.tolist(), "instances": cars}))
    options = ["--camera-height", "1.65", "--size-prior", "kitti"]
    done = run("batch", tmp_path / "cars.json", "--out", tmp_path / "out", *options)
    assert done.exit_code == 0, done.output
    assert ("larger than their vehicles look" in " ".join(done.output.split())) == warned
    excesses = pq.read_table(tmp_path / "out").column("box_excess").to_pylist()
    assert (np.median(excesses) > 0.05) == warned


def test_one_is_reported_as_one(tmp_path):
    (file := tmp_path / "one.json").write_text(json.dumps([car() | {"frame": 0}]))
    said = " ".join(run("batch", file, INTRINSICS, "--out", tmp_path / "out").stdout.split())
    assert "1 of 1 row is done, 0 of them before." in said
    said = " ".join(run("run", file, INTRINSICS, "--out", tmp_path / "run", "--fps", 10).stdout.split())
    assert "1 frame, 1 car, 1 estimate, " in said


@pytest.mark.parametrize(("cars", "images", "counted"), [(1, 1, "1 car of 1 frame"), (5, 2, "5 cars of 2 frames")])
def test_the_cars_that_tell_the_camera_are_counted(monkeypatch, cars, images, counted):
    from fgrecon.video import video_job
    from fgrecon.video.focal import EstimatedCamera

    found = EstimatedCamera(CAMERA, cars, images)
    monkeypatch.setattr(video_job, "estimate_camera", lambda *_, **__: found)
    said = []
    settings = SimpleNamespace(arguments=dict)
    assert video_job._estimated_camera(None, None, settings, CAMERA, said.append) is CAMERA
    assert counted in said[0]


def test_a_pipe_is_refused_before_the_folder_is_begun(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    done = run("batch", tmp_path / "pipe", "--out", tmp_path / "out")
    assert isinstance(done.exception, InvalidInputError)
    assert not (tmp_path / "out").exists()
