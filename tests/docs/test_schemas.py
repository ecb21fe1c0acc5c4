"""The JSON schemas of docs/schemas hold for what the commands read and write, and for the examples of the pages."""

import json
import runpy

import pytest
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.coco_keypoints import read_coco_keypoints, write_coco_keypoints
from fgrecon.io.export import read_results
from fgrecon.io.keypoint_file import parse_keypoints
from fgrecon.io.track_file import parse_track
from tests.cars import CAMERA
from tests.conftest import REPOSITORY
from tests.docs.pages import blocks
from tests.io.test_coco_keypoints import make_labels
from tests.solve.test_scene import street

SCHEMAS = {path.name.partition(".")[0]: path for path in (REPOSITORY / "docs/schemas").glob("*.json")}
EXAMPLE = blocks((REPOSITORY / "docs/reference/formats.md").read_text(encoding="utf-8"), "json")[0]


def check(schema, content):
    Draft202012Validator(json.loads(SCHEMAS[schema].read_text(encoding="utf-8"))).validate(content)


def run(*arguments):
    done = CliRunner().invoke(main.app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done


@pytest.fixture
def example(tmp_path):
    (file := tmp_path / "cars.json").write_text(EXAMPLE, encoding="utf-8")
    return file


@pytest.mark.parametrize("path", SCHEMAS.values(), ids=lambda path: path.name)
def test_it_is_a_schema(path):
    Draft202012Validator.check_schema(json.loads(path.read_text(encoding="utf-8")))


def test_the_tables_of_fields_are_what_the_script_makes():
    made = runpy.run_path(str(REPOSITORY / "docs/fields.py"))
    for name in made["TABLES"]:
        page = REPOSITORY / f"docs/reference/fields/{name}.md"
        assert page.read_text(encoding="utf-8") == made["table"](name), "run `python docs/fields.py`"
    page = REPOSITORY / "docs/reference/fields/exports.md"
    assert page.read_text(encoding="utf-8") == made["exports"](), "run `python docs/fields.py`"


def test_the_example_of_the_page(example):
    check("keypoints", json.loads(EXAMPLE))


def test_what_the_demo_writes(tmp_path):
    run("demo", "--out", tmp_path / "demo")
    check("keypoints", json.loads((tmp_path / "demo/keypoints.json").read_text(encoding="utf-8")))


def test_results_of_reconstruct_refused_ones_included(example, tmp_path):
    content = json.loads(EXAMPLE)
    content["instances"].append({"id": "hidden", "keypoints": {"left_headlight": [460.0, 230.0]}})
    example.write_text(json.dumps(content), encoding="utf-8")
    run("reconstruct", example, "--size-prior", "kitti", "--camera-height", 1.65, "--json", tmp_path / "out.json")
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert [entry["error"] is None for entry in written["instances"]] == [True, False]
    check("results", written)
    run("reconstruct", example, "--history", "--json", tmp_path / "whole.json")
    whole = json.loads((tmp_path / "whole.json").read_text(encoding="utf-8"))
    assert whole["instances"][0]["result"]["history"]
    check("results", whole)


def test_the_steps_of_vehicles_that_were_solved_together(tmp_path):
    cars = [{"keypoints": one.keypoints.tolist(), "box": one.box.tolist()} for one in street(5, count=2)[1]]
    content = {"K": CAMERA.matrix.tolist(), "instances": [{"id": str(i), **car} for i, car in enumerate(cars)]}
    (tmp_path / "cars.json").write_text(json.dumps(content), encoding="utf-8")
    run(
        "reconstruct",
        tmp_path / "cars.json",
        "--camera-height",
        1.65,
        "--together",
        "--history",
        "--json",
        tmp_path / "out.json",
    )
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    stages = {step["stage"] for entry in written["instances"] for step in entry["result"]["history"]}
    assert "scene" in stages
    check("results", written)


def test_results_of_the_first_release_have_a_schema_of_their_own(example, tmp_path):
    run("reconstruct", example, "--json", tmp_path / "out.json")
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    (found,) = read_results(tmp_path / "out.json")
    written["instances"][0]["result"] = found.result.to_dict()
    check("results-1", written | {"format": "fgrecon.reconstructions/1"})
    with pytest.raises(ValidationError):
        check("results-1", written)
    with pytest.raises(ValidationError):
        check("results", written | {"format": "fgrecon.reconstructions/1"})


def test_tracks_and_their_results(content, tmp_path):
    check("track", content)
    (file := tmp_path / "made-up.json").write_text(json.dumps(content), encoding="utf-8")
    run("track", file, "--size-prior", "kitti", "--json", tmp_path / "out.json")
    written = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert len(written["instances"]) == 3
    check("results", written)


@pytest.mark.parametrize(
    "change",
    [
        {"keypoints": 3},
        {"box": [1, 2, 3]},
        {"intrinsics": [1, 2]},
        {"initial": {"location": [1, 2, 3]}},
        {"confidence": {"left_headlight": "sure"}},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_reader_and_the_schema_refuse_the_same(change):
    instance = json.loads(EXAMPLE)["instances"][0] | change
    with pytest.raises(InvalidInputError):
        parse_keypoints(instance, load_category("car14"))
    with pytest.raises(ValidationError):
        check("keypoints", instance)


@pytest.mark.parametrize("field", ["K", "P2", "keypoint_names", "frames"])
def test_a_track_without_a_field_is_refused_by_both(content, field):
    del content[field]
    with pytest.raises(InvalidInputError):
        parse_track(content, "made-up", load_category("car14"))
    with pytest.raises(ValidationError):
        check("track", content)


@pytest.mark.parametrize("meshes", [False, True])
def test_keypoint_labels(tmp_path, meshes):
    file = write_coco_keypoints(tmp_path / "labels.json", make_labels(tmp_path), meshes=meshes)
    check("keypoint_labels", json.loads(file.read_text(encoding="utf-8")))


@pytest.mark.parametrize("field", ["bbox", "keypoints", "keypoint_covariance", "track_id", "cuboid", "agreement"])
def test_labels_without_a_field_are_refused_by_both(tmp_path, field):
    file = write_coco_keypoints(tmp_path / "labels.json", make_labels(tmp_path))
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["annotations"][1][field]
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InvalidInputError):
        read_coco_keypoints(file)
    with pytest.raises(ValidationError):
        check("keypoint_labels", content)
