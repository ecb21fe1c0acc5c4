"""`fgrecon keypoints train` from the outside, on made-up photographs and with small networks."""

from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.weights import Stored, load_weights, save_weights
from tests.training.keypoints.test_rounds import SMALL, source  # noqa: F401 - a fixture

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.knet import KNet  # noqa: E402
from fgrecon.perception.keypoints.refine import RefineSettings  # noqa: E402
from fgrecon.training.keypoints import networks  # noqa: E402
from fgrecon.training.keypoints.augment import Street  # noqa: E402


@pytest.fixture
def train(source, monkeypatch, tmp_path):  # noqa: F811
    small = {"warmup": 1, "save_every": 1, "street": Street(size=32)}
    monkeypatch.setattr(networks, "read_source", lambda data, marks: source)
    monkeypatch.setattr(networks, "Training", partial(networks.Training, network=SMALL, **small))
    refined = RefineSettings(crop=64, width=4)
    refine = partial(networks.RefineTraining, network=refined, batch=2, save_every=1)
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


def test_a_trained_network_can_go_on_and_be_kept(train, tmp_path):
    torch.manual_seed(1)
    start = tmp_path / "start.safetensors"
    save_weights(
        start, Stored(KNet(SMALL).state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {"start": "nothing"})
    )
    done = train("on.safetensors", "--start", start, "--start-share", 1, "--relabel-at", 9, "--refine-steps", 0)
    assert done.exit_code == 0, done.output
    before, after = load_weights(start), load_weights(tmp_path / "on.safetensors")
    told = "start.safetensors (of which 1 is left in the weights), itself from: nothing"
    assert after.provenance["start"] == told
    assert after.refinement is None
    for name, value in before.state.items():  # nothing of what was learnt now is in them
        np.testing.assert_allclose(after.state[name].float(), value.float(), atol=1e-3)


def test_quiet(train):
    assert train("n.safetensors", "-q").output == ""


def test_bad_options_are_refused_before_the_work(train, tmp_path):
    for arguments, field in ((["--relabel-at", "a"], "relabel_at"), (["--out", tmp_path], "output")):
        done = train("n.safetensors", *arguments)
        assert isinstance(done.exception, InvalidInputError)
        assert done.exception.field == field
    assert not (tmp_path / "work").exists()
