"""`fgrecon sample`: what it writes is what the other commands read."""

import json

import numpy as np
import pytest

from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.sample import sample_street
from tests.command_line import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample") / "made"
    done = run("sample", "--out", folder)
    assert done.exit_code == 0, done.output
    names = ("street.png", "street.npz", "calib.txt", "cars.json", "boxes.txt", "detections.txt", "TRACK.json", "drive")
    assert [line for line in done.stdout.splitlines() if line.startswith("Wrote")] == [
        f"Wrote {folder / name}." for name in names
    ]
    return folder


def test_the_same_seed_gives_the_same_bytes(folder, tmp_path):
    assert run("sample", "--out", tmp_path / "again", "-q").output == ""
    assert run("sample", "--out", tmp_path / "other", "--seed", 1).exit_code == 0
    written = [path for path in folder.rglob("*") if path.is_file()]
    assert len(written) == 7 + 8
    for path in written:
        assert (tmp_path / "again" / path.relative_to(folder)).read_bytes() == path.read_bytes()
    assert (tmp_path / "other" / "cars.json").read_bytes() != (folder / "cars.json").read_bytes()


def test_cars_are_reconstructed_where_they_were_put(folder, tmp_path):
    given = ("--camera-height", 1.65, "--image", folder / "street.png", "--picture", tmp_path / "cars.png")
    done = run("reconstruct", folder / "cars.json", "--calib", folder / "calib.txt", *given, "--json", "-")
    assert done.exit_code == 0, done.output
    assert f"Wrote {tmp_path / 'cars.png'}." in done.stderr
    cars = json.loads(done.stdout)["instances"]
    assert [car["id"] for car in cars] == ["car-1", "car-2", "car-3"]
    assert [round(car["location"][0]) for car in cars] == pytest.approx([-3.4, 2.9, -10.5], abs=1.0)
    assert cars[0]["location"][0] - cars[0]["location_in_label_frame"][0] == pytest.approx(0.06)


def test_the_picture_is_read_with_the_boxes(folder, tmp_path):
    out = tmp_path / "found.json"
    done = run("keypoints", "detect", folder / "street.png", "--boxes", folder / "boxes.txt", "--json", out)
    assert done.exit_code == 0, done.output
    assert len(json.loads(out.read_text())["instances"]) == 3
    assert run("reconstruct", out, "--calib", folder / "calib.txt", "-q").output == ""
    assert "without a meaning" not in run("reconstruct", out, "--calib", folder / "calib.txt").output


def test_a_keypoint_file_gives_what_the_image_gives(folder, tmp_path):
    """Once it is given what the boxes enclose and that its cars are of one image, as the guide says."""
    boxes, calib = ("--boxes", folder / "boxes.txt"), ("--calib", folder / "calib.txt", "--json", "-")
    found = tmp_path / "found.json"
    assert run("keypoints", "detect", folder / "street.png", *boxes, "--json", found).exit_code == 0
    image = run("reconstruct", folder / "street.png", *boxes, *calib)
    file = run("reconstruct", found, "--box-model", "surface", "--together", *calib)
    without = run("reconstruct", found, *calib)
    places = [[car["location"] for car in json.loads(done.stdout)["instances"]] for done in (image, file, without)]
    assert places[1] == [pytest.approx(place, abs=1e-6) for place in places[0]]
    assert places[2] != [pytest.approx(place, abs=0.05) for place in places[0]]


def test_the_detector_finds_the_rendered_cars_where_they_are(folder):
    """As the guide to photographs says: these cars are of the fleet that the guides tell."""
    truth = [c.truth.camera_T_object for c in sample_street(load_prior("car14").for_fleet(size_prior("kitti"))).cars]
    given = ("--calib", folder / "calib.txt", "--camera-height", "1.65", "--size-prior", "kitti", "--json", "-")
    for how in ("--detect",), ("--boxes", folder / "boxes.txt"):
        done = run("reconstruct", folder / "street.png", *how, *given)
        places = np.array([car["location"] for car in json.loads(done.stdout)["instances"]])
        assert len(places) == 3
        for pose in truth:
            assert np.linalg.norm(places - pose[:3, 3], axis=1).min() < 0.13 * pose[2, 3]


def test_the_track(folder):
    done = run("track", folder / "TRACK.json", "--size-prior", "kitti", "--verbose")
    assert done.exit_code == 0, done.output
    assert "converged" in done.stdout
    assert "energies (nats): reprojection" in done.stdout
    scored = run("evaluate", "tracks", folder / "TRACK.json", "--method", "fgrecon+ground+size", "--json", "-")
    (method,) = json.loads(scored.stdout)["methods"].values()
    assert method["n"] == 8
    assert method["aop"]["15"] == 100.0
