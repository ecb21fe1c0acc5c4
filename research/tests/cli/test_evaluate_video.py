"""`fgrecon evaluate video` from the outside: output, files, folds, refusals."""

import csv
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fgrecon.calibration.labelled_drives import read_folds
from fgrecon.calibration.labelled_frames import ScoredFrame
from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon_research.cli.evaluate.video import _write_results

pytest.importorskip("torch")

CALIB = "P2: 700 0 80 40 0 700 50 0.2 0 0 1 0.002\n"
LABEL = "0 0 1.5 20.0 20.0 110.0 80.0 1.5 1.6 4.0 0.1 1.6 15 1.5"


def run(*arguments):
    return CliRunner().invoke(main.app, ["evaluate", "video", *map(str, arguments)])


@pytest.fixture
def drives(tmp_path):
    """Two drives of one image of noise each."""
    image = np.random.default_rng(0).integers(0, 255, (100, 160, 3)).astype(np.uint8)
    folders = [tmp_path / name for name in ("one", "two")]
    for folder in folders:
        (folder / "image_02").mkdir(parents=True)
        write_png(folder / "image_02" / "000007.png", image)
        (folder / "label_02.txt").write_text(f"7 1 Van {LABEL}\n7 2 Car {LABEL}\n")
        (folder / "calib.txt").write_text(CALIB)
    return folders


def test_tables_files_and_which_network_scored_what(drives, weights, tmp_path):
    copy = shutil.copy(weights, tmp_path / "copy.safetensors")
    out, table, sheet = tmp_path / "r.json", tmp_path / "r.csv", tmp_path / "r.png"
    done = run(
        *(*drives, "--weights", weights, "--fold", f"two={copy}", "--rival", "epnp", "--verbose"),
        *("--json", out, "--table", table, "--picture", sheet, "--box-model", "off", "--camera-height", 1.5),
        *("--results", tmp_path / "boxes", "--track", "--markdown", tmp_path / "r.md"),
    )
    assert done.exit_code == 0, done.output
    assert "2 drives, 2 images, 4 boxes; level camera 1.5 m" in done.stdout
    assert "cars_moderate" in done.stdout
    (file,) = (tmp_path / "boxes" / "one").iterdir()
    assert (file.name, len(file.read_text().splitlines())) == ("000007.txt", 2)
    assert "expected calibration error" in done.stdout
    assert "one/000007/1 epnp: " in done.stdout
    lines = (tmp_path / "r.md").read_text().splitlines()
    by = [line for line in lines if line.startswith("By ")]
    assert by == [f"By {name}:" for name in ("regime", "drive", "view", "height", "occlusion", "distance")]
    assert lines[2].startswith("| boxes | method | AOP 5° % | AOP 15° % | AOP 30° % | flipped % |")
    rows = [line for line in lines if line.startswith("| ")]
    assert {line.count("|") for line in rows} == {lines[2].count("|")}
    names = [line.split(" | ")[1] for line in lines[4:14]]
    assert names[:6] == ["reconstruct_image", "epnp", "alone", "vote", "vote_batch", "sign_belief"]
    assert names[6:] == ["online", "batch", "online_moving", "batch_moving"]
    groups = ("cars_easy, 2", "cars_moderate, 2", "cars, 2", "vans, 2", "all, 4")
    assert [line.split(" | ")[0] for line in lines[4:54]] == [f"| {group}" for group in groups for _ in names]
    assert [line.split(" | ")[0] for line in lines[59:79]] == ["| one, 2"] * 10 + ["| two, 2"] * 10
    assert "By regime:" in done.stdout
    made = json.loads(out.read_text())
    assert made["networks"] == [
        {"file": str(weights), "drives": ["one"], "provenance": {"data": "none"}},
        {"file": str(copy), "drives": ["two"], "provenance": {"data": "none"}},
    ]
    assert made["given"]["box_model"] == "off"
    assert list(made["methods"]) == names
    counts = {name: group["boxes"] for name, group in made["methods"]["epnp"]["regime"].items()}
    assert counts == {"cars_easy": 2, "cars_moderate": 2, "cars": 2, "vans": 2, "all": 4}
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == len(made["boxes"]) == 40
    assert [float(row["degrees"]) for row in rows] == [row["degrees"] for row in made["boxes"]]
    assert sheet.stat().st_size > 1000


def test_results_of_several_drives_are_scored_together(drives, weights, tmp_path):
    boxes, table = tmp_path / "boxes", tmp_path / "r.json"
    done = run(*drives, "--weights", weights, "--results", boxes)
    assert done.exit_code == 0, done.output
    for folder in drives:  # both labels have one box: leave each vehicle that counts a box of its own
        (folder / "label_02.txt").write_text(f"7 2 Car {LABEL}\n")
    done = CliRunner().invoke(main.app, ["evaluate", "boxes", *map(str, (*drives, boxes)), "--json", str(table)])
    assert done.exit_code == 0, done.output
    assert "2 drives, 2 images." in done.stdout
    vehicles = json.loads(table.read_text())["sources"][0]["vehicles"]
    assert [(one["drive"], one["frame"], one["found"]) for one in vehicles] == [
        ("one", "000007", True),
        ("two", "000007", True),
    ]


def test_images_in_which_nothing_labelled_was_found_have_a_file_of_results(tmp_path):
    frames = [ScoredFrame("one", 3, [], (), 2), ScoredFrame("one", 4, [], (), 0)]
    assert _write_results(tmp_path, frames) == [tmp_path / "one"]
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["000003.txt"]


def test_nothing_given(drives, weights, tmp_path):
    """The same keypoints, on no ground and of no fleet; a camera's motion has no length then."""
    out = tmp_path / "r.json"
    nothing_given = (
        *drives,
        "--weights",
        weights,
        "--ground",
        "none",
        "--size-prior",
        "none",
        "--track",
        "--json",
        out,
    )
    done = run(*nothing_given)
    assert done.exit_code == 0, done.output
    assert "4 boxes; no ground plane." in done.stdout
    made = json.loads(out.read_text())
    assert (made["given"]["ground"], made["given"]["size_prior"]) == ("no ground plane", "none")
    assert "online" in made["methods"]
    assert "online_moving" not in made["methods"]
    for more, said in (
        (("--estimate-motion",), "estimate_motion: got no ground"),
        (("--camera-height", 1.5), "either"),
    ):
        refused = run(*nothing_given, *more)
        assert isinstance(refused.exception, InvalidInputError)
        assert said in str(refused.exception)


def test_a_drive_whose_name_is_no_text(drives, weights, tmp_path):
    folder = tmp_path / os.fsdecode(b"n\xff")
    try:
        drives[0].rename(folder)
    except OSError:
        pytest.skip("the file system takes names in UTF-8 alone")
    tables = [tmp_path / "r.csv", tmp_path / "r.parquet"]
    for table in tables:
        done = run(folder, "--weights", weights, "--table", table, "--picture", tmp_path / "r.png", "-q")
        assert done.exit_code == 0, done.output
    assert {row["drive"] for row in csv.DictReader(tables[0].read_text("utf-8").splitlines())} == {"n\ufffd"}
    assert set(pq.read_table(tables[1], columns=["drive"]).column(0).to_pylist()) == {"n\ufffd"}


def test_folds():
    drives = ["a", "b", "c"]
    assert read_folds([], drives, None) == {"a": None, "b": None, "c": None}
    found = read_folds(["a,c=1.safetensors"], drives, Path("rest.safetensors"))
    assert found == {"a": Path("1.safetensors"), "b": Path("rest.safetensors"), "c": Path("1.safetensors")}
    assert read_folds(["b=x=y"], drives, None)["b"] == Path("x=y")


@pytest.mark.parametrize(
    ("folds", "value"), [(["a"], "a"), (["=f"], "=f"), (["a="], "a="), (["d=f"], "d"), (["a,b=f", "b=g"], "b")]
)
def test_folds_that_are_none(folds, value):
    with pytest.raises(InvalidInputError) as raised:
        read_folds(folds, ["a", "b"], None)
    assert (raised.value.field, raised.value.value) == ("fold", value)


def test_two_drives_of_one_name_are_refused(drives, weights):
    done = run(drives[0], drives[0], "--weights", weights)
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "drives"


def test_drives_without_a_box_that_counts_and_tables_of_another_kind_are_refused(drives, weights, tmp_path):
    (drives[0] / "label_02.txt").write_text(f"7 1 Pedestrian {LABEL}\n")
    done = run(drives[0], "--weights", weights)
    assert isinstance(done.exception, InvalidInputError)
    assert (done.exception.field, done.exception.value) == ("drives", "one")
    done = run(drives[1], "--weights", weights, "--table", tmp_path / "t.xlsx")
    assert isinstance(done.exception, InvalidInputError)
    assert "csv, parquet" in done.exception.fix


def test_ids_are_forgotten_only_where_vehicles_are_followed(drives, weights, tmp_path):
    done = run(drives[0], "--weights", weights, "--forget-ids")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "forget_ids"
    out = tmp_path / "r.json"
    done = run(drives[0], "--weights", weights, "--estimate-motion")
    assert done.exception.field == "estimate_motion"
    done = run(drives[0], "--weights", weights, "--forget-ids", "--track", "--no-estimate-motion", "--json", out)
    assert done.exit_code == 0, done.output
    made = json.loads(out.read_text())
    given = made["given"]
    assert (given["ids"], given["boxes"], given["missed"]) == ("associated", "labelled", 0)
    assert not given["estimate_motion"]
    assert list(made["methods"])[-2:] == ["online", "batch"]


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_single_images_are_as_good_as_a_drive_where_nothing_is_followed(drives, weights, tmp_path):
    single = tmp_path / "training"
    for name in ("image_2", "label_2", "calib"):
        (single / name).mkdir(parents=True)
    for number in (4, 9):
        shutil.copy(drives[0] / "image_02" / "000007.png", single / "image_2" / f"{number:06d}.png")
        (single / "label_2" / f"{number:06d}.txt").write_text(f"Car {LABEL}\n")
        focal = CALIB if number == 4 else CALIB.replace("700", "1400")
        (single / "calib" / f"{number:06d}.txt").write_text(focal)
    out = tmp_path / "r.json"
    done = run(single, drives[0], "--weights", weights, "--json", out, "--results", tmp_path / "boxes")
    assert done.exit_code == 0, done.output
    assert "2 drives, 3 images, 4 boxes" in done.stdout
    rows = [row for row in json.loads(out.read_text())["boxes"] if row["method"] == "reconstruct_image"]
    assert [(row["drive"], row["frame"], row["track"]) for row in rows[:2]] == [("training", 4, 0), ("training", 9, 1)]
    deep = [float((tmp_path / "boxes" / "training" / f"{n:06d}.txt").read_text().split()[13]) for n in (4, 9)]
    assert deep[1] > 1.5 * deep[0]  # each image has its own camera
    judged = CliRunner().invoke(main.app, ["evaluate", "calibration", str(single), "--weights", str(weights)])
    assert judged.exit_code == 0, judged.output
    assert "1 drive, 2 images, 2 boxes" in judged.stdout
    followed = run(single, "--weights", weights, "--track")
    assert isinstance(followed.exception, InvalidInputError)
    assert "label_02.txt" in str(followed.exception)


def test_a_detector_that_finds_nothing_of_what_is_labelled_is_reported(drives, weights):
    done = run(drives[0], "--weights", weights, "--detect")
    assert isinstance(done.exception, InvalidInputError)
    assert (done.exception.field, done.exception.value) == ("drives", "one")


@pytest.mark.data
@pytest.mark.parametrize(("how", "metres"), [((), 0.5), (("--detect",), 1.0)])
def test_the_shipped_network_on_real_images(data, tmp_path, how, metres):
    source, drive = data / "kitti_video" / "kitti_tracking_0003", tmp_path / "kitti_tracking_0003"
    if not source.is_dir():
        pytest.skip("the drives are absent")
    (drive / "image_02").mkdir(parents=True)
    for name in ("calib.txt", "label_02.txt", "clean_tracks.json"):
        shutil.copy(source / name, drive)
    for number in (44, 46):
        shutil.copy(source / "image_02" / f"{number:06d}.jpg", drive / "image_02")
    done = run(drive, "--json", "-", *how)
    assert done.exit_code == 0, done.output
    made = json.loads(done.stdout)
    assert made["networks"][0]["file"] == "shipped"
    whole = made["methods"]["reconstruct_image"]["regime"]["all"]
    assert (whole["boxes"], whole["tracks"], whole["refused"]) == (4, 2, 0)
    assert whole["aop"]["5"]["value"] == 100.0
    assert whole["median_metres"] < metres
    assert all(row["facing"] > 0.9 and row["view"] == "rear" for row in made["boxes"])
    ended = CliRunner().invoke(main.app, ["evaluate", "calibration", str(drive), "--json", "-", *how])
    assert ended.exit_code == 0, ended.output
    (judged,) = json.loads(ended.stdout)
    assert judged["boxes"] == ("detected" if how else "labelled")
    assert judged["statuses"] == [{"status": "converged", "count": 4, "flipped": 0, "wrong": 0}]


def test_what_results_say_of_themselves(drives, weights, tmp_path):
    out, picture = tmp_path / "c.json", tmp_path / "c.png"
    arguments = [
        "evaluate",
        "calibration",
        *drives,
        "--weights",
        weights,
        "--track",
        "--json",
        out,
        "--picture",
        picture,
    ]
    done = CliRunner().invoke(main.app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    assert "2 drives, 2 images, 4 boxes" in done.stdout
    documents = json.loads(out.read_text())
    assert [document["method"] for document in documents] == ["reconstruct_image", "online", "batch"]
    assert sum(row["count"] for row in documents[0]["statuses"]) == 4
    assert documents[0]["drives"] == ["one", "two"]
    assert picture.stat().st_size > 5000
    refused = CliRunner().invoke(main.app, ["evaluate", "calibration", str(drives[0]), "--fold", "three=x"])
    assert isinstance(refused.exception, InvalidInputError)
    assert refused.exception.field == "fold"
    nowhere = CliRunner().invoke(main.app, ["evaluate", "calibration", "--simulated", "3", "--detect"])
    assert isinstance(nowhere.exception, InvalidInputError)
    assert nowhere.exception.field == "detect"


def test_a_lidar_is_scored_beside_the_picture_alone(drives, weights, tmp_path):
    for folder in drives:
        (folder / "lidar").mkdir()
        scan = np.column_stack([np.full(90, 10), np.linspace(0, 100, 90), np.linspace(1200, 1500, 90)])
        np.savez(folder / "lidar" / "000007.npz", points_cm=scan.astype(np.int16))
    done = run(*drives, "--weights", weights, "--lidar", "--json", tmp_path / "r.json")
    assert done.exit_code == 0, done.output
    made = json.loads((tmp_path / "r.json").read_text())
    assert {"median_depth", "fitted_cuboid"} < set(made["methods"])
    assert made["given"]["sensors"] == ["lidar"]
    assert "points" in made["methods"]["median_depth"]
    followed = run(*drives, "--weights", weights, "--lidar", "--track", "--json", tmp_path / "t.json")
    assert followed.exit_code == 0, followed.output
    assert {"online", "batch"} < set(json.loads((tmp_path / "t.json").read_text())["methods"])
    refused = run(*drives, "--weights", weights, "--depth", "--track")
    assert isinstance(refused.exception, InvalidInputError)
    assert "--track" in str(refused.exception)
