"""What `fgrecon keypoints evaluate` tells of marked cars, by group and by keypoint."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.cli.terminal import Screen
from fgrecon_research.cli.training.keypoints import marks_document, print_marks
from fgrecon_research.training.keypoints.evaluate import Scored, localisation
from fgrecon_research.training.keypoints.marks import Mark

NAMES = ("wheel", "roof")


def scored(group, errors, confidence, visible):
    """A car whose two keypoints are off by fractions of its box, and how sure the network was of each."""
    mark = Mark(Path("0.png"), "0", group, np.array([0.0, 0.0, 100.0, 50.0]), np.zeros((2, 2)), np.array(visible))
    detection = SimpleNamespace(observation=SimpleNamespace(confidence=np.array(confidence)))
    return Scored(mark, detection, np.array(errors))


CARS = [
    scored("photographs", [0.01, 0.07], [0.9, 0.8], [True, True]),
    scored("photographs", [0.30, 0.01], [0.8, 0.9], [True, False]),  # a hidden roof that it is sure of
    scored("photographs", [0.04, 0.02], [0.7, 0.7], [True, True]),
    scored("easy", [0.01, 0.20], [0.9, 0.1], [True, False]),
]


def test_a_hidden_point_is_wrong_for_the_average_precision_and_none_for_the_share():
    found = localisation(CARS, ("photographs",))
    np.testing.assert_array_equal(found.counts, [3, 2])
    np.testing.assert_allclose(found.keypoints, [[2 / 3, 2 / 3], [1.0, 0.5]])
    # wheel: right, wrong, right of three; roof: wrong, right, right of two, and at 0.05 wrong, wrong, right
    np.testing.assert_allclose(found.precisions, [[5 / 9, 5 / 9], [2 / 3, 1 / 6]])


def test_both_are_reported_by_point(capsys):
    print_marks(Screen(None, error=False, quiet=False, verbose=False, progress=False), CARS, NAMES)
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines() if line.split()}
    assert rows["wheel"] == ["1", "100", "100", "100", "100"]  # the street's table comes last
    assert rows["roof"] == ["0"]
    marks = json.loads(json.dumps(marks_document(CARS, NAMES), allow_nan=False))["marks"]
    assert marks["photographs"]["keypoints_apk"] == {
        "wheel": pytest.approx([5 / 9] * 2),
        "roof": pytest.approx([2 / 3, 1 / 6]),
    }
    assert marks["hard"]["keypoints_apk"]["roof"] == [None, None]
    assert marks["hard"]["keypoints_points"] == {"wheel": 1, "roof": 0}
