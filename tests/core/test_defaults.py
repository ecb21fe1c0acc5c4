"""The numbers that everything published was made with: none changes unnoticed."""

from dataclasses import asdict, fields

import numpy as np
import pytest

from fgrecon.core.camera import Ground
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.robust import Evidence, RobustStrategy, StrategyName

DEFAULTS = {
    "traffic": None,
    "strategy": {
        "name": StrategyName.MIXTURE,
        "updates": 5,
        "tuning": None,
        "gnc_start": 64.0,
        "mu0": 0.5,
        "mu1": 0.5,
        "mu2": 0.7,
        "gross": 0.1,
        "missed": 0.2,
        "false_alarm": 0.05,
    },
    "keypoints": {
        "sigma_relative": 0.035,
        "sigma_pixels": 1.0,
        "least_confidence": 0.0,
        "common_factor": 7.0,
        "facing_bias": -0.390,
        "facing_slope": 0.976,
        "fitted": False,
    },
    "box": {
        "model": BoxModel.SURFACE,
        "sigma_relative": 0.02,
        "sigma_pixels": 1.5,
        "left": -0.034,
        "upper": 0.014,
        "right": 0.034,
        "lower": 0.010,
    },
    "search": {"azimuths": 24, "basis_vectors": 0},
    "shape": {
        "joint": True,
        "free_offsets": True,
        "basis_vectors": None,
        "own_fleet": False,
        "planarity_sigma": 0.03,
        "symmetry_sigma": 0.01,
        "rectangularity_sigma": 0.01,
        "parallel_sigma": 0.03,
        "laplacian_sigma": 0.5,
        "literal_laplacian": False,
        "common_error": 1.0,
        "plane_penalty": None,
    },
    "disabled_terms": frozenset({"laplacian", "planarity"}),
    "ambiguity_margin": 3.0,
    "keep_history": True,
}


def test_options():
    assert {entry.name for entry in fields(Options)} == set(DEFAULTS)
    for name, value in DEFAULTS.items():
        mine = getattr(Options(), name)
        assert (asdict(mine) if isinstance(value, dict) else mine) == value


def test_ground_and_confidence():
    ground = Ground.level(1.65)
    assert (ground.height_sigma, ground.slope_sigma, ground.tilt_sigma) == (0.1, 0.0125, 0.03)
    assert Observation(np.zeros((1, 2)), np.ones(1)).confidence_midpoint == 0.2


@pytest.mark.parametrize(
    ("right", "visible", "wrong"),
    [
        (1.0, 1.0, 0.1),  # sure of what is visible: wrong all the same once in ten
        (0.0, 1.0, 0.2),  # unsure of what is visible: missed once in five
        (1.0, 0.0, 0.05),  # sure of what is hidden: a false alarm once in twenty
        (0.0, 0.0, 0.95),  # unsure of what is hidden, as it should be
    ],
)
def test_the_mixtures_table(right, visible, wrong):
    """Far from its keypoint a point has the energy of being anything else."""
    evidence = Evidence(np.array([right]), np.array([0.01]), np.array([True]))
    weights, energy = RobustStrategy().evaluate(np.array([1e4]), evidence, np.array([visible]))
    assert weights[0] == pytest.approx(0.0, abs=1e-12)
    assert energy == pytest.approx(-np.log(0.01 * wrong))
