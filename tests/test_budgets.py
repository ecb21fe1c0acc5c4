"""The budgets of the code: what is counted is what the script says."""

from benchmarks.budgets import line_budgets, lines_of, rooms, traced

from .test_layers import ROOMS


def test_the_keypoints_are_followed_up_to_the_graph():
    way = traced()
    files = [file for file, _ in way.places]
    assert files[:2] == ["fgrecon/solve/pipeline.py", "fgrecon/solve/inputs.py"]
    assert "fgrecon/solve/proposals/search.py" in files
    assert not any(file.startswith("fgrecon/solve/graph/") for file in files)
    assert len(way.climbs) < len(files) / 2


def test_rooms_stand_as_in_the_tested_table():
    heights = rooms()
    assert set(heights) == set(ROOMS)
    assert all(heights[below] < heights[room] for room, under in ROOMS.items() for below in under)


def test_lines_are_those_of_code():
    assert lines_of("fgrecon/solve") < lines_of("fgrecon") < lines_of("fgrecon", "factors")


def test_budgets_of_lines_that_are_met_stay_met():
    _, *met = line_budgets()
    assert not [budget for budget in met if budget.count > budget.most]
