"""`fgrecon track` and `fgrecon export` from the outside."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export import read_results
from fgrecon.io.images import read_image, write_png
from fgrecon.viz import replay
from tests.cli.conftest import INTRINSICS, K, car
from tests.command_line import run


@pytest.fixture
def drive():
    """Three images of one car, as instances of a keypoint file."""
    poses = [(-2.2 + 0.15 * t, (-2.0 + 0.6 * t, 1.65, 11.0 - t)) for t in range(3)]
    return {"instances": [{"id": f"image:{5 + 2 * t}", **car(*pose)} for t, pose in enumerate(poses)]}, poses


def test_a_keypoint_file_with_the_images_of_one_vehicle(write, drive, tmp_path):
    content, poses = drive
    out, rrd, sheet = tmp_path / "track.json", tmp_path / "track.rrd", tmp_path / "sheet.png"
    done = run(
        "track", write(content), INTRINSICS, "--camera-height", 1.65, "--json", out, "--save", rrd, "--picture", sheet
    )
    assert done.exit_code == 0, done.output
    assert "3 images share one shape" in done.stdout
    data = json.loads(out.read_text())
    assert [entry["id"] for entry in data["instances"]] == ["image:5", "image:7", "image:9"]
    for entry, (yaw, location) in zip(data["instances"], poses, strict=True):
        assert abs(entry["rotation_y"] - yaw) < np.radians(2)
        assert np.linalg.norm(np.array(entry["location"]) - location) < 0.3
        assert entry["result"]["coefficients"] == data["tracks"][0]["coefficients"]
    back = replay.read(rrd)
    assert list(back.frames) == [5, 7, 9]
    assert len(back.joint) > 0
    assert read_image(sheet).std() > 5


@pytest.mark.parametrize(
    ("same", "said"),
    [
        ({"image": "street.png"}, "image:5 and image:7 are both in street.png"),
        ({"frame": 4}, "image:5 and image:7 are both in frame 4"),
        ({"image": "left.png", "frame": 4}, "image:5 and image:7 are both in left.png"),
    ],
)
def test_several_vehicles_of_one_image_are_no_track(write, drive, same, said):
    for instance in drive[0]["instances"][:2]:
        instance.update(same)
    done = run("track", write(drive[0]), INTRINSICS)
    assert isinstance(done.exception, InvalidInputError)
    assert said in done.exception.value
    assert "fgrecon reconstruct" in done.exception.fix


def test_vehicles_of_several_ids_are_no_track(write, drive):
    for number, instance in enumerate(drive[0]["instances"]):
        instance.update(track=number % 2, frame=number)
    done = run("track", write(drive[0]), INTRINSICS)
    assert isinstance(done.exception, InvalidInputError)
    assert "has id 0" in done.exception.value


@pytest.mark.parametrize("named", [True, False])
def test_instances_that_may_be_of_one_image_are_warned_of(write, drive, named):
    for number, instance in enumerate(drive[0]["instances"]):
        instance["id"] = f"car-{number}"
        instance.update({"image": f"{number}.png"} if named else {})
    done = run("track", write(drive[0]), INTRINSICS)
    assert ("car-0 and car-1 have neither `image` nor `frame`" in " ".join(done.stderr.split())) != named


def test_a_vehicle_before_two_cameras_at_a_time_is_a_track(write, drive):
    for instance, image in zip(drive[0]["instances"], ("left.png", "right.png", "left-2.png"), strict=True):
        instance.update(track=3, frame=4, image=image)
    assert run("track", write(drive[0]), INTRINSICS).exit_code == 0


def test_results_of_a_track_are_exported(write, drive, tmp_path):
    out = tmp_path / "track.json"
    assert run("track", write(drive[0]), INTRINSICS, "--json", out).exit_code == 0
    assert [item.name for item in read_results(out)] == ["image:5", "image:7", "image:9"]
    done = run("export", out, tmp_path / "cars.csv")
    assert done.exit_code == 0
    assert done.stdout.startswith("3 vehicles.\nWrote ")
    assert len((tmp_path / "cars.csv").read_text().splitlines()) == 4
    assert "csv has no place for this, which is not written: lean to the side or ahead (3 vehicles)" in done.stderr
    done = run("export", out, tmp_path / "cars.json", "--format", "openlabel", "--json", "-")
    about = json.loads(done.stdout)
    assert (about["kind"], about["vehicles"], about["not_written"]) == ("openlabel", 3, {"uncertainty": 3})
    assert "uncertainty (3 vehicles)" in done.stderr


def test_tracks_and_ids_of_one_name_are_distinguished(drive, tmp_path):
    for folder in "ab":
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "car.json").write_text(json.dumps(drive[0]))
    out = tmp_path / "tracks.json"
    done = run("track", tmp_path / "a/car.json", tmp_path / "b/car.json", INTRINSICS, "--json", out)
    assert done.exit_code == 0, done.output
    data = json.loads(out.read_text())
    assert [track["track"] for track in data["tracks"]] == ["car", "car-2"]
    numbers = (5, 7, 9)
    ids = [*(f"image:{n}" for n in numbers), *(f"car-2:{n}" for n in numbers)]
    assert [(one["id"], one["track"]) for one in data["instances"]] == list(
        zip(ids, ["car"] * 3 + ["car-2"] * 3, strict=True)
    )
    assert "car-2: " in done.stdout
    assert run("export", out, tmp_path / "cars.txt").exception.field == "results"


def test_photographs_come_from_a_folder(write, drive, tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    content = drive[0]
    for number in (5, 7):
        write_png(folder / f"{number:06d}.png", np.full((375, 1242, 3), 90, np.uint8))
    done = run("track", write(content), INTRINSICS, "--images", folder)
    assert "000009.png" in str(done.exception)
    write_png(folder / "000009.png", np.full((375, 1242, 3), 90, np.uint8))
    done = run("track", write(content), INTRINSICS, "--images", folder, "--save", tmp_path / "t.rrd")
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("by", ["id", "frame"])
def test_photographs_are_those_of_the_frames_also_where_these_do_not_increase(write, drive, tmp_path, by):
    folder = tmp_path / "images"
    folder.mkdir()
    content = drive[0]
    numbers = (20, 19, 17)
    for one, number in zip(content["instances"], numbers, strict=True):
        one |= {"id": f"car:{number}"} if by == "id" else {"id": f"car {number}", "frame": number}
    for number in (0, 1, 2, *numbers):
        write_png(folder / f"{number:06d}.png", np.full((375, 1242, 3), 10 * number, np.uint8))
    from fgrecon.cli import track_report
    from fgrecon.core.options import Options
    from fgrecon.io.cameras.camera_source import CameraSource
    from fgrecon.io.run_settings import RunSettings

    settings = RunSettings.of("car14", None, None, Options())
    source = CameraSource(intrinsics=[float(x) for x in INTRINSICS.partition("=")[2].split(",")])
    sight = track_report.solve(write(content), source, settings, folder).sight
    assert [image[0, 0, 0] for image in sight.images] == [10 * number for number in numbers]
    assert sight.numbers == [0, 1, 2]  # of a recording's frames, which are in order


def test_labels_give_errors_beside_those_of_the_images_alone(write, drive):
    content, poses = drive
    frames = [
        {
            "frame": 5 + t,
            "box_xyxy": instance["box"],
            "keypoints_uv": instance["keypoints"],
            "confidence": instance["confidence"],
            "gt": {"location": list(location), "rotation_y": yaw, "length": 4.4, "width": 1.8, "height": 1.5},
        }
        for t, (instance, (yaw, location)) in enumerate(zip(content["instances"], poses, strict=True))
    ]
    from fgrecon.io.catalogue import load_category

    names = list(load_category("car14").keypoints)
    projection = np.column_stack([K, np.zeros(3)]).tolist()
    track = {"K": K.tolist(), "P2": projection, "keypoint_names": names, "frames": frames}
    done = run("track", write(track, "drive.json"))
    assert done.exit_code == 0, done.output
    (row,) = (line for line in done.stdout.splitlines() if line.startswith("drive ") and ": " not in line)
    assert float(row.split()[-3]) < 2.0  # yaw
    assert "Δ yaw °" in done.stdout
    assert "\n  alone " in done.stdout
    assert max(map(len, done.stdout.split("\ndrive: ")[0].splitlines())) <= 80


def test_bad_names_and_files_are_refused_before_the_work(write, drive, tmp_path, monkeypatch):
    monkeypatch.setattr("fgrecon.cli.track_report.solve", pytest.fail)
    for option, value in (("--save", "a.png"), ("--picture", tmp_path / "no" / "a.png"), ("--connect", "x")):
        done = run("track", write(drive[0]), INTRINSICS, option, value)
        assert done.exit_code != 0
        assert isinstance(done.exception, ValueError)
    for name in ("a.obj", "no/a.csv"):
        assert isinstance(run("export", write(drive[0]), tmp_path / name).exception, ValueError)
    assert "format" in str(run("export", write(drive[0]), tmp_path / "a.csv").exception)


def test_an_animation_of_one_vehicle(write, instance, tmp_path):
    done = run("reconstruct", write(instance), INTRINSICS, "--no-joint", "--animation", tmp_path / "a.gif")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "a.gif").read_bytes()[:4] == b"GIF8"
    two = write({"instances": [{**instance, "id": name} for name in ("near", "far")]})
    made = ("--animation", tmp_path / "b.gif", "--json", tmp_path / "b.json")
    done = run("reconstruct", two, INTRINSICS, *made)
    assert done.exception.field == "animation"
    assert "--id: near, far" in done.exception.fix
    assert not (tmp_path / "b.json").exists(), "it is refused before the work"
    assert run("reconstruct", two, INTRINSICS, *made, "--id", "far").exit_code == 0
    assert [entry["id"] for entry in json.loads((tmp_path / "b.json").read_text())["instances"]] == ["far"]
    assert (tmp_path / "b.gif").read_bytes()[:4] == b"GIF8"
    assert run("reconstruct", two, INTRINSICS, "--id", "none").exception.field == "id"
    assert "gif, mp4" in str(run("reconstruct", write(instance), INTRINSICS, "--animation", "b.png").exception)
