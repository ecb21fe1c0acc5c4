"""Fitting a detector's calibration: recovered from boxes of known make, kept in a file, used by a solve."""

import json
from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.calibration.detector_fit import FACTORS, fit_detector
from fgrecon.calibration.labelled_boxes import SYSTEM, BoxOutcome, VideoBox
from fgrecon.core.coverage import SIGMAS
from fgrecon.core.detection import calibrated_facing
from fgrecon.core.detector_calibration import BoxSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options

FACTOR, BIAS, SLOPE = 5.0, -0.8, 0.7


def boxes(factor, count=4000, turns=True):
    """Boxes of three drives whose errors are as wide as with FACTOR, and whose directions err by BIAS and SLOPE."""
    rng = np.random.default_rng(3)
    made = []
    for number in range(count):
        p = rng.beta(4.0, 1.0)
        turned = turns and rng.random() > calibrated_facing(p, BIAS, SLOPE)
        squared = {"position": rng.chisquare(3) * FACTOR / factor, "yaw": rng.chisquare(1) * FACTOR / factor}
        found = BoxOutcome(
            *(180.0 if turned else 1.0, 0.5, None, "converged", None),
            squared={} if turned else squared,
            spread=dict.fromkeys(squared, factor**0.5),
            facing=p,
        )
        drive = "abc"[number % 3]
        truth = 1.0 - p if turned else p
        made.append(VideoBox(drive, 0, number, 0, "Car", 0.0, 0, 80.0, 10.0, 0.0, truth, {SYSTEM: found}))
    return made


def test_what_made_them_is_found():
    found = fit_detector({factor: boxes(factor) for factor in FACTORS}, {"drives": ["a", "b", "c"]})
    assert found.calibration.common_factor == pytest.approx(FACTOR, rel=0.1)
    assert found.calibration.facing_bias == pytest.approx(BIAS, abs=0.25)
    assert found.calibration.facing_slope == pytest.approx(SLOPE, abs=0.1)
    assert found.facing_error < 0.03
    for shares in found.inside.values():
        for level in SIGMAS:
            assert shares[level] == pytest.approx(level, abs=0.03)
    assert found.calibration.provenance["drives"] == ["a", "b", "c"]
    assert found.calibration.provenance["flipped"] == found.flipped > 100


@pytest.mark.parametrize("where", ["everywhere", "at one factor"])
def test_a_drive_without_a_vehicle_that_can_be_judged_is_no_part_of_the_test(where):
    """Of a drive whose vehicles are all flipped, or only with some factors, nothing can be said."""
    scored = {factor: boxes(factor) for factor in FACTORS}
    for factor, some in scored.items():
        for box in some:
            if box.drive == "c" and (where == "everywhere" or factor == FACTORS[2]):
                box.outcomes[SYSTEM] = replace(box.outcomes[SYSTEM], degrees=180.0, squared={}, spread={})
    found = fit_detector(scored, {})
    assert found.calibration.common_factor == pytest.approx(FACTOR, rel=0.1)
    assert found.inside["position"][SIGMAS[0]] == pytest.approx(SIGMAS[0], abs=0.04)


def test_an_end_of_what_was_tried_and_what_does_not_hold_are_said():
    assert fit_detector({factor: boxes(factor) for factor in FACTORS}, {}).warnings == ()
    wide = fit_detector({factor: boxes(factor / 100.0) for factor in FACTORS}, {})
    assert wide.calibration.common_factor == pytest.approx(FACTORS[-1])
    end, left_out = wide.warnings
    assert end.startswith("common_factor 32 is the largest that was tried; with it regions of 68 and 95 % hold ")
    assert left_out.startswith(
        "common_factor does not hold on drives left out of the fit: regions of 68 and 95 % hold "
    )
    percent = " and ".join(f"{100 * wide.inside['yaw'][level]:.0f}" for level in SIGMAS)
    assert f", {percent} % of the yaws there." in left_out
    provenance = wide.calibration.provenance
    assert provenance["warnings"] == list(wide.warnings)
    assert provenance["inside"]["yaw"] == {"0.68": wide.inside["yaw"][0.68], "0.95": wide.inside["yaw"][0.95]}
    (narrow,) = fit_detector({factor: boxes(factor * 100.0) for factor in FACTORS}, {}).warnings
    assert narrow.startswith("common_factor 1 is the smallest")
    single = {factor: [box for box in boxes(factor) if box.drive == "a"] for factor in FACTORS}
    (unknown,) = fit_detector(single, {}).warnings
    assert unknown.endswith("not known: no drive can be left out of the fit.")
    turned = {factor: boxes(factor) for factor in FACTORS}
    for box in turned[FACTORS[0]]:  # the surer the directions, the more are wrong
        found = box.outcomes[SYSTEM]
        box.outcomes[SYSTEM] = replace(found, facing=0.9 if found.degrees > 90.0 else 0.3)
    assert "facing_slope 0 is at an end of what was tried (0 to 10)." in fit_detector(turned, {}).warnings


def test_without_a_flipped_vehicle_the_facing_is_left():
    found = fit_detector({factor: boxes(factor, 200, turns=False) for factor in FACTORS}, {})
    assert found.warnings[0] == "The facing's numbers are the default ones: no vehicle is flipped."
    default = fgrecon.KeypointOptions()
    assert (found.calibration.facing_bias, found.calibration.facing_slope) == (
        default.facing_bias,
        default.facing_slope,
    )
    with pytest.raises(InvalidInputError, match="20 vehicles"):
        fit_detector({factor: boxes(factor, 20, turns=False) for factor in FACTORS}, {})


def test_the_file_and_the_options(tmp_path):
    one = fgrecon.DetectorCalibration(6.5, -0.2, 1.1, {"drives": ["a"]})
    path = fgrecon.save_calibration(one, tmp_path / "detector.json")
    assert fgrecon.load_calibration(path) == one
    keypoints = one.applied(Options()).keypoints
    assert (keypoints.common_factor, keypoints.facing_bias, keypoints.facing_slope) == (6.5, -0.2, 1.1)
    assert keypoints.sigma_relative == fgrecon.KeypointOptions().sigma_relative
    assert keypoints.fitted
    boxes_alone = fgrecon.DetectorCalibration(boxes=BoxSource()).applied(Options())
    assert not boxes_alone.keypoints.fitted  # its covariances are counted as the shipped networks'


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"format": "else"}, "format"),
        ({"common_factor": 0.5}, "common_factor"),
        ({"facing_slope": "x"}, "facing_slope"),
        ({"facing_bias": None}, "facing_bias"),
        ({"provenance": 3}, "provenance"),
    ],
)
def test_a_bad_file_is_refused(tmp_path, change, field):
    path = fgrecon.save_calibration(fgrecon.DetectorCalibration(), tmp_path / "detector.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InvalidInputError, match=field) as refused:
        fgrecon.load_calibration(path)
    assert str(path) in refused.value.field
