"""What results say of themselves, from scored boxes of known make."""

import json

import pytest

from fgrecon.calibration.labelled_boxes import BoxOutcome, VideoBox
from fgrecon.core.coverage import reliability
from fgrecon.viz import save_picture
from fgrecon_research.evaluation.calibration import calibrate_boxes, calibration_document
from fgrecon_research.viz.calibration_picture import calibration_picture


def box(degrees, metres, status="converged", *, drive="a", facing=0.9, squared=None):
    errors = {"position": 2.0, "yaw": 0.5} if squared is None else squared
    spread = {"position": 0.3, "yaw": 1.5}
    outcome = BoxOutcome(degrees, metres, None, status, None, squared=errors, spread=spread, facing=facing)
    return VideoBox(drive, 0, 0, 0, "Car", 0.0, 0, 80.0, 10.0, 0.0, 0.9, {"system": outcome})


BOXES = [
    box(1.0, 0.5),
    box(2.0, 2.5, drive="b"),  # farther off than 20 % of 10 m
    box(20.0, 0.5, "weak", facing=None),
    box(179.0, 0.5, "ambiguous", facing=0.6, squared={}),
    box(180.0, float("inf"), None, facing=None, squared={}),  # refused: it claims nothing
]


def test_statuses_facings_and_regions():
    found = calibrate_boxes(BOXES, "system")
    assert [(s.status, s.count, s.flipped, s.wrong) for s in found.statuses] == [
        ("ambiguous", 1, 1, 1),
        ("converged", 2, 0, 1),
        ("weak", 1, 0, 1),
    ]
    assert found.facing.count.sum() == 3
    assert found.facing.error == pytest.approx(reliability([0.9, 0.9, 0.6], [True, True, False]).error)
    assert [(one.quantity, one.count) for one in found.regions] == [("position", 3), ("yaw", 3)]
    position = found.regions[0]
    assert position.inside[0.68]["claimed"] == 1.0  # 2.0 of the 3.5 that hold 68 % in three dimensions
    assert position.width[0.95]["claimed"] == pytest.approx(0.3 * 7.81**0.5, rel=1e-3)


def test_what_it_costs_to_take_sure_facings_alone():
    found = calibrate_boxes([*BOXES, box(170.0, 0.5, facing=0.97), box(1.0, 0.5, facing=1.0)], "system")
    counts = [
        (one.least, one.flipped_refused, one.right_refused, one.sure, one.sure_flipped) for one in found.acceptance
    ]
    assert counts == [(0.9, 1, 0, 4, 1), (0.95, 1, 2, 2, 1), (0.99, 2, 2, 1, 0)]
    assert {(one.flipped, one.right) for one in found.acceptance} == {(2, 4)}
    document = json.loads(json.dumps(calibration_document(found, {}), allow_nan=False))
    assert document["acceptance"][0]["sure_flipped"] == 1


def test_the_document_is_json_and_the_picture_is_drawn(tmp_path):
    found = calibrate_boxes(BOXES[:1], "system")  # one drive: no baseline
    document = json.loads(json.dumps(calibration_document(found, {"method": "system"}), allow_nan=False))
    assert document["format"] == "fgrecon.calibration/1"
    assert document["method"] == "system"
    assert document["regions"][0]["inside"]["0.68"] == {"claimed": 1.0, "scaled": None, "constant": None}
    figure = calibration_picture(found.regions, found.facing)
    left, right = figure.axes
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["position (1)", "yaw (1)"]
    assert "1 results" in right.texts[0].get_text()
    assert save_picture(tmp_path / "c.svg", figure).stat().st_size > 5000
    nothing = calibration_picture((), None)
    assert nothing.axes[1].texts[0].get_text() == "no directions"
