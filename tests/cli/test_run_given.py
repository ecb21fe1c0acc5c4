"""`fgrecon run --tracks`: boxes of any score, frames that are not the video's, and pictures of nothing."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.io.video_frames import write_video
from tests.video.streets import make_drive

INTRINSICS = ("--intrinsics", "721.5,721.5,609.6,172.9")


def run(*arguments):
    return CliRunner().invoke(main.app, ["run", *map(str, arguments)])


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return make_drive(tmp_path_factory.mktemp("drive"), 3)


def results(path, numbers, score):
    """KITTI's tracking results: one car that stands, without an id."""
    car = f"-1 Car 0 0 0 500 180 620 250 1.5 1.6 4.0 -3 1.7 20 1.5 {score}"
    path.write_text("".join(f"{number} {car}\n" for number in numbers))
    return path


@pytest.mark.parametrize("score", [0.31, -4.2, 0.9, 87.0])
def test_given_boxes_are_taken_whatever_their_scores(drive, tmp_path, score):
    """KITTI's scores are of any scale."""
    tracks = results(tmp_path / "tracks.txt", (3, 4, 5), score)
    done = run(drive[0], "--tracks", tracks, *INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    assert "3 frames, 1 car" in done.stdout, done.output
    assert "Warning" not in done.stderr
    frames = [json.loads(line) for line in (tmp_path / "out" / "frames.jsonl").read_text().splitlines()]
    assert [[(v["id"], v["score"]) for v in frame["vehicles"]] for frame in frames] == [[(0, score)]] * 3


def test_vehicles_in_frames_of_another_video_are_refused(drive, tmp_path):
    tracks = results(tmp_path / "tracks.txt", (100, 101, 107), 0.9)
    done = run(drive[0], "--tracks", tracks, *INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    assert "vehicles in frames 100 to 107. Give vehicles of the frames, 3 to 5" in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_vehicles_counted_from_another_number_are_warned_of(drive, tmp_path):
    tracks = results(tmp_path / "tracks.txt", (4, 5, 6), 0.9)
    done = run(drive[0], "--tracks", tracks, *INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    assert done.exit_code == 0
    assert "Warning: Vehicles are given for 1 frame that is not there" in done.stderr
    assert "Do they count from 4 instead of 3?" in done.stderr


def test_without_a_vehicle_there_is_no_picture_and_everything_else(drive, tmp_path):
    """The images show nothing."""
    picture, summary = tmp_path / "a.png", tmp_path / "a.json"
    asked = (drive[0], *INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    for frame in ((), ("--picture-frame", 4)):
        done = run(*asked, "--picture", picture, "--json", summary, *frame)
        assert done.exit_code == 1
        assert f"{picture} is not written: there is no vehicle in " in done.stderr
        assert "No car could be reconstructed" in done.stderr
        assert json.loads(summary.read_text())["frames"] == 3
        summary.unlink()
    assert not picture.exists()


def test_a_frame_without_a_vehicle_is_not_drawn(drive, tmp_path):
    """The cars of the others are written all the same; the exit code says that something is missing."""
    images, file = drive
    content = json.loads(file.read_text())
    content["instances"] = [one for one in content["instances"] if one["frame"] != 4]
    (tracks := tmp_path / "tracks.json").write_text(json.dumps(content))
    asked = (images, "--tracks", tracks, "--fps", 10, "--out", tmp_path / "out", "--quiet", "--picture-frame", 4)
    done = run(*asked, "--picture", tmp_path / "a.png", "--json", tmp_path / "a.json")
    assert (done.exit_code, json.loads((tmp_path / "a.json").read_text())["estimates"] > 0) == (1, True)
    assert "a.png is not written: there is no vehicle in frame 4" in done.stderr


def test_mots_boxes_are_tracked(drive, tmp_path):
    """Their class is a car's; ids, scores and boxes are in all tables, and no keypoints are blamed."""
    tracks = tmp_path / "mot.txt"
    tracks.write_text("".join(f"{number},7,500,180,120,70,0.8,-1,-1,-1\n" for number in (3, 4, 5)))
    done = run(drive[0], "--tracks", tracks, *INTRINSICS, "--fps", 10, "--out", out := tmp_path / "out")
    assert (done.exit_code, "Warning" in done.stderr) == (0, False), done.output
    words = [line.split() for line in (out / "tracks.txt").read_text().splitlines()]
    assert [(w[0], w[1], w[2], w[6:10], w[-1]) for w in words] == [
        (str(number), "7", "Car", ["500.00", "180.00", "620.00", "250.00"], "0.8000") for number in (3, 4, 5)
    ]
    for line in (out / "frames.jsonl").read_text().splitlines():
        (vehicle,) = json.loads(line)["vehicles"]
        assert (vehicle["id"], vehicle["kind"], vehicle["score"]) == (7, "Car", 0.8)
    rows = list(csv.DictReader((out / "tracks.csv").read_text().splitlines()))
    assert [(row["id"], row["kind"], row["score"]) for row in rows] == [("7", "Car", "0.8")] * 3


def keypoints_of_size(drive, path, size, ratio):
    """The drive's keypoints as if its images had another size."""
    content = json.loads(drive[1].read_text())
    instances = content if isinstance(content, list) else content["instances"]
    for one in instances:
        points = one["keypoints"]
        for value in points.values() if isinstance(points, dict) else points:
            if value is not None:
                value[0], value[1] = ratio * (value[0] + 0.5) - 0.5, ratio * (value[1] + 0.5) - 0.5
        if one.get("box") is not None:
            one["box"] = [ratio * edge for edge in one["box"]]
        one["image_size"] = size
    path.write_text(json.dumps(content))
    return path


def test_keypoints_of_a_smaller_picture_are_refused_or_scaled(drive, tmp_path):
    tracks = keypoints_of_size(drive, tmp_path / "tracks.json", [621, 188], 0.5)
    given = (drive[0], "--tracks", tracks, *INTRINSICS, "--fps", 10)
    refused = run(*given, "--out", tmp_path / "refused")
    assert "an image of 621 x 188 pixels" in str(refused.exception)
    assert not (tmp_path / "refused").exists()
    scaled = run(*given, "--scale-to-image", "--out", tmp_path / "scaled")
    assert scaled.exit_code == 0, scaled.output
    assert run(drive[0], "--tracks", drive[1], *INTRINSICS, "--fps", 10, "--out", tmp_path / "right").exit_code == 0
    found = [list(csv.DictReader((tmp_path / n / "tracks.csv").read_text().splitlines())) for n in ("scaled", "right")]
    for one, other in zip(*found, strict=True):
        assert float(one["x"]) == pytest.approx(float(other["x"]), abs=0.1)
        assert float(one["z"]) == pytest.approx(float(other["z"]), abs=0.3)


def yolo(folder, names, kind=2):
    """A folder with a car, of track 7, for each name."""
    folder.mkdir()
    for name in names:
        (folder / f"{name}.txt").write_text(f"{kind} 0.45 0.57 0.1 0.19 0.8 7\n0 0.2 0.5 0.1 0.1 0.9 3\n")
    return folder


def tracked(out):
    with (out / "tracks.csv").open(newline="") as file:
        return [(row["frame"], row["id"], row["kind"], row["score"]) for row in csv.DictReader(file)]


def test_a_folder_of_yolos_is_tracked_by_its_ids(drive, tmp_path):
    given = ("--tracks", yolo(tmp_path / "labels", ("000003", "000004", "000005")), *INTRINSICS, "--fps", 10)
    done = run(drive[0], *given, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert tracked(tmp_path / "out") == [(n, "7", "Car", "0.8") for n in "345"]
    assert "3 person are left out; Car of the frames are taken" in done.stderr


def test_a_table_of_boxes_is_tracked_and_other_images_are_said(drive, tmp_path):
    names = sorted(path.name for path in drive[0].iterdir())
    rows = [f"{name},car,0.8,500,180,620,250,7" for name in [*names, "000009.png"]]
    (tmp_path / "boxes.csv").write_text("\n".join(["image,class,score,x1,y1,x2,y2,track_id", *rows]) + "\n")
    done = run(drive[0], "--tracks", tmp_path / "boxes.csv", *INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert tracked(tmp_path / "out") == [(n, "7", "Car", "0.8") for n in "345"]
    assert "1 of images that are no frames" in done.stderr


def test_a_folder_counted_from_another_number_is_warned_of_or_refused(drive, tmp_path):
    given = (*INTRINSICS, "--fps", 10, "--out", tmp_path / "out")
    done = run(drive[0], "--tracks", yolo(tmp_path / "from4", ("000004", "000005", "000006")), *given)
    assert "Do they count from 4 instead of 3?" in done.stderr
    done = run(drive[0], "--tracks", yolo(tmp_path / "far", ("000101", "000102")), *given)
    assert "vehicles in frames 101 to 102" in str(done.exception)
    done = run(drive[0], "--tracks", yolo(tmp_path / "trucks", ("000003",), kind=7), *given)
    assert "with 1 person, 1 truck" in str(done.exception)


def test_ultralytics_counts_frames_of_a_video_from_one(tmp_path):
    from fgrecon.io.catalogue import load_category
    from fgrecon.video import open_frames, read_given

    video = tmp_path / "street.mp4"
    with write_video(video, rate=10) as add:
        for number in range(3):
            add(np.full((48, 64, 3), 80 * number, np.uint8), 0.1 * number)
    given = read_given(
        yolo(tmp_path / "labels", ("street_1", "street_3")), load_category("car14"), source=open_frames(str(video))
    )
    assert {number: [one.identity for one in some] for number, some in given.vehicles.items()} == {0: [7], 2: [7]}
