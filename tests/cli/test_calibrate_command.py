"""`fgrecon calibrate` from the outside, and what it writes in a solve."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.detector_calibration import load_calibration

pytest.importorskip("torch")


def run(*arguments):
    return CliRunner().invoke(main.app, [str(argument) for argument in arguments])


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
    told = ("--calib", tmp_path / "sample" / "calib.txt", "--camera-height", 1.65, "--json", "-")
    wide = tmp_path / "wide.json"
    wide.write_text(json.dumps(json.loads(out.read_text()) | {"common_factor": 300.0}))
    plain, changed = (json.loads(run(*street, *told, *more).stdout) for more in ((), ("--calibration", wide)))
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
