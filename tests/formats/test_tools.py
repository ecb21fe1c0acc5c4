"""Annotation tools' files as their own libraries understand them."""

import json

import numpy as np
import pytest

import fgrecon
from tests.io.test_tool_keypoints import task


@pytest.mark.formats
@pytest.mark.parametrize("rotation", [0.0, 30.0, 200.0])
def test_label_studio_turns_rectangles_so(devkit, rotation):
    tasks = task(rotation=rotation)
    first = tasks[0]["annotations"][0]["result"][0]
    sizes = {name: first[name] for name in ("original_width", "original_height")}
    corners = np.array(devkit("label_studio", "label_studio_turns", given=json.dumps(first["value"] | sizes)))
    (vehicle,) = fgrecon.keypoints_from(tasks)
    around = [*corners.min(axis=0), *corners.max(axis=0)]
    assert np.abs(vehicle.observation.box - around).max() < 1e-6
