"""`fgrecon demo` from the outside: it needs no data, is close to the truth, and writes all that it says."""

import json

import numpy as np
import pytest

from fgrecon.cli.demo import DEMO_SEED
from fgrecon.cli.demo_report import solved_street
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.simulation.sample import sample_street
from fgrecon.viz.describe import bounds_of
from fgrecon.viz.replay import read as replay
from tests.command_line import run


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Folder and output of one run."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    return folder, run("demo", "--out", folder, "--json", "-")


def test_the_result_is_close_to_the_truth(demo):
    folder, done = demo
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document == json.loads((folder / "result.json").read_text())
    result = Reconstruction.from_dict(document["result"])
    assert result.status is Status.CONVERGED
    pose, stages = np.array(document["truth"]["camera_T_object"]), document["stages"]
    assert np.linalg.norm(result.location - pose[:3, 3]) < 0.5
    assert [stage["stage"] for stage in stages] == ["initial", "after pose", "after both"]
    assert stages[-1]["camera_T_object"] == document["result"]["camera_T_object"]
    assert stages[-1]["errors"]["orientation_deg"] < 5.0
    assert stages[-1]["errors"]["keypoints_m"] < 0.2
    assert document["truth"]["visible"].count(False) >= 4


def test_the_cars_of_the_street_get_nearer_to_the_truth():
    """In the scene that is drawn where no seed is given, and within how far they are said to be known."""
    prior = load_prior("car14")
    cars = solved_street(prior, sample_street(prior, DEMO_SEED))
    assert len(cars) == 3
    for car in cars:
        assert car.result.status is Status.CONVERGED
        first, last = (car.result.diagnostics.history[i] for i in (0, -1))
        start, end = (car.truth.errors(step.camera_T_object, step.keypoints) for step in (first, last))
        assert end["translation_m"] < min(start["translation_m"], bounds_of(car.result)[0])
        assert end["orientation_deg"] < start["orientation_deg"]


def test_it_says_how_far_the_result_is_known(demo):
    assert any(line.startswith("Distance and yaw, 95 %: ± ") for line in demo[1].stderr.splitlines())


def test_the_table_shows_truth_and_every_stage(demo):
    lines = demo[1].stderr.splitlines()
    for row in ("truth", "initial", "after pose", "after both"):
        assert any(line.startswith(row) for line in lines)
    assert max(map(len, lines[:8])) <= 80


def test_picture_and_recording(demo):
    folder, _ = demo
    assert read_image(folder / "picture.png").std() > 10
    scene = read_image(folder / "scene.jpg")
    assert scene.std() > 10
    assert scene.shape[1] > 2 * scene.shape[0]  # the scene from above beside the photographs
    assert (folder / "scene.jpg").stat().st_size < 300_000
    recorded = replay(folder / "recording.rrd")
    document = json.loads((folder / "result.json").read_text())
    assert len(recorded.history) == len(document["result"]["history"])
    assert "error/translation_m" in recorded.scalars  # the truth is in the recording


def test_what_went_in_can_be_reconstructed_again(demo):
    folder, _ = demo
    done = run(
        *("reconstruct", folder / "keypoints.json", "--image", folder / "image.png"),
        *("--camera-height", 1.65, "--json", "-"),
    )
    assert done.exit_code == 0, done.output
    again = json.loads(done.stdout)["instances"][0]["result"]
    first = json.loads((folder / "result.json").read_text())["result"]
    assert again["camera_T_object"] == pytest.approx(np.array(first["camera_T_object"]), abs=1e-9)
    assert again["coefficients"] == pytest.approx(first["coefficients"], abs=1e-9)


def test_another_seed_is_another_scene(demo, tmp_path):
    done = run("demo", "--out", tmp_path, "--seed", 1, "--json", "-")
    assert json.loads(done.stdout)["truth"] != json.loads((demo[0] / "result.json").read_text())["truth"]


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    done = run("demo", "--out", tmp_path / "file")
    assert isinstance(done.exception, OSError)  # which the entry point turns into a line and exit code 2
