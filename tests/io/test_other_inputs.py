"""Files that are taken for keypoints: the error names the command that reads them."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon.io.keypoints import read_any_keypoints
from tests.io.formats import CATEGORY


def refusal(*arguments):
    done = CliRunner().invoke(main.app, [*map(str, arguments)])
    assert isinstance(done.exception, InvalidInputError), done.output
    return done.exception


@pytest.mark.parametrize("command", ["reconstruct", "track"])
@pytest.mark.parametrize(
    ("name", "wanted"),
    [("drive.mp4", "fgrecon run"), ("cars.jsonl", "fgrecon batch"), ("cars.parquet", "fgrecon batch")],
)
def test_other_files_are_refused_with_their_command(tmp_path, command, name, wanted):
    (tmp_path / name).write_bytes(b"\xff\xd8 none of JSON")
    refused = refusal(command, tmp_path / name)
    assert wanted in refused.fix
    assert name in refused.value
    (tmp_path / name).unlink()
    assert "No such file" in refusal(command, tmp_path / name).fix


def test_an_image_is_no_track(tmp_path):
    image = write_png(tmp_path / "street.png", np.zeros((8, 8, 3), np.uint8))
    assert "fgrecon reconstruct" in refusal("track", image).fix
    with pytest.raises(InvalidInputError, match="fgrecon reconstruct"):
        read_any_keypoints(image, CATEGORY)


@pytest.mark.parametrize("kind", ["fgrecon.reconstructions/2", "fgrecon.track/2", "fgrecon.reconstruction/2"])
@pytest.mark.parametrize("command", [["reconstruct"], ["track"], ["run", "--out"]])
def test_results_are_for_export(tmp_path, kind, command):
    file = tmp_path / "result.json"
    file.write_text(json.dumps({"format": kind, "instances": [{"id": "car"}]}))
    out = [tmp_path / "out"] if len(command) > 1 else []
    refused = refusal(*command, *out, file)
    assert (refused.field, refused.value) == (f"{file}: format", kind)
    assert "fgrecon export" in refused.fix


def test_a_batch_says_so_of_results_as_well(tmp_path):
    file = tmp_path / "result.json"
    file.write_text(json.dumps({"format": "fgrecon.track/2", "instances": []}))
    done = CliRunner().invoke(main.app, ["batch", str(file), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "fgrecon export" in done.stderr


@pytest.mark.parametrize(("source", "said"), [("nope.mp4", True), ("nope", True), ("nope*.png", False)])
def test_a_video_that_does_not_exist(tmp_path, source, said):
    refused = refusal("run", tmp_path / source, "--out", tmp_path / "out")
    assert refused.field == "source"
    assert ("no such file" in refused.fix) is said
