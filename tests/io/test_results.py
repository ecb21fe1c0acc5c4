"""Results files: a few kilobytes for a car, read back as documented; files of the first release too."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.result_fields import FIELDS
from fgrecon.core.serialise import DECIMALS, SIGNIFICANT, plain, rounded, rounded_plain
from fgrecon.io.catalogue import load_prior, save_prior
from fgrecon.io.export import read_results
from tests.cli.conftest import K, car
from tests.core.test_reconstruction import assert_same, made_up
from tests.results import value_of
from tests.viz.made_up import make_example

KILOBYTES = 6.0
EXACT = ("history", "graph", "surface_vertices", "surface_faces")


def run(*arguments):
    done = CliRunner().invoke(main.app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output


@pytest.fixture
def cars(tmp_path):
    """A keypoint file of two cars."""
    seen = [car(yaw, (x, 1.65, 11.0)) | {"id": f"car {x}"} for x, yaw in ((-2, -2.2), (3, 0.4))]
    (file := tmp_path / "cars.json").write_text(json.dumps({"K": K.tolist(), "instances": seen}))
    return file


def through_json(result, **how):
    return Reconstruction.from_dict(json.loads(json.dumps(result.to_dict(**how), allow_nan=False)))


def test_the_compact_form_keeps_the_digits_that_it_promises():
    result = make_example().reconstruction
    back = through_json(result, compact=True)
    for name, digits in DECIMALS.items():
        if name != "milliseconds":
            near = 0.5000001 * 10.0**-digits
            np.testing.assert_allclose(value_of(back, name), value_of(result, name), rtol=0.0, atol=near, err_msg=name)
    for name, digits in SIGNIFICANT.items():
        if name.endswith("covariance"):
            np.testing.assert_allclose(value_of(back, name), value_of(result, name), rtol=0.5 * 10.0 ** (1 - digits))
    assert (
        back.diagnostics.history,
        back.diagnostics.graph,
        back.shape.surface_vertices,
        back.shape.surface_faces,
    ) == ((), (), None, None)
    rounded = [name for name in FIELDS if name not in (*DECIMALS, *SIGNIFICANT, *EXACT, "alternatives")]
    for name in rounded:
        assert_same(value_of(back, name), value_of(result, name))


@pytest.mark.parametrize("name", ["wireframe", "sigmas", "box_size", "keypoint_covariance", "status"])
@pytest.mark.parametrize("shape", [(), (4,), (0,), (2, 3), (2, 3, 3), (3, 0)])
def test_arrays_are_cut_as_their_numbers_are(name, shape):
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-12, 9, shape)
    for value in (numbers, np.where(numbers > 0.0, numbers, np.inf), numbers.astype(np.float32)):
        assert repr(rounded_plain(name, value)) == repr(rounded(name, plain(value)))


@pytest.mark.parametrize("coefficients", [0, 1, 5])
def test_odd_numbers_survive_the_compact_form_as_well(coefficients):
    result = made_up(np.random.default_rng(1), coefficients)
    back = through_json(result, compact=True, history=True)
    assert back.diagnostics.sigmas[0] == np.inf
    assert np.isnan(back.uncertainty.alternatives[0].excess)
    assert back.uncertainty.alternatives[0].coefficients.shape == (coefficients,)
    assert_same(back.diagnostics.history, result.diagnostics.history)
    assert_same(back.diagnostics.graph, result.diagnostics.graph)
    assert_same(through_json(back, compact=True, history=True), back)  # cut once, cut for good


def test_a_car_takes_a_few_kilobytes(cars, tmp_path):
    run("reconstruct", cars, "--size-prior", "kitti", "--json", tmp_path / "small.json")
    run("reconstruct", cars, "--size-prior", "kitti", "--json", tmp_path / "whole.json", "--history")
    text = (tmp_path / "small.json").read_text()
    assert len(text) / 2 < KILOBYTES * 1024
    written = json.loads(text)
    assert (written["format"], written["schema_version"]) == ("fgrecon.reconstructions/2", 2)
    small, whole = read_results(tmp_path / "small.json"), read_results(tmp_path / "whole.json")
    for quick, slow in zip(small, whole, strict=True):
        assert quick.result.diagnostics.history == ()
        assert quick.result.diagnostics.graph == ()
        assert len(slow.result.diagnostics.history) > 3
        assert slow.result.diagnostics.graph
        assert quick.result.camera_T_object.tobytes() == slow.result.camera_T_object.tobytes()


def test_tracks_keep_their_history_on_request(content, tmp_path):
    (file := tmp_path / "made-up.json").write_text(json.dumps(content), encoding="utf-8")
    run("track", file, "--size-prior", "kitti", "--json", tmp_path / "whole.json", "--history")
    run("track", file, "--size-prior", "kitti", "--json", tmp_path / "small.json")
    assert all(found.result.diagnostics.history for found in read_results(tmp_path / "whole.json"))
    small = read_results(tmp_path / "small.json")
    assert all(
        found.result.diagnostics.history == () and found.result.shape.surface_vertices is not None for found in small
    )
    assert (tmp_path / "small.json").stat().st_size < len(small) * KILOBYTES * 1024


@pytest.mark.parametrize("size", [None, "kitti", "4.5,1.8,1.5"], ids=["none", "a fleet", "one car"])
def test_surfaces_are_made_again_from_prior_size_and_coefficients(cars, tmp_path, size):
    import fgrecon

    options = [] if size is None else ["--size-prior", size]
    run("reconstruct", cars, *options, "--json", tmp_path / "r.json")
    seen = json.loads(cars.read_text())["instances"][1]
    pixels, confidence = np.array(seen["keypoints"]), np.array(seen["confidence"])
    solved = fgrecon.reconstruct(pixels, K, confidence=confidence, box=seen["box"], size_prior=size)
    found = read_results(tmp_path / "r.json")[1].result
    np.testing.assert_allclose(found.shape.surface_vertices, solved.shape.surface_vertices, atol=1e-7)
    assert np.array_equal(found.shape.surface_faces, solved.shape.surface_faces)
    np.testing.assert_allclose(found.camera_T_object, solved.camera_T_object, atol=1e-9)


def test_a_prior_of_ones_own_is_found_by_its_file_and_missed_without(cars, tmp_path):
    own = save_prior(replace(load_prior("car14").truncated(2), name="mine"), tmp_path / "mine.npz")
    run("reconstruct", cars, "--prior", own, "--json", tmp_path / "r.json")
    assert read_results(tmp_path / "r.json")[0].result.shape.surface_vertices is not None
    moved = own.rename(tmp_path / "moved.npz")
    found = read_results(tmp_path / "r.json")[0].result
    assert (found.shape.prior, found.shape.surface_vertices) == ("mine", None)
    assert read_results(tmp_path / "r.json", moved)[0].result.shape.surface_vertices is not None
    run("export", tmp_path / "r.json", tmp_path / "r.glb", "--prior", moved)
    other = load_prior("car14").scaled(1.1).truncated(2)
    assert read_results(tmp_path / "r.json", other)[0].result.shape.surface_vertices is None, (
        "not the prior of the file"
    )
    with pytest.raises(InvalidInputError, match="prior"):
        read_results(tmp_path / "r.json", tmp_path / "none.npz")


def test_files_of_the_first_release_read_as_they_did(tmp_path):
    result = make_example().reconstruction
    entry = {"id": "a", "box": None, "error": None, "result": result.to_dict()}
    refused = {"id": "b", "box": None, "error": {"type": "X", "message": "no"}, "result": None}
    settings = {"prior": "car14", "ground": None, "size_prior": None, "strategy": "mixture", "box_model": "surface"}
    old = {"format": "fgrecon.reconstructions/1", "fgrecon": "0.1.0", "file": "x.json", "settings": settings}
    (file := tmp_path / "old.json").write_text(json.dumps(old | {"instances": [entry, refused]}))
    (found,) = read_results(file)
    assert_same(found.result, result)


def test_a_folder_of_results_is_read_as_its_files_are(cars, tmp_path):
    (tmp_path / "out").mkdir()
    for name in ("a", "b"):
        run("reconstruct", cars, "--json", tmp_path / "out" / f"{name}.json")
    alone = read_results(tmp_path / "out" / "a.json")
    both = read_results(tmp_path / "out")
    assert [one.name for one in both] == 2 * [one.name for one in alone]
    run("export", tmp_path / "out", tmp_path / "table.csv")
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 1 + len(both)
