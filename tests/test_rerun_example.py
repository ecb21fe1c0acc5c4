"""The rerun example has what rerun's own checks ask of one: metadata, a thumbnail, headings; and it runs."""

from __future__ import annotations

import runpy
import sys
import tomllib

import pytest
from PIL import Image

from fgrecon.viz import replay
from tests.conftest import REPOSITORY
from tests.viz.test_blueprint import layout_of

FOLDER = REPOSITORY / "examples/rerun/vehicle_reconstruction"
README = (FOLDER / "README.md").read_text(encoding="utf-8")
METADATA = tomllib.loads(README.partition("<!--[metadata]\n")[2].partition("-->")[0])
TAGS = {"3D", "Graph", "Keypoint detection", "Reconstruction", "Single-view", "States"}
"""Those of rerun's list, examples/tags.toml, that are used."""


def test_the_metadata_are_whole():
    assert README.startswith("<!--[metadata]\n")
    assert {"title", "tags", "description", "thumbnail", "thumbnail_dimensions", "channel"} == set(METADATA)
    assert METADATA["channel"] in ("main", "nightly", "release")
    assert set(METADATA["tags"]) <= TAGS
    assert len(METADATA["description"]) <= 130
    title = METADATA["title"]
    assert title == title[0].upper() + title[1:].lower()


def test_the_thumbnail_has_the_size_that_is_reported():
    with Image.open(FOLDER / METADATA["thumbnail"]) as picture:
        assert list(picture.size) == METADATA["thumbnail_dimensions"]
    assert (FOLDER / METADATA["thumbnail"]).stat().st_size < 200_000


def test_headings_and_commands_are_as_theirs():
    body = README.partition("-->")[2]
    assert not [line for line in body.splitlines() if line.startswith("# ")]
    for heading in ("Used Rerun types", "Background", "Logging and visualizing with Rerun", "Run the code"):
        assert f"\n## {heading}\n" in body
    assert f"python -m {FOLDER.name}" in body
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == FOLDER.name
    assert project["scripts"] == {FOLDER.name: f"{FOLDER.name}:main"}


def test_it_runs_and_saves_a_recording_with_the_layout(tmp_path, monkeypatch):
    rerun = pytest.importorskip("rerun")
    path = tmp_path / "vehicles.rrd"
    monkeypatch.setattr(sys, "argv", [f"{FOLDER.name}.py", "--save", str(path)])
    runpy.run_path(str(FOLDER / f"{FOLDER.name}.py"), run_name="__main__")
    rerun.disconnect()  # what the end of the program does: the file is whole then
    read = replay.read(path)
    assert set(read.vehicles) == {"car-1", "car-2", "car-3"}
    assert all(vehicle.history for vehicle in read.vehicles.values())
    assert layout_of(path).views["From above: box, heading, 95 % of position"] == 1
