"""Boxes that are all wrong alike are reported; right ones, single wrong ones and those of few vehicles are not."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.options import BoxModel, Options
from fgrecon.solve.scene import reconstruct_scene
from fgrecon.solve.tracker import Tracker
from tests.cars import CAMERA
from tests.solve.test_scene import street


def scaled(observation, factor):
    low, high = observation.box[:2], observation.box[2:]
    middle, half = (low + high) / 2.0, factor * (high - low) / 2.0
    return replace(observation, box=np.concatenate([middle - half, middle + half]))


def message(factors, *, box=BoxModel.SURFACE):
    _, seen = street(5, count=len(factors))
    seen = [scaled(one, factor) for one, factor in zip(seen, factors, strict=True)]
    options = Options(keep_history=False, box=box)
    return reconstruct_scene(seen, CAMERA, ground=1.65, size_prior="kitti", options=options).message


@pytest.mark.parametrize(("factor", "word"), [(1.2, "larger"), (0.8, "smaller")])
def test_boxes_that_are_all_wrong_alike_are_reported(factor, word):
    warning = message([factor] * 6)
    assert f"% {word} than their vehicles look" in warning
    percent = float(warning.split("The boxes are ")[1].split(" %")[0])
    assert 5.0 < percent <= 20.0  # the boxes pull their vehicles towards them


@pytest.mark.parametrize(
    ("factors", "box"),
    [
        ([1.0] * 6, BoxModel.SURFACE),
        ([1.2, 1.2, 1.0, 1.0, 1.0, 1.0], BoxModel.SURFACE),
        ([1.2] * 4, BoxModel.SURFACE),  # too few
        ([1.2] * 6, BoxModel.OFF),
    ],
)
def test_others_are_not(factors, box):
    assert "boxes" not in message(factors, box=box)


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_boxes_that_the_image_cuts_off_tell_nothing():
    _, seen = street(5, count=6)
    seen = [scaled(one, 1.2) for one in seen]
    right = max(one.box[2] for one in seen)
    width = int(min(one.box[2] for one in seen))  # all reach beyond the border but one
    camera = replace(CAMERA, image_size=(width, 375))
    assert width < right
    scene = reconstruct_scene(seen, camera, ground=1.65, size_prior="kitti", options=Options(keep_history=False))
    assert "boxes" not in scene.message


@pytest.mark.parametrize(("factor", "smaller"), [(0.8, True), (1.0, False)])
def test_a_video_tells_as_well(factor, smaller):
    tracker = Tracker(size_prior="kitti", options=Options(keep_history=False))
    _, seen = street(5, count=6)
    for time in (0.0, 0.1, 0.2):
        tracker.update(time, {i: scaled(one, factor) for i, one in enumerate(seen)}, camera=CAMERA, ground=1.65)
    off = tracker.boxes_off()
    assert (off is not None and -0.2 < off < -0.05) if smaller else off is None
    for vehicle in (0, 3, 3, 99):
        tracker.forget(vehicle)
    assert tracker.boxes_off() == off
    assert Tracker().boxes_off() is None
