"""`fgrecon reconstruct` on several photographs: a results file each, and a bad one that stops no other."""

import json
import shutil

import numpy as np
import pytest
import trimesh

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from tests.command_line import run

pytest.importorskip("torch")


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A folder with the sample's street twice, and its boxes by name."""
    root = tmp_path_factory.mktemp("photographs")
    assert run("sample", "--out", root / "sample", "-q").exit_code == 0
    for name in ("images", "boxes"):
        (root / name).mkdir()
    for name in ("a", "b"):
        shutil.copy(root / "sample" / "street.png", root / "images" / f"{name}.png")
        lines = (root / "sample" / "detections.txt").read_text()
        (root / "boxes" / f"{name}.txt").write_text(lines)
    return root


def test_each_has_a_results_file(street, tmp_path):
    given = ("--boxes", street / "boxes", "--calib", street / "sample" / "calib.txt", "--camera-height", 1.65)
    prior = load_prior("car14")
    mesh = trimesh.Trimesh(prior.surface.mean, prior.surface.faces, process=False).export(file_type="ply")
    (street / "mean.ply").write_bytes(mesh)
    outputs = ("--out", tmp_path, "--pictures", "--models", street / "mean.ply")
    done = run("reconstruct", street / "images", *given, *outputs)
    assert done.exit_code == 0, done.output
    assert "6 vehicles in 2 of 2 images" in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.png", "b.json", "b.png"]
    single = run("reconstruct", street / "images" / "a.png", *given, "--json", "-")
    first, alone = json.loads((tmp_path / "a.json").read_text()), json.loads(single.stdout)
    assert {one["closest_model"]["name"] for one in first["instances"]} == {"mean"}
    assert [one["location"] for one in first["instances"]] == [one["location"] for one in alone["instances"]]


def test_a_bad_one_does_not_stop_the_others(street, tmp_path):
    bad = tmp_path / "bad.png"
    bad.write_bytes(b"no image")
    shutil.copy(street / "images" / "a.png", tmp_path / "a.png")
    out = tmp_path / "out"
    options = ("--boxes", street / "boxes", "--calib", street / "sample" / "calib.txt", "--out", out)
    done = run("reconstruct", bad, street / "images" / "a.png", tmp_path / "a.png", *options, "-q")
    assert done.exit_code == 1
    assert str(bad) in done.stderr
    assert sorted(path.name for path in out.iterdir()) == ["a-2.json", "a.json"]


def test_what_means_nothing_for_several_is_refused(street, tmp_path):
    images, out = street / "images", tmp_path / "out"
    for arguments, field in (
        ((images, "--detect"), "out"),
        ((images / "a.png", "--detect", "--pictures"), "out"),
        ((images, street / "sample" / "cars.json", "--out", out), "file"),
        ((street / "boxes", "--out", out), "file"),
        ((images, "--out", out, "--detect", "--json", "-"), "json"),
        ((images, "--out", out, "--box", "1,2,30,40"), "box"),
        ((images, "--out", images / "a.png", "--detect"), "out"),
    ):
        done = run("reconstruct", *arguments)
        assert isinstance(done.exception, InvalidInputError), (arguments, done.output)
        assert str(done.exception).startswith(field)


def test_a_part_of_a_photograph_has_the_camera_of_the_whole(street, tmp_path):
    from PIL import Image

    whole = street / "images" / "a.png"
    left, top = 100, 40
    with Image.open(whole) as picture:
        width, height = picture.size
        picture.crop((left, top, width, height)).save(tmp_path / "a.png")
    lines = [line.split() for line in (street / "boxes" / "a.txt").read_text().splitlines()]
    for line in lines:
        line[4:8] = [str(float(value) - off) for value, off in zip(line[4:8], (left, top, left, top), strict=True)]
    (tmp_path / "a.txt").write_text("\n".join(" ".join(line) for line in lines))
    given = ("--calib", street / "sample" / "calib.txt", "--camera-height", 1.65, "--json", "-")
    all_of_it = run("reconstruct", whole, "--boxes", street / "boxes" / "a.txt", *given)
    part = ("reconstruct", tmp_path / "a.png", "--boxes", tmp_path / "a.txt")
    cut = run(*part, "--crop", f"{left},{top},{width},{height}", *given)
    found = [[one["location"] for one in json.loads(done.stdout)["instances"]] for done in (all_of_it, cut)]
    assert len(found[0]) == len(found[1]) > 1
    assert all(
        abs(a - b) < 0.1 * max(map(abs, here))
        for here, there in zip(*found, strict=True)
        for a, b in zip(here, there, strict=True)
    )
    for crop, camera in ((f"{left},{top}", ()), (f"{left + 1},{top},{width},{height}", given)):
        refused = run(*part, "--crop", crop, *camera)
        assert isinstance(refused.exception, InvalidInputError)
        assert refused.exception.field == "crop"


def test_one_camera_took_them(street, tmp_path):
    images, boxes = street / "images", ("--boxes", street / "boxes")
    done = run("reconstruct", images, *boxes, "--same-camera", "--pictures", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    said = " ".join(done.stderr.split())
    assert said.count("No camera is given") == 1
    assert "from what the 6 cars of 2 images look like" in said
    found = [json.loads((tmp_path / "out" / f"{name}.json").read_text()) for name in ("a", "b")]
    cameras = [one["camera"] for file in found for one in file["instances"]]
    assert all(camera == cameras[0] for camera in cameras)
    assert "as were 3 of other images" in found[0]["scenes"][0]["message"]
    results = [one["result"] for file in found for one in file["instances"]]
    assert {one["status"] for one in results} <= {"weak", "ambiguous"}
    assert all("the focal length is known to" in one["reasons"][-1] for one in results)
    assert (tmp_path / "out" / "b.png").stat().st_size > 10_000
    for more in (
        ("--calib", street / "sample" / "calib.txt", "--out", tmp_path / "x"),
        ("--apart", "--out", tmp_path),
        (),
    ):
        refused = run("reconstruct", images if more else images / "a.png", *boxes, "--same-camera", *more)
        assert isinstance(refused.exception, InvalidInputError)
        assert refused.exception.field == "same_camera"


def test_another_focal_length_is_another_camera(street, tmp_path):
    """EXIF's: 28 mm, 28 mm and 50 mm of a film's frame."""
    from PIL import Image

    (tmp_path / "boxes").mkdir()
    for name, film in (("a", 28), ("b", 28), ("c", 50)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = film
        with Image.open(street / "images" / "a.png") as picture:
            picture.convert("RGB").save(tmp_path / f"{name}.jpg", exif=exif, quality=95)
            diagonal = float(np.hypot(*picture.size))
        shutil.copy(street / "boxes" / "a.txt", tmp_path / "boxes" / f"{name}.txt")
    images = [tmp_path / f"{name}.jpg" for name in "abc"]
    done = run("reconstruct", *images, "--boxes", tmp_path / "boxes", "--same-camera", "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "c.jpg: same_camera" in done.stderr
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.json", "b.json"]
    found = json.loads((tmp_path / "out" / "a.json").read_text())["scenes"][0]
    assert found["focal_lengths"][0]["pixels"] == pytest.approx(28 / 43.27 * diagonal, rel=0.1)
    assert found["focal_sigma"] <= 0.05
    assert "from the EXIF data and the 6 cars of 2 images" in " ".join(done.stderr.split())


def test_another_size_is_another_camera(street, tmp_path):
    from PIL import Image

    with Image.open(street / "images" / "a.png") as picture:
        picture.resize((picture.width // 2, picture.height // 2)).save(tmp_path / "small.png")
    (tmp_path / "boxes").mkdir()
    for name in ("a", "small"):
        shutil.copy(street / "boxes" / "a.txt", tmp_path / "boxes" / f"{name}.txt")
    options = ("--boxes", tmp_path / "boxes", "--same-camera", "--out", tmp_path / "out", "-q")
    done = run("reconstruct", street / "images" / "a.png", tmp_path / "small.png", *options)
    assert done.exit_code == 1
    assert "small.png" in done.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.json"]
