"""Pictures look as they did: each is compared with one that was looked at, so that no layout is lost unseen.

Both are made four times smaller first: other versions of matplotlib and its fonts move edges by less than a pixel. With
FGRECON_REFERENCES=1 in the environment the references are written anew; look at them before they are committed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.viz import SolvedVehicle, as_rgb, contact_sheet, picture, scene_picture
from tests.pictures import COLOURS, MEAN, WORST, check_like, differences
from tests.viz.made_up import Example
from tests.viz.scenes import GROUND, result_of, shown_of, street

FOLDER = Path(__file__).parent / "references"


def scene(example: Example):
    """Three cars of a street, one of them ambiguous."""
    seen = street()
    return scene_picture(seen.image, shown_of(example, seen), seen.camera, ground=GROUND)


def gain(example: Example):
    """The same with start and truth."""
    seen = street()
    return scene_picture(seen.image, shown_of(example, seen, truth=True), seen.camera, ground=GROUND, before=True)


def plain(example: Example):
    """The same without a photograph and a ground."""
    seen = street()
    return scene_picture(None, shown_of(example, seen), seen.camera)


def stages(example: Example):
    """The stages of one car."""
    return picture(SolvedVehicle(example.reconstruction, example.observation, example.camera, truth=example.truth))


def models(example: Example):
    """The closest car models, here the cars' own shapes, over the photograph."""
    seen = street()
    vehicles = [
        replace(shown, model=VehicleMesh(f"model {i}", car.truth.vehicle.vertices, car.truth.vehicle.faces))
        for i, (shown, car) in enumerate(zip(shown_of(example, seen), seen.cars, strict=True))
    ]
    return scene_picture(seen.image, vehicles, seen.camera, ground=GROUND)


def sheet(example: Example):
    """A cell for each car."""
    seen = street()
    sights = [
        SolvedVehicle(result_of(example, car), car.observation, seen.camera, seen.image, title="car")
        for car in seen.cars
    ]
    return contact_sheet(sights, columns=2)


DRAWN = {
    function.__name__: (function, dpi)
    for function, dpi in ((scene, 150), (gain, 150), (plain, 150), (models, 150), (stages, 75), (sheet, 75))
}


def pixels(figure, dpi) -> np.ndarray:
    return np.asarray(Image.fromarray(as_rgb(figure, dpi)).quantize(COLOURS).convert("RGB"))


@pytest.fixture(scope="module", params=DRAWN)
def drawn(request, example):
    """Name and pixels of a picture."""
    function, dpi = DRAWN[request.param]
    return request.param, pixels(function(example), dpi)


def test_it_looks_as_it_did(drawn):
    name, image = drawn
    check_like(FOLDER / f"{name}.png", image)


def test_a_lost_panel_is_seen(drawn, example):
    """What these limits are for: without any one of its panels a picture is beyond them."""
    name, image = drawn
    function, dpi = DRAWN[name]
    for index in range(len(function(example).axes)):
        figure = function(example)
        figure.axes[index].remove()
        mean, worst = differences(pixels(figure, dpi), image)
        assert mean > MEAN or worst > WORST, f"{name}, panel {index}: {mean:.2f}, {worst:.2f}"
