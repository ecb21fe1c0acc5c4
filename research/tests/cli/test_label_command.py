"""`fgrecon keypoints label` from the outside: made-up drives with a detector that knows them, and a real one."""

import json
import shutil
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import terminal
from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.coco_keypoints import read_coco_keypoints
from fgrecon.io.images import read_image
from fgrecon_research.cli.training import label
from research.tests.annotation.streets import Car, GivenKeypoints, write_drive

NEAR = Car((-2.0, 1.6, 9.0), 0.5)
FAR = Car((3.0, 1.6, 60.0), 1.0)
FRAMES = [{7: NEAR, 3: Car((2.5, 1.6, 14.0), -1.4, "Van"), 4: FAR}, {7: NEAR}]


@pytest.fixture
def known(scene, monkeypatch):
    """The network knows the cars."""

    class Network(GivenKeypoints):
        provenance = {"data": "made up"}  # noqa: RUF012 - what a network has

        def __init__(self, weights):
            super().__init__(FRAMES, scene.prior)

    monkeypatch.setattr(label, "KeypointCascade", Network)


@pytest.fixture
def drive(scene, tmp_path):
    return write_drive(tmp_path / "drive", scene.prior, FRAMES)


def run(*arguments):
    return CliRunner().invoke(app, ["keypoints", "label", *(str(argument) for argument in arguments)])


def test_all_drives_share_one_set_of_bars(known, scene, drive, tmp_path, monkeypatch):
    opened = []

    @contextmanager
    def kept(*_, **__):
        opened.append(set())
        yield lambda step, done, total, note="": opened[-1].add(step)

    monkeypatch.setattr(terminal, "progress_bar", kept)
    other = write_drive(tmp_path / "other", scene.prior, FRAMES)
    done = run(drive, other, "--out", tmp_path / "labels.json")
    assert done.exit_code == 0, done.output
    (steps,) = opened
    assert {step.partition(":")[0] for step in steps} == {"drive", "other"}


def test_labels_summary_and_picture(known, drive, tmp_path):
    out, sheet, report = tmp_path / "labels.json", tmp_path / "labels.png", tmp_path / "report.json"
    done = run(
        *(drive, "--out", out, "--picture", sheet, "--json", report, "--verbose", "--license", "CC BY-NC-SA 3.0")
    )
    assert done.exit_code == 0, done.output
    found = read_coco_keypoints(out)
    assert [(v.image.frame, v.track, v.kind) for v in found.vehicles] == [(0, 3, "Van"), (0, 7, "Car"), (1, 7, "Car")]
    assert found.faces is None
    assert found.info["network, data"] == "made up"
    assert "LICENSE-DATA.md" in found.info["terms"]
    assert found.terms == "CC BY-NC-SA 3.0"
    assert found.vehicles[0].image.path == drive / "image_02" / "000000.png"
    row = next(line for line in done.stdout.splitlines() if line.strip().startswith("drive  "))
    assert row.split()[:1] == ["drive"]
    summary = json.loads(report.read_text())
    (counted,) = summary["drives"]
    assert [counted[name] for name in ("drive", "vehicles", "images", "labels", "left_out")] == ["drive", 2, 2, 3, 1]
    assert counted["visible"] + counted["hidden"] + counted["outside"] == 3 * 14
    assert counted["reasons"] == {"too small": 1}
    assert summary["left_out"] == [{"drive": "drive", "frame": 0, "track": 4, "kind": "Car", "reason": "too small"}]
    assert "drive, image 0: Car 4: too small" in done.stdout
    assert read_image(sheet).std() > 10
    for path in (out, sheet, report):
        assert f"Wrote {path}." in done.stdout


def test_which_vehicles(known, drive, tmp_path):
    out = tmp_path / "labels.json"
    assert run(drive, "--out", out, "--kinds", "Van").exit_code == 0
    assert [v.kind for v in read_coco_keypoints(out).vehicles] == ["Van"]
    assert run(drive, "--out", out, "--least-height", 10).exit_code == 0
    assert len(read_coco_keypoints(out).vehicles) == 4


@pytest.mark.parametrize(
    "known_by", [["--camera-height", 1.6], ["--ground", "0,1,0,1.6"], ["--size-prior", "apollo79"]]
)
def test_vehicles_without_boxes(known, scene, tmp_path, known_by):
    frames = [{track: replace(car, boxed=track == 3) for track, car in cars.items()} for cars in FRAMES]
    drive = write_drive(tmp_path / "drive", scene.prior, frames)
    out, report = tmp_path / "labels.json", tmp_path / "report.json"
    assert run(drive, "--out", out, "--json", report).exit_code == 0
    assert json.loads(report.read_text())["drives"][0]["reasons"] == {"too small": 1, "no 3D box": 2}
    assert run(drive, "--out", out, *known_by).exit_code == 0
    assert [v.track for v in read_coco_keypoints(out).vehicles] == [3, 7, 7]


def test_several_drives_and_meshes(known, drive, tmp_path):
    other = shutil.copytree(drive, tmp_path / "other")
    out = tmp_path / "labels.json"
    done = run(drive, other, "--out", out, "--meshes")
    assert done.exit_code == 0, done.output
    assert "all" in done.stdout
    found = read_coco_keypoints(out)
    assert [v.image.drive for v in found.vehicles] == ["drive"] * 3 + ["other"] * 3
    assert found.faces.max() == len(found.vehicles[0].vertices) - 1


def test_nothing_to_label_is_a_failure_and_writes_nothing(known, drive, tmp_path):
    done = run(drive, "--out", tmp_path / "labels.json", "--least-height", 1000, "--quiet")
    assert done.exit_code == 1
    assert done.stderr == "fgrecon: no vehicle could be labelled.\n"
    assert not (tmp_path / "labels.json").exists()


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (["--out", "labels.txt"], "json"),
        (["--out", "nowhere/labels.json"], "nowhere"),
        (["--kinds", ","], "selection.kinds"),
        (["--truncation", "2"], "selection.truncation"),
    ],
)
def test_bad_options_are_named_before_the_work(known, drive, tmp_path, monkeypatch, more, named):
    monkeypatch.chdir(tmp_path)
    done = run(drive, "--out", "labels.json", *more)
    assert isinstance(done.exception, InvalidInputError)
    assert named in str(done.exception)


@pytest.mark.data
@pytest.mark.slow
def test_a_slice_of_a_real_drive(data, tmp_path):
    source = data / "kitti_video" / "kitti_tracking_0002"
    (tmp_path / "drive" / "image_02").mkdir(parents=True)
    for name in ("label_02.txt", "calib.txt"):
        shutil.copy(source / name, tmp_path / "drive")
    for path in sorted((source / "image_02").iterdir())[:9:4]:
        shutil.copy(path, tmp_path / "drive" / "image_02")
    out = tmp_path / "labels.json"
    done = run(tmp_path / "drive", "--out", out)
    assert done.exit_code == 0, done.output
    found = read_coco_keypoints(out).vehicles
    assert len(found) >= 4
    for vehicle in found:
        assert vehicle.agreement > 0.6
        x1, y1, x2, y2 = vehicle.box
        seen = vehicle.keypoints[vehicle.flags == 2]
        assert len(seen) >= 5
        assert ((seen > [x1 - 8, y1 - 8]) & (seen < [x2 + 8, y2 + 8])).all()


def test_a_trackers_boxes_take_the_place_of_labels(known, scene, drive, tmp_path):
    """As `fgrecon run` writes them, with scores; its 3D boxes are estimates, and not believed."""
    lines = (drive / "label_02.txt").read_text().splitlines()
    tracks, out = tmp_path / "tracks.txt", tmp_path / "labels.json"
    tracks.write_text("".join(f"{line} 0.9\n" for line in lines))
    (drive / "label_02.txt").unlink()
    done = run(drive, "--tracks", tracks, "--camera-height", 1.6, "--size-prior", "kitti", "--out", out)
    assert done.exit_code == 0, done.output
    labels = read_coco_keypoints(out)
    assert {(v.image.frame, v.track) for v in labels.vehicles} >= {(0, 7), (1, 7)}
    assert "without labelled 3D boxes" in labels.info["description"]
    assert [v.boxed for v in labels.vehicles] == [False] * len(labels.vehicles)
    box = NEAR.box(scene.prior)
    seen = labels.vehicles[[v.track for v in labels.vehicles].index(7)]
    off = ((seen.keypoints - NEAR.keypoints(scene.prior)) ** 2).sum(axis=1) ** 0.5
    assert sorted(off)[7] < 0.03 * max(box[2:] - box[:2])
    alone = run(drive, "--tracks", tracks, "--out", out)
    assert isinstance(alone.exception, InvalidInputError)
    assert "--camera-height" in str(alone.exception)
    several = run(drive, drive, "--tracks", tracks, "--camera-height", 1.6, "--out", out)
    assert "one drive" in str(several.exception)


def test_lidar_is_taken_where_a_drive_has_it(known, drive, tmp_path):
    refused = run(drive, "--lidar", "--out", tmp_path / "labels.json")
    assert isinstance(refused.exception, InvalidInputError)
    assert "lidar/FFFFFF.npz" in str(refused.exception)
    (drive / "lidar").mkdir()
    around = np.stack(np.meshgrid(np.arange(-250, -150, 5), np.arange(80, 160, 5), [860]), axis=-1).reshape(-1, 3)
    np.savez(drive / "lidar" / "000000.npz", points_cm=around.astype(np.int16))
    shapes = {}
    for name, more in (("alone", ()), ("lidar", ("--lidar",))):
        done = run(drive, *more, "--meshes", "--out", out := tmp_path / f"{name}.json")
        assert done.exit_code == 0, done.output
        shapes[name] = [one["keypoints"] for one in json.loads(out.read_text())["annotations"]]
    assert len(shapes["lidar"]) == len(shapes["alone"])
    assert shapes["lidar"] != shapes["alone"]
