"""The JSON document and the tables, from scores worked by hand."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from fgrecon.io.track_file import parse_track
from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.run import FrameScore, MethodScores


def score(name, degrees, metres):
    return FrameScore(name, degrees, metres, 0.1, np.array([1.0, 2.0, 3.0]), {"pose": degrees, "shape": 2.0}, None)


@pytest.fixture
def scores():
    failed = FrameScore("t:3", 180.0, float("inf"), None, None, {}, "FgreconError: no pose")
    frames = (score("t:0", 2.0, 0.25), score("t:1", 5.0, 0.5), score("t:2", 13.0, 1.5), failed)
    return MethodScores("fgrecon", "all of it", "car14 [v1]", frames)


def test_the_entry_of_a_method(scores):
    entry = report.summary(scores)
    assert entry["n"] == 4
    assert entry["mae_deg"] == 50.0
    assert entry["median_deg"] == 9.0
    assert entry["aop"] == {"5": 50.0, "15": 75.0, "30": 75.0}
    assert entry["frames_within"] == {"5": 2, "15": 3, "30": 3}
    assert entry["median_translation_m"] == 1.0
    assert entry["ms"] == {"pose": pytest.approx(20 / 3), "shape": 2.0}
    assert entry["failures"] == [{"frame": "t:3", "reason": "FgreconError: no pose"}]


def test_the_document_is_strict_json(scores, content, scene):
    track = parse_track(content, "t", scene.prior.category)
    text = report.to_json(report.document([scores], [("a/t.json", track)], scene, {"ground": "level"}))
    data = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert data["methods"]["fgrecon"] == json.loads(json.dumps(report.summary(scores)))
    assert data["files"] == [{"path": "a/t.json", "frames": 3, "frames_without_keypoints": []}]
    assert data["settings"]["ground"] == {"normal": [0.0, 1.0, 0.0], "distance_m": 1.65}
    assert data["settings"]["size_prior"]["mean_m"] == [3.89, 1.62, 1.53]
    assert data["versions"]["numpy"] == np.__version__
    assert data["machine"]["cores"] >= 1


def test_a_median_without_a_value_is_null(scores):
    lost = MethodScores("lost", "", "car14", (scores.frames[3],) * 3)
    entry = report.summary(lost)
    assert entry["median_translation_m"] is None
    assert entry["ms"] == {"pose": None, "shape": None}
    assert json.loads(report.to_json(entry))["mae_deg"] == 180.0


def test_every_frame_is_in_its_document(scores):
    frames = report.frames_document([scores])["methods"]["fgrecon"]
    assert [frame["frame"] for frame in frames] == ["t:0", "t:1", "t:2", "t:3"]
    assert frames[0]["location"] == [1.0, 2.0, 3.0]
    assert frames[3]["translation_m"] is None
    assert frames[3]["failure"] == "FgreconError: no pose"
    assert report.to_json({"frames": frames})


def test_tables_show_the_same_cells(scores):
    lines = report.table([scores]).markdown().splitlines()
    assert lines[0].startswith("| method | N | mean ° | median ° | AOP 5° % |")
    cells = "fgrecon 4 50.00 9.00 50.0 75.0 75.0 1.00 6.67 2.00 1 car14 [v1]"
    assert lines[2].replace("| ", "").rstrip(" |") == cells
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(report.table([scores]).shown())
    row = next(line for line in console.export_text().splitlines() if "fgrecon" in line)
    assert " ".join(row.split()) == cells
