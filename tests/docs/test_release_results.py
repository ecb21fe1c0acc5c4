"""Files of our estimates for a release: complete, checked by their sums, and without anything of the data sets."""

import hashlib
import json
import runpy

import numpy as np
import pytest
from typer.testing import CliRunner

import fgrecon
from fgrecon.cli import main
from fgrecon.io.export import read_results
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import parse_keypoints
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The files of the sample."""
    out = tmp_path_factory.mktemp("release")
    runpy.run_path(str(REPOSITORY / "docs/results.py"))["make"](out, out / "no data", ["sample"])
    return out


def test_the_sums_are_those_of_all_files(made):
    listed = dict(reversed(line.split("  ")) for line in (made / "SHA256SUMS").read_text().splitlines())
    assert set(listed) == {"manifest.json", "sample/street.csv", "sample/street.json"}
    for name, digest in listed.items():
        assert hashlib.sha256((made / name).read_bytes()).hexdigest() == digest


def test_the_manifest_says_by_what_they_were_made(made):
    content = json.loads((made / "manifest.json").read_text())
    assert {"fgrecon", "commit", "packages", "machine"} <= set(content)
    assert set(content["data_sets"]) == {"sample"}
    assert content["data_sets"]["sample"]["options"] == ["--size-prior", "kitti", "--camera-height", "1.65"]


def test_the_estimates_are_those_of_the_options_without_boxes_or_paths(made, tmp_path):
    text = (made / "sample/street.json").read_text()
    document = json.loads(text)
    assert [vehicle["box"] for vehicle in document["instances"]] == [None, None, None]
    assert document["file"] == "street"
    assert not any(str(folder) in text for folder in (made, REPOSITORY, tmp_path.parent))
    assert CliRunner().invoke(main.app, ["sample", "--out", str(tmp_path / "sample")]).exit_code == 0
    given = parse_keypoints(read_json(tmp_path / "sample/cars.json"), fgrecon.load_category("car14")).instances
    for vehicle, car in zip(read_results(made / "sample/street.json"), given, strict=True):
        alone = fgrecon.reconstruct(car.observation, car.camera, ground=1.65, size_prior="kitti")
        np.testing.assert_allclose(vehicle.result.camera_T_object, alone.camera_T_object, atol=1e-6)


def test_the_table_has_the_same_poses(made):
    heads, *rows = (line.split(",") for line in (made / "sample/street.csv").read_text().splitlines())
    assert all(row[heads.index(name)] == "" for row in rows for name in ("x1", "y1", "x2", "y2"))
    assert len(rows) == 3
