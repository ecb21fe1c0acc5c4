"""`fgrecon calibrate` from the outside, and what it writes in a solve."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_calibration, load_prior
from research.tests.annotation.streets import Car, write_drive
from tests.calibration.test_detector_fit import boxes
from tests.command_line import run

pytest.importorskip("torch")


@pytest.mark.data
@pytest.mark.slow
def test_a_drive_calibrates_the_network_and_a_solve_uses_it(data, tmp_path):
    out = tmp_path / "detector.json"
    drive = data / "kitti_video" / "kitti_tracking_0001"
    done = run("calibrate", drive, "--weights", "photographs", "--out", out)
    assert done.exit_code == 0, done.output
    assert "common_factor" in done.stdout
    fitted = load_calibration(out)
    assert 1.0 <= fitted.common_factor <= 32.0
    assert fitted.provenance["drives"] == ["kitti_tracking_0001"]
    assert run("sample", "--out", tmp_path / "sample", "-q").exit_code == 0
    street = ("reconstruct", tmp_path / "sample" / "street.png", "--boxes", tmp_path / "sample" / "boxes.txt")
    given = ("--calib", tmp_path / "sample" / "calib.txt", "--camera-height", 1.65, "--json", "-")
    wide = tmp_path / "wide.json"
    wide.write_text(json.dumps(json.loads(out.read_text()) | {"common_factor": 300.0}))
    plain, changed = (json.loads(run(*street, *given, *more).stdout) for more in ((), ("--calibration", wide)))
    assert "keypoints" not in plain["settings"]
    assert changed["settings"]["keypoints"]["common_factor"] == 300.0
    for first, second in zip(plain["instances"], changed["instances"], strict=True):
        before, after = first["result"], second["result"]
        assert before["camera_T_object"] == after["camera_T_object"]  # it moves no result
        turned = (np.trace(np.array(one["pose_covariance"])[:3, :3]) for one in (before, after))
        assert 1.5 * next(turned) < next(turned)


def test_what_cannot_be_used_is_refused_before_the_work(tmp_path):
    nowhere = run("calibrate", tmp_path, "--out", tmp_path / "none" / "detector.json")
    assert isinstance(nowhere.exception, InvalidInputError)
    assert nowhere.exception.field == "output"
    bad = tmp_path / "bad.json"
    bad.write_text("{}")
    refused = run("reconstruct", tmp_path / "cars.json", "--calibration", bad)
    assert isinstance(refused.exception, InvalidInputError)
    assert str(bad) in refused.exception.field


PRIOR = load_prior("car14")


def street(folder, *, occlusion=0, count=40):
    """A drive with a labelled car in each frame."""
    return write_drive(folder, PRIOR, [{1: Car((0.0, 1.6, 12.0), 0.4, occlusion=occlusion)}] * count)


@pytest.fixture
def passes(monkeypatch):
    """What the passes find, a factor each: so many vehicles, and boxes of so many of the labelled cars."""
    made = SimpleNamespace(vehicles=400, detected=40, factors=[])

    def score(request, advance, *, keypoints):
        factor = keypoints.common_factor
        made.factors.append(factor)
        corners = Car((0.0, 1.6, 12.0), 0.4).box(PRIOR)
        label = SimpleNamespace(kind="Car", occlusion=0, truncation=0.0, index=0)
        frames = [
            SimpleNamespace(drive="a", number=number, boxes=[label], sightings=[SimpleNamespace(box=corners)])
            for number in range(made.detected)
        ]
        return SimpleNamespace(
            boxes=boxes(factor, made.vehicles),
            frames=frames,
            drives=[None],
            request=request,
            networks=list,
            in_words=lambda: "1 drive.",
        )

    monkeypatch.setattr("fgrecon.calibration.calibrate.score_drives", score)
    return made


def test_what_cannot_be_fitted_does_not_take_the_rest_along(tmp_path, passes):
    drive, hidden = street(tmp_path / "a"), street(tmp_path / "b", occlusion=1)
    out = tmp_path / "detector.json"

    def calibrated(folder):
        passes.factors.clear()
        done = run("calibrate", folder, "--detect", "--out", out)
        assert done.exit_code == 0, done.output
        found = load_calibration(out)
        assert all(warning in " ".join(done.stderr.split()) for warning in found.provenance["warnings"])
        return found, found.provenance["warnings"]

    whole, warnings = calibrated(drive)
    assert (whole.boxes is not None, len(passes.factors), warnings) == (True, 6, [])
    assert whole.provenance["outlines"] == 40
    found, (warning,) = calibrated(hidden)
    assert (found.common_factor, found.boxes) == (whole.common_factor, None)
    assert "edges are could not be fitted: 0 labelled cars that are visible as a whole. Give drives with" in warning
    passes.detected = 7
    found, (warning,) = calibrated(drive)
    assert (found.common_factor, found.boxes) == (whole.common_factor, None)
    assert "7 detected cars that are visible as a whole" in warning
    passes.detected, passes.vehicles = 40, 20
    found, (warning,) = calibrated(drive)
    assert (found.numbers, found.boxes) == (type(found)().numbers, whole.boxes)
    assert "facings, could not be fitted: " in warning
    assert len(passes.factors) == 1
    assert "common_factor" not in run("calibrate", drive, "--detect", "--out", out).stdout
    out.unlink()
    for more in ((), ("--detect",)):  # nothing can be fitted
        passes.detected = 7
        refused = run("calibrate", drive, *more, "--out", out)
        assert isinstance(refused.exception, InvalidInputError)
        assert not out.exists()


def test_too_few_labels_are_refused_before_anything_is_looked_at(tmp_path, passes):
    refused = run("calibrate", street(tmp_path / "a", count=29), "--detect", "--out", tmp_path / "detector.json")
    assert isinstance(refused.exception, InvalidInputError)
    assert refused.exception.value == "29 labelled vehicles"
    assert passes.factors == []


def test_values_at_the_end_of_what_was_tried_are_warned_of(tmp_path, passes, monkeypatch):
    monkeypatch.setattr("tests.calibration.test_detector_fit.FACTOR", 500.0)
    done = run("calibrate", street(tmp_path / "a"), "--out", tmp_path / "detector.json")
    assert done.exit_code == 0, done.output
    assert "Warning: common_factor 32 is the largest that was tried" in " ".join(done.stderr.split())
    assert len(json.loads((tmp_path / "detector.json").read_text())["provenance"]["warnings"]) == 2
