"""`--detect` and `fgrecon vehicles`, on a rendered car and on real streets."""

import json

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import box_overlap
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.simulation.sample import demo_scene
from tests.command_line import run


@pytest.fixture(scope="module")
def scene():
    return demo_scene(load_prior("car14"), 6)


@pytest.fixture(scope="module")
def images(scene, tmp_path_factory):
    """A folder with a rendered car and an image of nothing."""
    folder = tmp_path_factory.mktemp("images")
    write_png(folder / "car.png", scene.picture.image)
    write_png(folder / "nothing.png", np.full((120, 200, 3), 90, np.uint8))
    return folder


def test_an_image_is_reconstructed_without_any_box(images, scene):
    K = scene.camera.matrix
    intrinsics = f"--intrinsics={K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"
    done = run("reconstruct", images / "car.png", "--detect", intrinsics, "--camera-height", "1.65", "--json", "-")
    assert done.exit_code == 0, done.output
    (entry,) = json.loads(done.stdout)["instances"]
    off = entry["rotation_y"] - rotation_y(scene.truth.camera_T_object)
    assert abs(np.degrees(np.arctan2(np.sin(off), np.cos(off)))) < 5.0


def test_keypoints_are_found_without_any_box(images):
    done = run("keypoints", "detect", images / "car.png", "--detect", "--json", "-")
    assert done.exit_code == 0, done.output
    assert len(json.loads(done.stdout)["instances"]) == 1


@pytest.mark.parametrize("command", [["reconstruct"], ["keypoints", "detect"]])
def test_an_image_without_cars_says_so(images, command):
    done = run(*command, images / "nothing.png", "--detect")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "detect"
    assert "No car was found" in str(done.exception)


@pytest.mark.parametrize("other", [["--box", "1,2,30,40"], ["--boxes", "absent.txt"]])
@pytest.mark.parametrize("command", [["reconstruct"], ["keypoints", "detect"]])
def test_one_source_of_boxes_at_a_time(images, command, other):
    done = run(*command, images / "car.png", "--detect", *other)
    assert isinstance(done.exception, InvalidInputError)
    assert all(f"({flag})" in done.exception.value for flag in (other[0], "--detect"))


def test_a_keypoint_file_is_not_searched(images):
    (file := images / "keypoints.json").write_text("[]")
    done = run("reconstruct", file, "--detect")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "detect"


def test_a_file_that_is_no_image_is_named_with_the_endings_of_images(images):
    (phone := images / "phone.xcf").write_bytes(b"gimp")
    done = run("reconstruct", phone, "--detect")
    assert isinstance(done.exception, InvalidInputError)
    assert "phone.xcf" in str(done.exception)
    assert ".jpeg" in str(done.exception)


def test_a_photograph_that_is_not_there_is_called_missing(tmp_path):
    done = run("reconstruct", tmp_path / "photo.heic", "--detect")
    assert isinstance(done.exception, InvalidInputError)
    assert "No such file" in done.exception.fix


@pytest.mark.parametrize("command", ["reconstruct", "batch", "track", "run"])
def test_a_photograph_in_a_format_that_is_not_read_is_called_one(tmp_path, command):
    folder = tmp_path / "phone"
    folder.mkdir()
    (folder / "photo.HEIC").write_bytes(b"ftypheic")
    out = ["--out", tmp_path / "out"]
    outs = {"reconstruct": ([], out), "batch": (out, out), "track": ([],), "run": (out, out)}[command]
    for given, rest in zip((folder / "photo.HEIC", folder), outs, strict=False):
        done = run(command, given, *rest)
        assert isinstance(done.exception, InvalidInputError)
        assert done.exception.value == str(folder / "photo.HEIC")
        assert "JPEG" in done.exception.fix
        assert "--detect" in done.exception.fix


def test_detections_are_what_boxes_reads(images, scene):
    out = images / "found.txt"
    assert run("vehicles", "detect", images / "car.png", images / "nothing.png", "--out", out).exit_code == 0
    (line,) = out.read_text().splitlines()
    name, kind, score, *box, encloses = line.split()
    assert (name, kind, encloses) == ("car.png", "2", "detected")
    assert 0.5 < float(score) <= 1.0
    assert box_overlap(np.array([box], dtype=float), scene.observation.box[None])[0, 0] > 0.75
    assert run("keypoints", "detect", images / "car.png", "--boxes", out).exit_code == 0


def test_written_detections_give_what_detect_gives(images, tmp_path):
    """They were taken for projected 3D boxes, as those of a detector trained on KITTI are."""
    out = tmp_path / "found.txt"
    assert run("vehicles", "detect", images / "car.png", "--out", out).exit_code == 0
    depths = []
    for boxes in (["--detect"], ["--boxes", out], ["--boxes", out, "--box-model", "cuboid"]):
        done = run("reconstruct", images / "car.png", *boxes, "--intrinsics=700,700,620,180", "--json", "-")
        assert done.exit_code == 0, done.output
        (entry,) = json.loads(done.stdout)["instances"]
        depths.append(entry["location"][2])
    assert depths[0] == pytest.approx(depths[1], abs=0.01)  # lines have a hundredth of a pixel
    assert abs(depths[0] - depths[2]) > 0.05


def test_exit_code_of_finding_nothing(images):
    done = run("vehicles", "detect", images / "nothing.png")
    assert done.exit_code == 1
    assert done.stdout == ""
    assert "No car was found" in done.stderr


def test_conversion_needs_its_file(tmp_path):
    done = run("vehicles", "convert", "--package", tmp_path / "a.tgz", "--out", tmp_path / "o")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "package"


def test_a_real_street(data, tmp_path):
    folder = data / "kitti_object" / "training"
    image = folder / "image_2" / "000010.png"
    if not image.is_file():
        pytest.skip("the images of KITTI are absent from the real data")
    calib, out = folder / "calib" / "000010.txt", tmp_path / "r.json"
    done = run("reconstruct", image, "--detect", "--calib", calib, "--camera-height", "1.65", "--json", out)
    assert done.exit_code == 0, done.output
    cars = json.loads(out.read_text())["instances"]
    labels = [line.split() for line in (folder / "label_2" / "000010.txt").read_text().splitlines()]
    nearest = [car["location_in_label_frame"] for car in cars if "location_in_label_frame" in car]
    # the cars that are in full view: with their direction, and placed within 15 % of their distance, since one is only
    # 3.2 m long, which a picture does not tell from a longer car further away
    for label in labels:
        if label[0] != "Car" or float(label[1]) > 0 or int(label[2]) > 0 or float(label[7]) - float(label[5]) < 60:
            continue
        place, yaw = np.array(label[11:14], dtype=float), float(label[14])
        error = [np.linalg.norm(np.subtract(at, place)) for at in nearest]
        best = int(np.argmin(error))
        assert error[best] < 0.15 * np.linalg.norm(place)
        assert np.cos(cars[best]["rotation_y"] - yaw) > np.cos(np.radians(15.0))


def test_hidden_keypoints_have_no_place_in_the_table():
    """Their pixels are guesses, and a confidence of 0.00 looks like a measurement."""
    from types import SimpleNamespace

    import numpy as np
    from rich.console import Console

    from fgrecon.cli.keypoints import _table

    seen = SimpleNamespace(
        keypoints=np.array([[10.0, 20.0], [30.0, 40.0]]), confidence=np.array([0.97, 0.001]), covariance=None
    )
    found = SimpleNamespace(observation=seen, visible=np.array([0.9, 0.1]))
    console = Console(width=80)
    with console.capture() as captured:
        console.print(_table(["car"], [found], ("left", "right"), verbose=False))
    lines = captured.get().splitlines()
    (left,), (right,) = ([line for line in lines if name in line] for name in ("left", "right"))
    assert left.split() == ["car", "left", "10.0", "20.0", "0.97"]
    assert right.split() == ["car", "right", "hidden"]
