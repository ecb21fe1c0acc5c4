"""What results say of themselves on simulated cars."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.camera import Ground
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.evaluation.calibration import calibrate, judge_simulated


@pytest.mark.parametrize("name", ["kitti", "apollo79"])
def test_sizes_have_the_spread_of_the_traffic(name):
    prior, fleet = load_prior("car14"), size_prior(name)
    assert (fleet.traffic is not None) == (name == "kitti")
    model = prepare(prior, fleet)
    basis = model.dimension_basis
    taken = np.eye(prior.dimension) + basis.T @ np.diag(fleet.assumed_sigma**-2) @ basis
    for error, sizes in zip(model.size_errors, (fleet.spread, np.diag(fleet.sigma**2)), strict=True):
        spread = np.linalg.inv(taken) @ (error + taken) @ np.linalg.inv(taken)
        np.testing.assert_allclose(basis @ spread @ basis.T, sizes, atol=1e-12)
        assert np.linalg.eigvalsh(spread).min() > 0.0
        others = np.linalg.svd(basis)[2][3:]  # directions in which no size changes
        np.testing.assert_allclose(others @ spread @ others.T, np.eye(len(others)), atol=1e-12)


@pytest.mark.slow
def test_regions_hold():
    cars = replace(size_prior("kitti"), traffic=None)  # no van is drawn
    given = {"ground": Ground.level(1.65), "size_prior": cars}
    judged = [one for one in judge_simulated(150, load_prior("car14"), **given) if one is not None]
    assert len(judged) > 140
    found = calibrate(judged)
    assert [one.quantity for one in found.regions] == ["position", "yaw", "size", "keypoints"]
    for one in found.regions:
        assert 0.5 < one.inside[0.68]["claimed"] < 0.85, one.quantity
        assert one.inside[0.95]["claimed"] > 0.9, one.quantity
    again = [one for one in judge_simulated(5, load_prior("car14"), **given) if one is not None]
    assert [one.regions for one in again] == [one.regions for one in judged[:5]]
