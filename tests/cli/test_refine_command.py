"""`fgrecon refine`, `fgrecon evaluate refine`: the sample's street with the shipped networks, and what is refused."""

import json
import shutil

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.box_lines import read_box_lines
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.sample import LABEL_OFFSET, sample_street
from tests.command_line import run

pytest.importorskip("torch")

CARE = "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10"


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refine") / "sample"
    assert run("sample", "--out", folder, "-q").exit_code == 0
    return folder


def size_of(prior, car):
    return np.tensordot(prior.category.dimension_operator, car.truth.vehicle.keypoints, axes=2)


def true_labels():
    """Label lines of the sample's cars, in the frame of its labels."""
    prior = load_prior("car14")
    lines = []
    for car in sample_street(prior, 0).cars:
        pose, (length, width, height) = car.truth.camera_T_object, size_of(prior, car)
        x, y, z = pose[:3, 3] - LABEL_OFFSET
        box = " ".join(f"{pixel:.2f}" for pixel in car.observation.box)
        lines.append(f"Car 0.00 0 0 {box} {height} {width} {length} {x} {y} {z} {rotation_y(pose)}")
    return lines


def test_the_samples_boxes_are_refined(sample, tmp_path):
    out, report = tmp_path / "refined.txt", tmp_path / "refined.json"
    boxes = tmp_path / "boxes.txt"
    boxes.write_text((sample / "detections.txt").read_text() + CARE + "\n")
    done = run("refine", boxes, sample / "street.png", "--calib", sample / "calib.txt", "--out", out, "--json", report)
    assert done.exit_code == 0, done.output
    assert "3 of 3 boxes in 1 image were refined" in done.stdout
    before, after = read_box_lines(boxes), read_box_lines(out)
    assert after[3].text == CARE
    assert [line.kind for line in after] == [line.kind for line in before]
    for old, new in zip(before[:3], after[:3], strict=True):
        assert (new.score, new.corners.tolist()) == (old.score, old.corners.tolist())
        assert not np.array_equal(new.location, old.location)
    content = json.loads(report.read_text())
    assert content["format"] == "fgrecon.refined-boxes/1"
    assert content["settings"]["box_errors"]["depth"] == 0.06
    (image,) = content["images"]
    assert [box["line"] for box in image["boxes"]] == [1, 2, 3]
    for box, line in zip(image["boxes"], after, strict=False):
        assert box["box"]["location"] == pytest.approx((line.location + image["label_offset"]).tolist(), abs=1e-3)
        assert 0.0 < box["sigma"]["location"][2] < 1.5
        assert np.isfinite(box["facing_probability"])


def test_folders_and_tracking_lines(sample, tmp_path):
    boxes, images = tmp_path / "boxes", tmp_path / "image_2"
    calib = tmp_path / "calib"
    for folder in (boxes, images, calib):
        folder.mkdir()
    for name in ("000004", "000007"):
        shutil.copy(sample / "detections.txt", boxes / f"{name}.txt")
    shutil.copy(sample / "street.png", images / "000004.png")
    shutil.copy(sample / "calib.txt", calib / "000004.txt")
    # KITTI's layout tells the camera; the second image is missing.
    done = run("refine", boxes, images, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "000007: the boxes stay as they are" in done.stderr
    assert (tmp_path / "out" / "000007.txt").read_text() == (boxes / "000007.txt").read_text()
    again = run("refine", boxes, images, "--out", tmp_path / "again", "--calib", calib, "-q")
    assert again.output.count("\n") == 0
    assert (tmp_path / "again" / "000004.txt").read_text() == (tmp_path / "out" / "000004.txt").read_text()
    tracks = tmp_path / "tracks.txt"
    lines = (sample / "detections.txt").read_text().splitlines()
    tracks.write_text("".join(f"4 {number} {line}\n" for number, line in enumerate(lines)))
    assert run("refine", tracks, images, "--out", tmp_path / "tracks-out.txt").exit_code == 0
    refined = (tmp_path / "tracks-out.txt").read_text().splitlines()
    single = (tmp_path / "out" / "000004.txt").read_text().splitlines()
    assert [line.split()[2:] for line in refined] == [line.split() for line in single]


def raised(text):
    """Lines of boxes with the heights of their centres."""
    lines = []
    for line in text.splitlines():
        cells = line.split()
        cells[12] = f"{float(cells[12]) - float(cells[8]) / 2.0:.4f}"
        lines.append(" ".join(cells))
    return "\n".join(lines) + "\n"


def test_boxes_by_their_centres_are_asked_about(sample, tmp_path):
    bottoms = (sample / "detections.txt").read_text()
    boxes, images = tmp_path / "boxes", tmp_path / "images"
    boxes.mkdir()
    images.mkdir()
    lines = raised(bottoms).splitlines(keepends=True)
    for number, line in enumerate(lines):  # none says enough by itself where it is far away
        (boxes / f"{number}.txt").write_text(line)
        shutil.copy(sample / "street.png", images / f"{number}.png")
    how = "--calib", sample / "calib.txt", "--camera-height", 1.65
    done = run("refine", boxes, images, *how, "--out", tmp_path / "kept")
    assert done.exit_code == 1, done.output
    assert done.stderr.count("Boxes stand about half their height above the given ground") == 1
    assert "--box-origin centre" in done.stderr
    assert [(tmp_path / "kept" / f"{number}.txt").read_text() for number in range(len(lines))] == lines


def test_boxes_by_their_centres_are_refined_as_those_by_bottoms(sample, tmp_path):
    bottoms = (sample / "detections.txt").read_text()
    centres = tmp_path / "centres.txt"
    centres.write_text(raised(bottoms))
    how = sample / "street.png", "--calib", sample / "calib.txt", "--camera-height", 1.65
    done = run("refine", centres, *how, "--box-origin", "centre", "--out", tmp_path / "centres-out.txt")
    assert done.exit_code == 0, done.output
    assert "half their height" not in done.stderr
    assert run("refine", sample / "detections.txt", *how, "--out", tmp_path / "bottoms-out.txt").exit_code == 0
    for one, other in zip(
        read_box_lines(tmp_path / "centres-out.txt"), read_box_lines(tmp_path / "bottoms-out.txt"), strict=True
    ):
        size = other.box(np.zeros(3)).size
        assert one.location == pytest.approx(other.location - [0.0, size[2] / 2.0, 0.0], abs=0.011)


def test_a_camera_of_another_size_is_warned_of(sample, tmp_path):
    out = tmp_path / "out.txt"
    given = sample / "detections.txt", sample / "street.png", "--intrinsics", "360,360,305,86.5", "--out", out
    assert "middle of an image of another size" in run("refine", *given).stderr


def test_low_scores_stay_and_none_is_a_failure(sample, tmp_path):
    out = tmp_path / "out.txt"
    given = sample / "detections.txt", sample / "street.png", "--calib", sample / "calib.txt", "--out", out
    done = run("refine", *given, "--min-score", 0.95)
    assert done.exit_code == 1
    assert "No box could be refined" in done.stderr
    assert out.read_text() == (sample / "detections.txt").read_text()


def test_what_cannot_be_used_is_refused(sample, tmp_path):
    boxes, image, calib = (sample / name for name in ("detections.txt", "street.png", "calib.txt"))
    folder = tmp_path / "boxes"
    folder.mkdir()
    shutil.copy(boxes, folder / "street.txt")
    for arguments, field in (
        ((boxes, image, "--calib", calib, "--out", boxes), "out"),
        ((folder, image, "--calib", calib, "--out", boxes), "out"),
        ((boxes, sample, "--calib", calib, "--out", tmp_path / "o.txt"), "images"),
        ((boxes, image, "--calib", calib, "--out", tmp_path / "o.txt", "--depth-error", 0), "box_errors.depth"),
        ((boxes, image, "--calib", calib, "--out", tmp_path / "o.txt", "--yaw-error", 200), "box_errors.yaw"),
        ((tmp_path / "none.txt", image, "--calib", calib, "--out", tmp_path / "o.txt"), "boxes"),
    ):
        done = run("refine", *arguments)
        assert isinstance(done.exception, InvalidInputError), (arguments, done.output)
        assert field in str(done.exception)
    without = run("refine", boxes, image, "--out", tmp_path / "o.txt")
    assert without.exception.field == "camera"
    assert "(--calib, --camera, --intrinsics)" in without.exception.fix
    assert isinstance(run("refine", folder, sample, "--out", tmp_path / "o").exception, InvalidInputError)
    assert not [*tmp_path.glob("o*.txt"), *tmp_path.glob("o/*")], "there is nothing to read"


def test_disturbed_labels_come_nearer(sample, tmp_path):
    """The sample's street as a folder of KITTI's object set, its cars' places as labels."""
    root = tmp_path / "object"
    for name, source, file in (
        ("image_2", "street.png", "000000.png"),
        ("calib", "calib.txt", "000000.txt"),
        ("label_2", "detections.txt", "000000.txt"),
    ):
        (root / name).mkdir(parents=True)
        shutil.copy(sample / source, root / name / file)
    (root / "label_2" / "000000.txt").write_text("\n".join(true_labels()) + "\n")
    done = run("evaluate", "refine", root, "--depth-error", 0.15, "--seed", 3, "--json", tmp_path / "e.json", "-v")
    assert done.exit_code == 0, done.output
    assert "object/000000/0 Car" in done.stdout
    content = json.loads((tmp_path / "e.json").read_text())
    assert content["format"] == "fgrecon.refinement/1"
    everything = content["groups"]["all"]
    assert (everything["vehicles"], everything["refined"]) == (3, 3)
    assert everything["mean_metres"][1] < everything["mean_metres"][0]
    assert len(content["vehicles"]) == 3
    boxes = run("evaluate", "refine", root, "--boxes", root / "label_2", "--json", "-")
    assert json.loads(boxes.stdout)["groups"]["all"]["mean_metres"][0] == pytest.approx(0.0, abs=1e-9)
    for name, ending in (("image_2", "png"), ("calib", "txt"), ("label_2", "txt")):
        shutil.copy(root / name / f"000000.{ending}", root / name / f"000001.{ending}")
    shutil.copytree(root / "label_2", tmp_path / "found")
    (tmp_path / "found" / "000001.txt").write_text("")  # where the detector found nothing there is nothing to refine
    some = run("evaluate", "refine", root, "--boxes", tmp_path / "found", "--json", "-")
    assert json.loads(some.stdout)["groups"]["all"]["vehicles"] == 3
    twice = run("evaluate", "refine", root, tmp_path / "object", "--boxes", root / "label_2")
    assert isinstance(twice.exception, InvalidInputError)
