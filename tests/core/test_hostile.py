"""Values, ids and files that nobody means well with: a typed error, or harmless."""

import json
import os
import time

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import fgrecon
from factors.checks import unit_vector
from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.size_prior import size_prior
from fgrecon.core.text import printable
from fgrecon.io.arrays import LARGEST
from fgrecon.io.cameras import read_camera
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.export.results import read_results
from fgrecon.io.files import write_text
from fgrecon.io.images import read_image
from fgrecon.io.json_fields import read_json
from tests.cars import CAMERA, observe, yaw_pose


@pytest.mark.parametrize(
    "make",
    [
        lambda: fgrecon.Camera(CAMERA.matrix, image_size=(-1, 3)),
        lambda: fgrecon.Camera(CAMERA.matrix, image_size=(640.5, 3)),
        lambda: fgrecon.Camera(CAMERA.matrix, image_size=("x", 3)),
        lambda: fgrecon.Ground.level(1e154),
        lambda: fgrecon.Ground(np.array([0.0, 1.0, 0.0]), 1.6, height_sigma=1e-200),
        lambda: fgrecon.Ground(np.array([0.0, 1.0, 0.0]), "high"),
    ],
)
def test_absurd_cameras_and_grounds_are_refused(make):
    with pytest.raises(InvalidInputError, match=r"image_size|ground"):
        make()


@pytest.mark.parametrize(
    "change",
    [
        lambda prior: {"basis": prior.basis * 1e155},
        lambda prior: {"basis": prior.basis * 1e30},
        lambda prior: {"mean": prior.mean + 1j},
        lambda prior: {"mean": prior.mean.astype("S")},
    ],
    ids=["1e155", "1e30", "complex", "bytes"],
)
def test_absurd_priors_are_refused(change):
    prior = load_prior("car14")
    fields = {name: getattr(prior, name) for name in ("category", "mean", "basis", "offset_sigma", "explained")}
    with pytest.raises(InvalidInputError, match=r"prior\.(mean|basis)"):
        fgrecon.ShapePrior(**(fields | change(prior)))


@pytest.fixture
def keypoints(tmp_path):
    """A function that writes a keypoint file of cars of some ids."""
    seen = observe(load_prior("car14"), yaw_pose(0.5))

    def write(*ids, start=""):
        points = [None if np.isnan(point).any() else point.tolist() for point in seen.keypoints]
        instances = [{"id": i, "keypoints": points, "confidence": seen.confidence.tolist()} for i in ids]
        path = tmp_path / "keypoints.json"
        content = {"intrinsics": [721.5, 718.9, 609.6, 172.9], "instances": instances}
        path.write_text(start + json.dumps(content), encoding="utf-8")
        return path

    return write


def run(*arguments):
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, (done.output, done.exception)
    return done


def test_ids_of_any_kind_do_no_harm(keypoints, tmp_path):
    """Half a formula, half a pair of surrogates, a spreadsheet's formula, a terminal's command."""
    names = ["car $\\frac{x$ 1", "\ud800", "=HYPERLINK(1)", "\x1b[31mred\x07"]
    picture, results, table = (tmp_path / name for name in ("p.png", "r.json", "r.csv"))
    done = run("reconstruct", keypoints(*names), "--picture", picture, "--json", results)
    assert "\x1b[31m" not in done.output
    assert "\\x1b[31mred\\x07" in done.output
    assert picture.stat().st_size > 1000
    ids = [item.name for item in read_results(results)]
    assert ids == [names[0], "\ufffd", *names[2:]]
    run("export", results, table)
    assert "'=HYPERLINK(1)" in table.read_text(encoding="utf-8")


def test_a_byte_order_mark_is_passed_over(keypoints, tmp_path):
    run("reconstruct", keypoints("a", start="\ufeff"))
    (tmp_path / "pair.json").write_text('{"\\ud83d\\ude97": "\\ud83d\\ude97 \\udc00"}')
    assert read_json(tmp_path / "pair.json") == {"\U0001f697": "\U0001f697 \ufffd"}


@pytest.mark.parametrize("digits", [400, 5000])
def test_numbers_that_no_float_holds_are_refused(keypoints, tmp_path, digits):
    run("reconstruct", keypoints("a"), "--json", tmp_path / "r.json")
    content = json.loads((tmp_path / "r.json").read_text())
    content["instances"][0]["result"]["box_size"] = "here"
    text = json.dumps(content).replace('"here"', f"[1{'0' * digits}, 1, 1]")
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InvalidInputError, match=r"r\.json"):
        read_results(tmp_path / "r.json")


def test_names_that_are_no_texts_are_refused(tmp_path):
    category = tmp_path / "c.json"
    category.write_text(json.dumps({"name": "x", "keypoints": ["a", ["b"], "c", "d"]}))
    with pytest.raises(InvalidInputError, match="keypoints"):
        load_category(category)


def test_pictures_that_claim_to_be_huge_are_not_decoded(tmp_path, monkeypatch):
    path = tmp_path / "flat.png"
    Image.new("RGB", (2000, 1500)).save(path)
    assert read_image(path).shape == (1500, 2000, 3)
    monkeypatch.setenv(LARGEST, "1000000")
    with pytest.raises(InvalidInputError, match=LARGEST):
        read_image(path)


def test_what_killed_writers_left_is_cleared_away(tmp_path):
    old, fresh, others = (tmp_path / name for name in (".out.txt.abc.part", ".out.txt.def.part", ".else.txt.abc.part"))
    for part in (old, fresh, others):
        part.write_text("half")
    hours_ago = time.time() - 2 * 3600
    os.utime(old, (hours_ago, hours_ago))
    os.utime(others, (hours_ago, hours_ago))
    write_text(tmp_path / "out.txt", "whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [others.name, fresh.name, "out.txt"]


def test_lines_for_the_terminal_end(capsys):
    assert printable("x" * 100_000).count("x") < 4000
    assert printable("a\x07\n") == "a\\x07\n"
    assert printable("Straße 車") == "Straße 車"


@pytest.mark.parametrize("last", ["image_width: *h", "camera_matrix: {data: *h}", "camera_matrix: [[*h]]"])
def test_aliases_of_aliases_are_not_followed(last, tmp_path):
    """Ten lines of YAML that stand for a hundred million texts."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    for name, before in zip("bcdefgh", "abcdefg", strict=True):
        lines.append(f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]")
    path = tmp_path / "camera.yaml"
    path.write_text("\n".join([*lines, last, ""]))
    with pytest.raises(InvalidInputError, match="more than 100000 values"):
        read_camera(path)


@pytest.mark.parametrize("normal", [[0.0, 1e300, 0.0], [1e300, 1e308, -1e300], [0.0, 1e150, 0.0]])
def test_normals_of_enormous_length_are_normals(normal):
    """Warnings are errors here: the squares of their numbers are beyond floats."""
    unit = fgrecon.Ground(np.array(normal), 1.65).normal
    assert np.linalg.norm(unit) == pytest.approx(1.0)
    np.testing.assert_allclose(unit, np.array(normal) / max(normal), atol=1e-7)
    np.testing.assert_array_equal(unit, unit_vector("normal", normal))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: fgrecon.Ground(np.array([1e300, 1e-300, 0.0]), 1.65), "ground.normal"),
        (lambda: fgrecon.Box3D(np.array([0.0, 1.6, 1e300]), 0.0), "box3d.location"),
        (lambda: fgrecon.Box3D(np.array([0.0, 1.6, 20.0]), 0.0, np.full(3, 1e300)), "box3d.size"),
        (lambda: fgrecon.Box3D(np.array([0.0, 1.6, 20.0]), None), "box3d.rotation_y"),
        (lambda: fgrecon.Box3D(np.array([0.0, 1.6, 20.0]), []), "box3d.rotation_y"),
        (lambda: size_prior("389,162,153"), "size_prior.mean"),
        (lambda: size_prior("0.01,0.01,0.01"), "size_prior.mean"),
        (lambda: size_prior("1e-300,1,1"), "size_prior.mean"),
    ],
)
def test_absurd_boxes_and_sizes_are_refused(make, field):
    with pytest.raises(InvalidInputError, match=r"metres|radians|down") as error:
        make()
    assert error.value.field == field


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
@pytest.mark.parametrize("size", [0.3, 30.0])
def test_a_vehicle_at_the_limits_is_taken_and_no_result_lies_beyond(size):
    seen = observe(load_prior("car14"), yaw_pose(0.5))
    for spread in ("", f",{0.3 * size},{0.3 * size},{0.3 * size}"):
        result = fgrecon.reconstruct(seen, CAMERA, size_prior=f"{size},{size},{size}{spread}")
        inside = result.box_size.min() > 0.3 and result.box_size.max() < 30.0
        assert inside or not result.status.determined


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_a_3d_box_that_is_no_vehicles_is_refused_alone():
    prior = load_prior("car14")
    seen = [observe(prior, yaw_pose(0.5)), observe(prior, yaw_pose(0.6))]
    boxes = [
        fgrecon.Box3D(np.array([0.0, 1.6, 15.0]), 0.5, np.array(size)) for size in ([4, 1.6, 1.5], [389, 162, 153])
    ]
    scene = fgrecon.reconstruct_scene(seen, CAMERA, boxes=boxes)
    assert len(scene.vehicles) == 1
    assert "Give metres" in str(scene.refused[1])


@pytest.mark.parametrize("sigma", [1e-300, 1e-6, 5e-6])
def test_a_size_that_is_known_exactly_is_taken_to_a_tenth_of_a_millimetre(sigma):
    seen = observe(load_prior("car14"), yaw_pose(0.5))
    given = [f"4,1.6,1.5,{one},{one},{one}" for one in (sigma, 1e-4)]
    exact, known = (fgrecon.reconstruct(seen, CAMERA, size_prior=text) for text in given)
    assert known.status.determined
    np.testing.assert_array_equal(exact.wireframe, known.wireframe)
    np.testing.assert_allclose(exact.box_size, [4.0, 1.6, 1.5], atol=0.02)


@pytest.mark.parametrize(
    "change",
    [
        {"sigma": np.full(3, 1e300)},
        {"allowed": np.full(3, 1e300)},
        {"traffic": 1e300 * np.eye(3)},
    ],
)
def test_spreads_that_are_no_lengths_are_refused(change):
    with pytest.raises(InvalidInputError, match=f"size_prior.{next(iter(change))}"):
        fgrecon.SizePrior(**({"name": "mine", "mean": [4.0, 1.6, 1.5], "sigma": np.full(3, 0.1)} | change))
