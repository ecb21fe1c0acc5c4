"""Training of the refinement networks: keypoints of unknown place teach nothing, and it resumes."""

import numpy as np
import pytest

from fgrecon.io.catalogue import load_category
from fgrecon.perception.keypoints.layout import RefineSettings
from research.tests.training.keypoints.test_augment import made_up_view

torch = pytest.importorskip("torch")

from fgrecon_research.training.keypoints.augment import Street  # noqa: E402
from fgrecon_research.training.keypoints.train_refine import (  # noqa: E402
    RefineNet,
    RefineTraining,
    train_refinement,
)

MIRROR = load_category("car14").mirror
SMALL = RefineSettings(crop=64, width=2)


class OneView:
    """Photographs of which each is the same."""

    def __init__(self):
        self.view = made_up_view(np.random.default_rng(0))

    def draw(self, street, partner, seed):
        return street.sample(self.view, lambda _: self.view, partner, np.random.default_rng(list(seed)))


class PartlyKnown(OneView):
    """Photographs in which only the first keypoint's place is known."""

    def draw(self, street, partner, seed):
        sample = super().draw(street, partner, seed)
        sample.keypoints[1:] = np.nan
        return sample


def test_keypoints_of_unknown_place_teach_nothing(tmp_path):
    torch.manual_seed(0)
    how = RefineTraining(steps=3, batch=2, network=SMALL, street=Street(size=64), average=0.0)
    begun = RefineNet(SMALL).state_dict()
    trained = train_refinement(PartlyKnown(), MIRROR, tmp_path / "a.pt", how, start=begun)
    weight, before = trained.head.weight.detach().reshape(14, -1), begun["head.weight"].reshape(14, -1)
    assert torch.isfinite(weight).all()
    moved = (weight / before - 1.0).abs().amax(dim=1)
    assert moved[0] > 1e-2
    assert moved[1:].max() < 1e-3  # the decay of weights alone


def test_training_resumes(tmp_path):
    how = RefineTraining(steps=2, batch=2, network=SMALL, save_every=1, street=Street(size=64))
    arguments = (OneView(), MIRROR)
    reports = []
    whole = train_refinement(*arguments, tmp_path / "a.pt", how, report=reports.append)
    train_refinement(*arguments, tmp_path / "b.pt", RefineTraining(**{**how.__dict__, "steps": 1, "decay": 0.0}))
    assert [report.step for report in reports] == [1, 2]
    resumed = train_refinement(*arguments, tmp_path / "b.pt", how)
    for name, value in whole.state_dict().items():
        assert value.shape == resumed.state_dict()[name].shape
