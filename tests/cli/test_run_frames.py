"""`fgrecon run` on frames as others name them, and on frames that are not all alike."""

import json

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.io.images import read_image, write_png
from fgrecon.io.kitti_files import read_tracking
from tests.video.streets import make_drive


def run(*arguments):
    done = CliRunner().invoke(main.app, ["run", *map(str, arguments)])
    assert done.exit_code == 0, (done.output, done.exception)
    return done


def frames_of(out):
    return [json.loads(line) for line in (out / "frames.jsonl").read_text().splitlines()]


def test_keypoints_of_images_that_are_named_by_times(tmp_path):
    """Alone, and beside the images, which have the same names."""
    images, file = make_drive(tmp_path / "drive", 6)
    content = json.loads(file.read_text())
    names = {3 + k + (k >= 4): f"n015__CAM_FRONT__{1532402927612460 + 83_333 * k}" for k in range(6)}
    for number, name in names.items():
        (images / f"{number:06d}.png").rename(images / f"{name}.png")
    for instance in content["instances"]:
        instance["image"] = f"samples/CAM_FRONT/{names[instance.pop('frame')]}.jpg"
    file.write_text(json.dumps(content))
    run(file, "--out", tmp_path / "alone")
    run(images, "--tracks", file, "--out", tmp_path / "beside")
    alone, beside = (frames_of(tmp_path / out) for out in ("alone", "beside"))
    for found in (alone, beside):
        assert [frame["frame"] for frame in found] == list(range(6))
        assert np.diff([frame["time"] for frame in found]) == pytest.approx(np.full(5, 0.083333), abs=1e-6)
        assert [[vehicle["id"] for vehicle in frame["vehicles"]] for frame in found] == [[10, 11]] * 6
    assert len(read_tracking(tmp_path / "alone" / "tracks.txt")) == 6


def test_a_frame_of_another_size_is_a_gap(tmp_path):
    """Its keypoints are another camera's; the camera's motion goes on over it, also where the run is taken up again."""
    images, file = make_drive(tmp_path / "drive", 6, metres=0.4)
    small = read_image(images / "000006.png")[::2, ::2]
    write_png(images / "000006.png", small)
    arguments = (images, "--tracks", file, "--fps", 10, "--camera-height", 1.65, "--video", tmp_path / "a.mp4")
    run(*arguments, "--out", tmp_path / "out")
    found = frames_of(tmp_path / "out")
    assert [frame["frame"] for frame in found if frame["problem"] is not None] == [6]
    assert "000006.png: 621 x 188 pixels, not 1242 x 375" in found[3]["problem"]
    assert [len(frame["vehicles"]) for frame in found] == [2, 2, 2, 0, 2, 2]
    assert found[3]["world_T_camera"] is None
    assert found[-1]["world_T_camera"][2][3] == pytest.approx(2.4, abs=0.1)
    again = run(*arguments, "--out", tmp_path / "out")
    assert "6 were looked at before" in again.stdout
    assert frames_of(tmp_path / "out") == found


def test_images_of_one_name_are_exported_apart(tmp_path):
    images, file = make_drive(tmp_path / "drive", 3)
    content = json.loads(file.read_text())
    for number in (3, 4, 5):
        (folder := tmp_path / "drives" / str(number)).mkdir(parents=True)
        (images / f"{number:06d}.png").rename(folder / "000000.png")
    for instance in content["instances"]:
        instance["image"] = f"{instance.pop('frame')}/000000.png"
    file.write_text(json.dumps(content))
    run(tmp_path / "drives" / "*" / "*.png", "--tracks", file, "--fps", 10, "--out", tmp_path / "out")
    exported = tmp_path / "coco.json"
    CliRunner().invoke(main.app, ["export", str(tmp_path / "out"), str(exported), "--format", "coco"])
    found = [(entry["image_id"], entry["id"]) for entry in json.loads(exported.read_text())]
    assert found == [(f"{number}/000000.png", track) for number in (3, 4, 5) for track in ("10", "11")]


def test_the_exif_data_are_those_of_the_first_frame_that_can_be_read(tmp_path):
    images, file = make_drive(tmp_path / "drive", 4)
    content = json.loads(file.read_text())
    del content["K"]
    file.write_text(json.dumps(content))
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 25
    for path in sorted(images.iterdir()):
        with Image.open(path) as picture:
            picture.save(path.with_suffix(".jpg"), exif=exif)
        path.unlink()
    (images / "000003.jpg").write_bytes(b"torn")
    run(images, "--tracks", file, "--fps", 10, "--out", tmp_path / "out", "--json", tmp_path / "run.json")
    camera = json.loads((tmp_path / "run.json").read_text())["settings"]["camera"]
    assert camera["matrix"][0][0] == pytest.approx(25 / 43.2666 * np.hypot(1242, 375), rel=1e-4)
