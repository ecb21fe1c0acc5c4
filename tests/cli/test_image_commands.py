"""Commands that start from an image, with a network that has learnt nothing: inputs, outputs, refusals."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior, save_prior
from fgrecon.io.images import write_png
from fgrecon.viz import replay
from tests.command_line import run

pytest.importorskip("torch")

CALIB = "P2: 700 0 80 40 0 700 50 0.2 0 0 1 0.002\n"
LABEL = "0.00 0 1.5 20.0 20.0 110.0 80.0 1.5 1.6 4.0 0.1 1.6 15 1.5"


@pytest.fixture
def street(tmp_path):
    """A folder in KITTI's layout with one image of noise."""
    image = np.random.default_rng(0).integers(0, 255, (100, 160, 3)).astype(np.uint8)
    for name in ("image_2", "label_2", "calib"):
        (tmp_path / name).mkdir()
    write_png(tmp_path / "image_2" / "000001.png", image)
    (tmp_path / "label_2" / "000001.txt").write_text(f"Van {LABEL}\nCar {LABEL}\n")
    (tmp_path / "calib" / "000001.txt").write_text(CALIB)
    return tmp_path


def test_detected_keypoints_are_what_reconstruct_reads(street, weights):
    image, out, sheet = street / "image_2" / "000001.png", street / "k.json", street / "k.png"
    done = run(
        "keypoints", "detect", image, "--box", "10,10,90,80", "--weights", weights, "--json", out, "--picture", sheet
    )
    assert done.exit_code == 0, done.output
    assert "left_front_wheel" in done.stdout
    assert sheet.stat().st_size > 1000
    (instance,) = json.loads(out.read_text())["instances"]
    assert np.shape(instance["keypoints"]) == (14, 2)
    assert sum(instance["azimuth"]) == pytest.approx(1.0)
    assert run("reconstruct", out, "--intrinsics", "700,700,80,50").exit_code == 0


def test_a_keypoint_file_gives_what_the_image_gives(tmp_path):
    """The shipped networks on the sample's street: points, covariances and directions survive the file."""
    assert run("sample", "--out", tmp_path / "sample").exit_code == 0
    image, boxes, calib = (tmp_path / "sample" / name for name in ("street.png", "boxes.txt", "calib.txt"))
    assert run("keypoints", "detect", image, "--boxes", boxes, "--json", tmp_path / "k.json").exit_code == 0
    found = []
    for given in ([tmp_path / "k.json", "--box-model", "surface"], [image, "--boxes", boxes]):
        done = run("reconstruct", *given, "--together", "--calib", calib, "--json", tmp_path / "out.json")
        assert done.exit_code == 0, done.output
        found.append(json.loads((tmp_path / "out.json").read_text())["instances"])
    assert len(found[0]) == 3
    for by_file, by_image in zip(*found, strict=True):
        assert by_file["result"]["energies"]["direction"] < 0.5
        np.testing.assert_array_equal(by_file["location"], by_image["location"])
        assert by_file["rotation_y"] == by_image["rotation_y"]


def test_a_network_of_another_category_than_the_prior_is_refused(street, weights):
    prior = load_prior("car14")
    lorry = save_prior(replace(prior, category=replace(prior.category, name="lorry14")), street / "lorry.npz")
    image = street / "image_2" / "000001.png"
    done = run("reconstruct", image, "--box", "10,10,90,80", "--weights", weights, "--prior", lorry)
    assert isinstance(done.exception, InvalidInputError)
    assert re.search("got car14.*lorry14", str(done.exception))


def test_an_image_is_reconstructed_with_a_warning_about_the_camera(street, weights):
    image = street / "image_2" / "000001.png"
    beside = run("reconstruct", image, "--box", "10,10,90,80", "--weights", weights, "--json", "-")
    assert "focal length is" not in beside.stderr, "KITTI's calib beside image_2 has the camera"
    (street / "calib").rename(street / "calibrations")
    done = run("reconstruct", image, "--box", "10,10,90,80", "--weights", weights, "--json", "-")
    (street / "calibrations").rename(street / "calib")
    assert done.exit_code == 0, done.output
    assert "focal length is" in done.stderr
    (entry,) = json.loads(done.stdout)["instances"]
    assert entry["camera"]["image_size"] == [160, 100]
    assert 0.0 < entry["camera"]["focal_sigma"] <= 0.5
    assert json.loads(done.stdout)["scenes"][0]["focal_lengths"][0]["excess"] == 0.0
    with_camera = run(
        *("reconstruct", image, "--boxes", street / "label_2" / "000001.txt", "--weights", weights),
        *("--calib", street / "calib" / "000001.txt", "--json", "-", "--picture", street / "p.png"),
    )
    assert with_camera.exit_code == 0, with_camera.output
    assert "focal length" not in with_camera.stderr
    assert [entry["id"] for entry in json.loads(with_camera.stdout)["instances"]] == ["1"]
    assert (street / "p.png").exists()


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["--box", "10,10,14,14"], "box 0"),
        (["--box", "500,10,600,90"], "box 0"),
        (["--box", "10,10,90"], "box"),
        ([], "detect"),
    ],
)
def test_boxes_that_cannot_be_used(street, weights, arguments, field):
    done = run("reconstruct", street / "image_2" / "000001.png", "--weights", weights, *arguments)
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == field


def test_files_that_are_no_images(street, weights):
    (street / "no.png").write_bytes(b"text")
    done = run("reconstruct", street / "no.png", "--box", "1,2,30,40", "--weights", weights)
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "image"


def test_boxes_mean_nothing_for_a_keypoint_file(street):
    (file := street / "k.json").write_text("[]")
    done = run("reconstruct", file, "--box", "1,2,30,40")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "box"


def kitti(street, weights, *more):
    folders = ("--images", street / "image_2", "--labels", street / "label_2", "--calib", street / "calib")
    return run("evaluate", "kitti", *folders, "--weights", weights, *more)


def test_kitti_is_scored_by_regime(street, weights):
    outputs = ("--json", street / "r.json", "--picture", street / "sheet.png", "--save", street / "cars.rrd")
    outputs += ("--results", street / "results", "--markdown", street / "r.md")
    done = kitti(street, weights, *outputs)
    assert done.exit_code == 0, done.output
    assert "Moderate" in done.stdout
    document = json.loads((street / "r.json").read_text())
    assert [(regime["name"], regime["cars"]) for regime in document["regimes"]] == [
        ("Easy", 1),
        ("Moderate", 1),
        ("Hard", 1),
    ]
    (car,) = document["cars"]
    assert (car["frame"], car["index"]) == ("000001", 1)
    assert (document["given"]["boxes"], document["given"]["box_model"]) == ("labels", "cuboid")
    assert (street / "sheet.png").exists()
    errors = replay.read(street / "cars-000001-1.rrd").scalars["error/orientation_deg"]
    assert errors.values[-1, 0] == pytest.approx(car["degrees"])
    boxes = document["boxes"]
    (vehicle,) = boxes["vehicles"]
    assert (vehicle["degrees"], vehicle["metres"]) == pytest.approx((car["degrees"], car["metres"]))
    assert list(boxes["groups"]) == ["Easy", "Moderate", "Hard", "Hard 15-30 m"]
    assert boxes["groups"]["Easy"]["mean_metres"]["value"] == pytest.approx(car["metres"])
    assert [one["volume"] for one in boxes["average_precision_40"]] == [[None, None]] * 3
    assert (street / "r.md").read_text().count("| labelled boxes |") == 11
    (street / "label_2" / "000001.txt").write_text(f"Car {LABEL}\n")  # the van's box is the same
    done = run("evaluate", "boxes", street, street / "results", "--json", "-")  # what was written is what was scored
    (again,) = json.loads(done.stdout)["sources"][0]["vehicles"]
    assert (again["degrees"], again["metres"]) == pytest.approx((vehicle["degrees"], vehicle["metres"]), abs=0.01)


def test_results_do_not_go_over_labels(street, weights):
    for name in ("label_2", "calib"):
        refused = kitti(street, weights, "--results", street / name).exception
        assert (refused.field, refused.value) == ("results", str(street / name / "000001.txt"))
    assert kitti(street, weights, "--results", street / "image_2" / "000001.png").exception.field == "results"


def test_a_car_without_a_detection_counts_as_wrong(street, weights):
    (street / "d.txt").write_text("x/000001.png 2 0.9 120 20 150 60 detected\n")
    done = kitti(street, weights, "--boxes", street / "d.txt", "--json", street / "r.json")
    assert done.exit_code == 1, done.output
    document = json.loads((street / "r.json").read_text())
    assert document["given"]["box_model"] == "detected"  # as the file's line says
    assert document["regimes"][0]["mean_degrees"] == 180.0
    assert document["regimes"][0]["median_metres"] is None
    assert document["cars"][0]["failure"] == "no detection"
    assert document["boxes"]["groups"]["Hard"]["found"] == 0


def test_kitti_without_images_is_refused(street, weights):
    for name, field in (("label_2", "images"), ("absent", "images")):
        done = run(
            *("evaluate", "kitti", "--images", street / name, "--labels", street / "label_2"),
            *("--calib", street / "calib", "--weights", weights),
        )
        assert isinstance(done.exception, InvalidInputError)
        assert done.exception.field == field


def test_kitti_takes_the_frames_of_a_split(street, weights):
    (split := street / "val.txt").write_text("000001\n000009\n")
    done = kitti(street, weights, "--split", split, "--verbose", "--json", street / "r.json")
    assert [car["frame"] for car in json.loads((street / "r.json").read_text())["cars"]] == ["000001"]
    assert "000009: no image" in " ".join(done.output.split())
    split.write_text("000009\n")
    assert kitti(street, weights, "--split", split).exception.field == "images"


def test_kitti_without_data_says_how_to_give_them(street, monkeypatch):
    monkeypatch.setenv("FGRECON_DATA", str(street / "none"))
    for more in ((), ("--images", street / "image_2")):
        refused = run("evaluate", "kitti", *more).exception
        assert (refused.field, refused.value) == ("data", str(street / "none"))
        assert "--data" in refused.fix
        assert "FGRECON_DATA" in refused.fix


def test_kitti_with_detected_boxes_from_an_overlap_on(street, weights):
    boxes = street / "boxes.txt"
    boxes.write_text("000001.png 2 0.9 20 20 110 60\n")  # two thirds of the labelled box
    for overlap, failure in (("0.7", "no detection"), ("0.6", None)):
        out = street / f"{overlap}.json"
        kitti(street, weights, "--boxes", boxes, "--overlap", overlap, "--json", out)
        assert [car["failure"] for car in json.loads(out.read_text())["cars"]] == [failure]


def test_kitti_is_looked_for_in_the_data_folder(street, weights, monkeypatch):
    training = street / "data" / "kitti_object" / "training"
    training.mkdir(parents=True)
    for name in ("image_2", "label_2", "calib"):
        (street / name).rename(training / name)
    monkeypatch.setenv("FGRECON_DATA", str(street / "data"))
    done = run("evaluate", "kitti", "--weights", weights, "--verbose")
    assert done.exit_code == 0, done.output
    assert "000001/1: " in done.stdout
    moved = (training / "label_2").rename(street / "labels")
    assert run("evaluate", "kitti", "--weights", weights, "--labels", moved, "-q").output == ""
