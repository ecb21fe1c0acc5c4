"""`fgrecon reconstruct --models`: the closest model in the table, the JSON, the picture and the recording."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.viz import entities, replay
from tests.cli.conftest import INTRINSICS, car
from tests.command_line import run
from tests.docs.test_schemas import check
from tests.viz.test_recording import chunks


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Three models, of which `mean` is the very car that the keypoint file is of."""
    folder, prior = tmp_path_factory.mktemp("models"), load_prior("car14")
    for name, first in (("small", 2.0), ("mean", 0.0), ("large", -2.0)):
        coefficients = np.zeros(prior.dimension)
        coefficients[0] = first
        vertices = prior.surface.vertices(coefficients)
        trimesh.Trimesh(vertices, prior.surface.faces, process=False).export(folder / f"{name}.ply")
    return folder


def test_the_closest_model_is_printed_drawn_and_recorded(models, write, tmp_path):
    cars = write({"instances": [car() | {"id": "one"}, car(yaw=1.0) | {"id": "two"}]})
    out, picture, recording = tmp_path / "out.json", tmp_path / "cars.png", tmp_path / "cars.rrd"
    options = ("--models", models, "--json", out, "--picture", picture, "--save", recording)
    done = run("reconstruct", cars, INTRINSICS, "--no-free-offsets", *options)
    assert done.exit_code == 0, done.output
    assert "one: closest model mean" in done.stdout
    content = json.loads(out.read_text())
    check("results", content)
    for entry in content["instances"]:
        found = entry["closest_model"]
        assert (found["name"], found["between"], found["models"]) == ("mean", "surfaces", 3)
        assert 0.0 <= found["hausdorff"] < 0.1 < found["margin"] + found["hausdorff"]
    assert picture.stat().st_size > 10_000
    assert entities.of_vehicle(entities.MODEL, "one") in chunks(recording)
    assert set(replay.read(recording).vehicles) == {"one", "two"}


def test_without_models_nothing_is_said_of_them(write, tmp_path):
    out = tmp_path / "out.json"
    done = run("reconstruct", write(car()), INTRINSICS, "--json", out)
    assert done.exit_code == 0, done.output
    assert "closest_model" not in json.loads(out.read_text())["instances"][0]


@pytest.mark.parametrize(
    ("options", "field"),
    [(("--models", "nowhere"), "nowhere"), (("--models-axes", "x,z"), "models_axes")],
    ids=["missing", "axes alone"],
)
def test_what_cannot_be_used_is_refused_before_the_work(write, options, field):
    done = run("reconstruct", write(car()), INTRINSICS, *options)
    assert isinstance(done.exception, InvalidInputError)
    assert field in str(done.exception)
