"""The keypoint network's table from made-up scores whose results are known."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon_research.paper.network import NetworkScores, network_parts, network_table, parts_note


@pytest.fixture
def scores():
    """Four cars in two images, two of them easy; the first two keypoints of each are visible."""
    visible = np.zeros((4, 14), dtype=bool)
    visible[:, :2] = True
    wrong = np.full((4, 14), 0.5)
    network, joint = wrong.copy(), np.full((4, 14), 0.04)
    network[:, 0] = 0.05
    joint[3] = np.inf
    turn = np.array([1.0, 2.0, 3.0, 180.0])
    stages = ("pose", "sequential", "joint")
    return NetworkScores(
        cars=("000001", "000001", "000002", "000002"),
        groups=("easy", "easy", "moderate", "hard"),
        visible=visible,
        away={"network": network, "initialisation": wrong} | dict.fromkeys(stages, joint),
        placed={"initialisation": np.zeros(4)} | dict.fromkeys(stages, np.array([1.0, 2.0, 3.0, np.inf])),
        orientation={"initialisation": np.full(4, 8.0)} | dict.fromkeys(stages, turn),
        observations={},
    )


def test_cells_by_hand(scores):
    table = network_table(scores)
    rows = {label: [getattr(cell, "value", cell) for cell in cells] for label, cells in table.rows}
    assert rows["paper: Shape adjustment"][:3] == [80.72, 81.81, 71.39]
    assert rows["keypoint network"] == [50.0, 50.0, 50.0, None, None, None, None, None, pytest.approx(27.5), 0]
    assert rows["initialisation alone"][:8] == [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 8.0, 8.0]
    # The refused car is wrong at every threshold and does not move.
    assert rows["fgrecon, then both jointly"] == [100.0, 100.0, 75.0, 1.5, 2.0, 2.0, 46.5, 2.5, 4.0, 1]
    assert "2 / 3 / 4 cars" in table.note
    assert "4 / 6 / 8 visible keypoints" in table.note
    assert "2 colour images" in table.note


def test_parts_count_visible_points_of_hard_alone(scores):
    shares = network_parts(scores)
    assert list(shares)[:2] == ["keypoint network", "initialisation alone"]
    assert shares["keypoint network"][:2].tolist() == [100.0, 0.0]
    assert shares["fgrecon, pose stage"][:2].tolist() == [75.0, 75.0]
    assert np.isnan(shares["keypoint network"][2:]).all()
    assert "are 4, 4, 0, 0" in parts_note(scores)


def test_a_regime_without_a_car_is_empty(scores):
    table = network_table(replace(scores, groups=("hard",) * 4))
    assert dict(table.rows)["keypoint network"][:2] == (None, None)
