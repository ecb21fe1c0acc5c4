"""JSON that networks' libraries really write."""

import json

import pytest

import fgrecon
from tests.io.test_network_results import BOX, arrays, check


@pytest.mark.formats
def test_ultralytics_writes_what_is_read(devkit):
    points, trust = arrays()
    given = {"points": points.tolist(), "trust": trust.tolist(), "box": BOX.tolist()}
    for found in devkit("networks", "networks_write", given=json.dumps(given)).values():
        (vehicle,) = fgrecon.keypoints_from(found)
        check(vehicle, track=7)
