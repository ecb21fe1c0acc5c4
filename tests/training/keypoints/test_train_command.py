"""`fgrecon keypoints train` from the outside, on made-up photographs and with small networks."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.annotation.annotate import annotate
from fgrecon.annotation.labels import vehicle_labels
from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.io.export import write_coco_keypoints
from fgrecon.io.kitti_drives import read_drive
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.weights import Stored, load_weights, save_weights
from tests.annotation.streets import Car, Told, write_drive
from tests.training.keypoints.test_rounds import SMALL, source  # noqa: F401 - a fixture

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.knet import KNet  # noqa: E402
from fgrecon.perception.keypoints.refine import RefineNet, RefineSettings  # noqa: E402
from fgrecon.training.keypoints import networks, rounds  # noqa: E402
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


def test_street_cars_are_learnt_from_beside_the_photographs(train, tmp_path, monkeypatch):
    # A network that knows nothing would correct the photographs' labels to where no shape is.
    monkeypatch.setattr(rounds, "corrected", lambda _, first, *more: first)
    prior = load_prior("car14")
    streets = {"near": [{1: Car((0.0, 1.65, 15.0), 0.4)}], "far": [{1: Car((1.0, 1.65, 20.0), 2.0)}]}
    annotated = []
    for name, frames in streets.items():
        made, _ = annotate(read_drive(write_drive(tmp_path / name, prior, frames)), Told(frames, prior), prior)
        annotated += [(name, one) for one in made]
    file = write_coco_keypoints(tmp_path / "street.json", vehicle_labels(annotated, prior.category, {}))
    start = tmp_path / "start.safetensors"
    knet, refined = KNet(SMALL), RefineNet(RefineSettings(crop=64, width=4))
    begun = Stored(knet.state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {}, refined.state_dict(), {})
    save_weights(start, replace(begun, refine_settings=refined.settings.to_dict(), trust=0.3))
    told = ("--start", start, "--street", file, "--street-share", 0.75, "--rate", 1e-4, "--decay", 0.5)
    done = train("street.safetensors", *told, "--without", "far", "--relabel-at", 9, "--refine-steps", 0)
    assert done.exit_code == 0, done.output
    assert "Street cars" in done.stderr
    trained = load_weights(tmp_path / "street.safetensors")
    assert trained.provenance["data"].endswith("; 1 street cars in 0.75 of the samples, without far")
    assert (trained.trust, trained.refine_settings) == (0.3, refined.settings.to_dict())
    for name, value in trained.refinement.items():  # kept, since no step was made on them
        np.testing.assert_allclose(value, refined.state_dict()[name], atol=1e-3)
    again = train("street.safetensors", *told, "--relabel-at", 9, "--refine-steps", 0)
    assert isinstance(again.exception, InvalidInputError)  # the same folder, but other drives
    assert again.exception.field == "work"
