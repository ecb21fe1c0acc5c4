"""One training, on made-up photographs and with small networks."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.io.coco_keypoints import write_coco_keypoints
from fgrecon.io.kitti_files import read_drive
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.network_file import Stored, save_weights
from fgrecon_research.annotation.annotate import annotate
from fgrecon_research.annotation.labels import vehicle_labels
from fgrecon_research.training.keypoints.trainer import load_tensors
from research.tests.annotation.streets import Car, GivenKeypoints, write_drive
from research.tests.training.keypoints.support import make_small
from research.tests.training.keypoints.test_rounds import SMALL, Display, source  # noqa: F401 - a fixture

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.layout import RefineSettings  # noqa: E402
from fgrecon_research.training.keypoints import networks, rounds  # noqa: E402
from fgrecon_research.training.keypoints.knet import KNet  # noqa: E402
from fgrecon_research.training.keypoints.networks import Plan  # noqa: E402
from fgrecon_research.training.keypoints.rounds import Beginning  # noqa: E402
from fgrecon_research.training.keypoints.train_refine import RefineNet  # noqa: E402


@pytest.fixture
def train(source, monkeypatch, tmp_path):  # noqa: F811
    make_small(source, monkeypatch)

    def run(out, display=None, work="work", **changed):
        """A training of two steps; what is given of its beginning and its plan by name."""
        plan = {"steps": 2, "batch": 2, "relabel_at": (1,), "workers": 0, "refine_steps": 1}
        plan |= {name: value for name, value in changed.items() if name in Plan.__dataclass_fields__}
        beginning = Beginning(**{name: value for name, value in changed.items() if name not in plan})
        where = (tmp_path / "data", tmp_path / work, tmp_path / out)
        networks.train_networks(*where, beginning, Plan(**plan), display or Display())

    (tmp_path / "work").mkdir()
    (tmp_path / "other").mkdir()
    return run


def test_networks_are_trained_shown_and_written(train, tmp_path):
    train("first.safetensors", display := Display())
    assert {"Training to step 2", "Refinement networks", "Calibration"} <= set(display.logged)
    assert [(report.step, report.steps) for report in display.reports if report.score is not None][-1] == (2, 2)
    first = load_tensors(tmp_path / "first.safetensors")
    assert first.refinement is not None
    assert first.provenance["training"] == "2 steps of 2, labels corrected at [1], seed 0"
    assert first.provenance["start"] == "random weights"


def test_a_trained_network_can_go_on_and_be_kept(train, tmp_path):
    torch.manual_seed(1)
    start = tmp_path / "start.safetensors"
    save_weights(
        start, Stored(KNet(SMALL).state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {"start": "nothing"})
    )
    train("on.safetensors", start=start, start_share=1.0, relabel_at=(9,), refine_steps=0)
    before, after = load_tensors(start), load_tensors(tmp_path / "on.safetensors")
    expected = "start.safetensors (of which 1 is left in the weights), itself from: nothing"
    assert after.provenance["start"] == expected
    assert after.refinement is None
    for name, value in before.state.items():  # nothing of what was learnt now is in them
        np.testing.assert_allclose(after.state[name].float(), value.float(), atol=1e-3)


@pytest.fixture
def street(tmp_path, monkeypatch):
    """Labels of a car in each of two drives, `near` and `far`."""
    # A network that knows nothing would correct the photographs' labels to where no shape is.
    monkeypatch.setattr(rounds, "corrected", lambda _, first, *more: first)
    prior = load_prior("car14")
    streets = {"near": [{1: Car((0.0, 1.65, 15.0), 0.4)}], "far": [{1: Car((1.0, 1.65, 20.0), 2.0)}]}
    annotated = []
    for name, frames in streets.items():
        made, _ = annotate(
            read_drive(write_drive(tmp_path / name, prior, frames)), GivenKeypoints(frames, prior), prior
        )
        annotated += [(name, one) for one in made]
    return write_coco_keypoints(tmp_path / "street.json", vehicle_labels(annotated, prior.category, {}))


@pytest.fixture
def begun(tmp_path):
    """A network of both kinds, in a file."""
    torch.manual_seed(1)
    knet, refined = KNet(SMALL), RefineNet(RefineSettings(crop=64, width=4))
    stored = Stored(knet.state_dict(), SMALL.to_dict(), ConfidenceCalibration(), {}, refined.state_dict(), {})
    stored = replace(stored, refine_settings=refined.settings.to_dict(), trust=0.3)
    return save_weights(tmp_path / "start.safetensors", stored)


def test_street_cars_are_learnt_from_beside_the_photographs(train, street, begun, tmp_path):
    options = {"start": begun, "street": street, "street_share": 0.75, "rate": 1e-4, "decay": 0.5}
    options |= {"relabel_at": (9,), "refine_steps": 0}
    train("street.safetensors", display := Display(), without=("far",), **options)
    assert "Street cars" in display.logged
    before, trained = load_tensors(begun), load_tensors(tmp_path / "street.safetensors")
    assert trained.provenance["data"].endswith("; 1 street cars in 0.75 of the samples, without far")
    assert (trained.trust, trained.refine_settings) == (0.3, before.refine_settings)
    for name, value in trained.refinement.items():  # kept, since no step was made on them
        np.testing.assert_allclose(value, before.refinement[name], atol=1e-3)
    with pytest.raises(InvalidInputError) as refused:  # the same folder, but other drives
        train("street.safetensors", **options)
    assert refused.value.field == "work"
    labels = json.loads(street.read_text())
    street.write_text(json.dumps({**labels, "annotations": labels["annotations"][:1]}))
    with pytest.raises(InvalidInputError) as refused:  # the cars that are cut out are others
        train("street.safetensors", **options)
    assert "labels" in refused.value.fix


def test_refinement_networks_learn_from_the_street_as_well(train, street, begun, tmp_path):
    train("p.safetensors", start=begun, relabel_at=(9,))
    options = {"start": begun, "start_share": 0.0, "street": street, "street_share": 1.0, "relabel_at": (9,)}
    train("s.safetensors", work="other", **options)
    before, after = load_tensors(begun).refinement, load_tensors(tmp_path / "s.safetensors").refinement
    assert before.keys() == after.keys()
    moved = [name for name, value in after.items() if (value - before[name]).abs().max() > 1e-4]
    assert moved


@pytest.mark.parametrize(("street_too", "known"), [(True, "far, near"), (False, "Leave out drives only where")])
def test_drives_that_are_not_there_cannot_be_left_out(train, street, tmp_path, street_too, known):
    with pytest.raises(InvalidInputError) as refused:
        train("s.safetensors", street=street if street_too else None, without=("near", "drive_0095"))
    assert (refused.value.field, refused.value.value) == ("without", "drive_0095" if street_too else "near")
    assert known in refused.value.fix
    assert not (tmp_path / "work" / "knet.pt").exists()


class Killed(BaseException):
    """As from outside: nothing catches it."""


def test_a_network_that_is_there_is_calibrated(train, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:

        def killed(*_, **__):
            raise Killed

        patch.setattr(networks, "calibrate", killed)
        with pytest.raises(Killed):
            train("n.safetensors")
    assert not (tmp_path / "n.safetensors").exists()
    train("n.safetensors")
    assert load_tensors(tmp_path / "n.safetensors").calibration != ConfidenceCalibration()


def test_a_training_goes_on_with_the_same_plan_network_and_data(train, source, begun, monkeypatch):  # noqa: F811
    monkeypatch.setattr(rounds, "corrected", lambda _, first, *more: first)
    train("n.safetensors", start=begun)

    def refused(reason, **options):
        with pytest.raises(InvalidInputError) as again:
            train("n.safetensors", start=begun, **options)
        assert again.value.field == "work"
        assert reason in again.value.fix

    refused("rate: 0.001 became 0.01.", rate=0.01)
    refused("steps: 2 became 3.", steps=3)
    refused("steps: 1 became 2.", refine_steps=2)
    other = replace(source, learn=source.learn[1:])
    with monkeypatch.context() as patch:
        patch.setattr(networks, "read_source", lambda data, marks: other)
        refused("photographs: ")
    stored = load_tensors(begun)
    save_weights(begun, replace(stored, trust=0.9))  # another network under the same name
    refused("start: ")
