"""Regions of results from people's marks: each half of the images is judged by what was fitted to the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.calibration.detector_fit import holding
from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon_research.paper.apollocar3d import read_apollocar3d
from fgrecon_research.paper.marked_calibration import NOISES, calibrate_marked, halves
from fgrecon_research.training.priors.apollo79 import load_apollo79


def test_the_setting_at_which_regions_hold_on_the_mean():
    small, large = np.array([0.5, 0.7, 0.9]), np.array([0.73, 0.93, 0.95])  # mean 0.815 of 68 and 95 % at the second
    assert holding((1.0, 2.0, 4.0), [small, large]) == pytest.approx(2.0, rel=1e-6)
    assert holding((1.0, 2.0, 4.0), [np.ones(3), np.ones(3)]) == pytest.approx(1.0)


@pytest.fixture(scope="module")
def marked(data):
    models = load_apollo79(data)
    return models, read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)


@pytest.mark.data
def test_halves_share_no_image(marked):
    _, cars = marked
    first, second = ({car.name.partition(":")[0] for car in part} for part in halves(cars.cars))
    assert not first & second
    assert min(len(first), len(second)) > 0.3 * len(first | second)


@pytest.mark.data
@pytest.mark.slow
def test_regions_hold_on_the_other_half(marked):
    models, cars = marked
    reported = []
    found = calibrate_marked(replace(cars, cars=cars.cars[::8]), models, lambda *done: reported.append(done))
    assert reported[-1] == (6 * len(cars.cars[::8]),) * 2
    assert all(NOISES[0] < sigma < NOISES[-1] for sigma in found.sigma_relative)
    assert [one.quantity for one in found.calibration.regions] == ["position", "yaw", "size", "keypoints"]
    for one in found.calibration.regions:
        assert 0.5 < one.inside[0.68]["claimed"] < 0.88, one.quantity
        assert one.inside[0.95]["claimed"] > 0.8, one.quantity


@pytest.mark.data
def test_one_image_is_too_few(marked):
    models, cars = marked
    with pytest.raises(InvalidInputError, match="in one half of the images"):
        calibrate_marked(replace(cars, cars=cars.cars[:1]), models)


def test_the_command_names_what_is_missing(tmp_path):
    done = CliRunner().invoke(main.app, ["evaluate", "marks", "--data", str(tmp_path)])
    assert isinstance(done.exception, InvalidInputError)
    assert "apollo79" in str(done.exception)
