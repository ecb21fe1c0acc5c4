"""JSON that networks' libraries really write."""

import json
from pathlib import Path

import numpy as np
import pytest

import fgrecon
from fgrecon.io.images import write_png
from fgrecon.io.keypoints import read_any_keypoints
from tests.io.formats import CATEGORY
from tests.io.test_network_results import BOX, arrays, check


@pytest.mark.formats
def test_ultralytics_writes_what_is_read(devkit, tmp_path):
    points, trust = arrays()
    given = {"points": points.tolist(), "trust": trust.tolist(), "box": BOX.tolist()}
    for found in devkit("networks", "networks_write", given=json.dumps(given)).values():
        (vehicle,) = fgrecon.keypoints_from(found)
        check(vehicle, track=7)
    for name, score in (("scored", 0.9), ("plain", None)):
        write_png(tmp_path / f"{name}.png", np.zeros((375, 1242, 3), np.uint8))
        (vehicle,) = read_any_keypoints(tmp_path / f"{name}.txt", CATEGORY).instances
        check(vehicle, kind=None, score=score, track=7, off=0.01)


@pytest.mark.formats
def test_boxes_of_trackers_own_objects(devkit):
    said = devkit("trackers", "trackers_read", Path(fgrecon.__file__).parents[1])
    assert said.pop("empty") == []
    for name, found in said.items():
        ((corners, kind, score, track),) = found
        assert np.abs(np.array(corners) - [10.0, 20.0, 110.0, 80.0]).max() < 0.01, name
        assert (kind, score) == ("car", 0.5), name
        assert (track is not None) == (name != "norfair detections"), name
