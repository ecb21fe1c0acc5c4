"""Places of the right model among the closest: twins, chance, and real cars above it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon_research.paper.apollocar3d import read_apollocar3d
from fgrecon_research.paper.closest_models import CLOSEST_ROWS, ClosestModelRanks, _ranked, rank_models
from fgrecon_research.training.priors.apollo79 import DUPLICATE, load_apollo79

SHAPE = np.arange(42, dtype=np.float64).reshape(14, 3)


def library(*moved: tuple[str, float]) -> list[VehicleMesh]:
    return [
        VehicleMesh(name, np.zeros((3, 3)), np.zeros((1, 3), np.int64), {str(k): p + away for k, p in enumerate(SHAPE)})
        for name, away in moved
    ]


def test_places_are_counted_from_one_and_twins_count_once():
    models = library(("a", 0.3), ("b", 0.1), (DUPLICATE[0], 0.2), (DUPLICATE[1], 0.05))
    for right, place in (("a", 3), ("b", 1), (DUPLICATE[0], 1), (DUPLICATE[1], 1)):
        assert _ranked(SHAPE, models, right)[0][1] == place
    assert _ranked(None, models, "a")[1][1] == len(models)
    margin, _ = _ranked(SHAPE, models, "a")[0]
    assert margin == pytest.approx(0.1 * np.sqrt(3))


def test_shares_and_chance():
    ranks = {row: np.array([1, 2, 6, 30]) for row in CLOSEST_ROWS[1:]}
    found = ClosestModelRanks(("a", "b", "c", "d"), 78, ranks, np.zeros(4))
    assert (found.share("Hausdorff", 1), found.share("Hausdorff", 5)) == (25.0, 50.0)
    assert found.share("chance", 5) == pytest.approx(500 / 78)
    assert (found.median("chance"), found.median("keypoints")) == (39.5, 4.0)


@pytest.mark.data
def test_the_right_model_is_found_more_often_than_by_chance(data):
    models = load_apollo79(data)
    cars = read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)
    found = rank_models(replace(cars, cars=cars.cars[::12]), models)
    assert found.count == 78
    assert found.share("Hausdorff+others", 5) > 1.5 * found.share("chance", 5)
    assert found.share("mean shape", 1) == 0.0


def test_the_command_names_what_is_missing(tmp_path):
    done = CliRunner().invoke(main.app, ["evaluate", "models", "--data", str(tmp_path)])
    assert isinstance(done.exception, InvalidInputError)
    assert "apollo79" in str(done.exception)
