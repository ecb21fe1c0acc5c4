"""`fgrecon keypoints train` from the outside, on made-up photographs and with small networks."""

from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.weights import load_weights
from tests.training.keypoints.test_rounds import SMALL, source  # noqa: F401 - a fixture

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.refine import RefineSettings  # noqa: E402
from fgrecon.training.keypoints import networks  # noqa: E402
from fgrecon.training.keypoints.augment import Street  # noqa: E402


@pytest.fixture
def train(source, monkeypatch, tmp_path):  # noqa: F811
    small = {"warmup": 1, "save_every": 1, "street": Street(size=32)}
    monkeypatch.setattr(networks, "read_source", lambda data, marks: source)
    monkeypatch.setattr(networks, "Training", partial(networks.Training, network=SMALL, **small))
    refined = RefineSettings(crop=64, width=4)
    refine = partial(networks.RefineTraining, network=refined, batch=2, save_every=1, workers=0)
    monkeypatch.setattr(networks, "RefineTraining", refine)
    monkeypatch.setattr(networks, "calibrate", partial(networks.calibrate, samples=6))

    def run(out, *more):
        told = ["--work", tmp_path / "work", "--out", tmp_path / out, "--steps", 2, "--batch", 2, "--relabel-at", 1]
        arguments = ["keypoints", "train", *told, "--workers", 0, "--refine-steps", 1, *more]
        return CliRunner().invoke(app, [*map(str, arguments)])

    return run


def test_networks_are_trained_shown_and_written(train, tmp_path):
    done = train("first.safetensors")
    assert done.exit_code == 0, done.output
    assert done.stdout == f"Wrote {tmp_path / 'first.safetensors'}.\n"
    for line in ("Training to step 2", "Refinement networks", "Calibration"):
        assert line in done.stderr.splitlines()
    assert "step 2 of 2: " in done.stderr
    first = load_weights(tmp_path / "first.safetensors")
    assert first.refinement is not None
    assert first.provenance["training"] == "2 steps of 2, labels corrected at [1], seed 0"
    assert first.provenance["start"] == "random weights"

    on = train(
        "on.safetensors", "--start", tmp_path / "first.safetensors", "--start-share", 1, "--work", tmp_path / "w"
    )
    assert on.exit_code == 0, on.output
    second = load_weights(tmp_path / "on.safetensors")
    assert second.provenance["start"].startswith("first.safetensors (of which 1 is left")
    for name, value in first.state.items():  # nothing of what was learnt now is in them
        np.testing.assert_allclose(second.state[name].float(), value.float(), atol=1e-3)


def test_quiet(train):
    assert train("n.safetensors", "-q").output == ""


def test_bad_options_are_refused_before_the_work(train, tmp_path):
    for arguments, field in ((["--relabel-at", "a"], "relabel_at"), (["--out", tmp_path], "output")):
        done = train("n.safetensors", *arguments)
        assert isinstance(done.exception, InvalidInputError)
        assert done.exception.field == field
    assert not (tmp_path / "work").exists()
