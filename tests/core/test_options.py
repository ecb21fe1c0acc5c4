"""Settings are checked where they are made, and errors name the setting."""

import dataclasses

import numpy as np
import pytest

import fgrecon
from fgrecon.batch.reconstructor import Reconstructor
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import (
    BoxModel,
    BoxOptions,
    KeypointOptions,
    Options,
    SearchOptions,
    ShapeOptions,
    checked_options,
)
from fgrecon.core.robust import RobustStrategy, StrategyName, strategy
from fgrecon.perception.boxes import for_detected
from fgrecon.perception.from_image import reconstruct_detections
from tests.cars import CAMERA

PIXELS = np.full((14, 2), np.nan)
IMAGE = np.zeros((60, 80, 3), dtype=np.uint8)
GROUPS = {"keypoints": KeypointOptions, "box": BoxOptions, "search": SearchOptions, "shape": ShapeOptions}
NUMBERS = [
    (kind, group, field.name)
    for group, kind in GROUPS.items()
    for field in dataclasses.fields(kind)
    if field.type.startswith("float")
]
SIGNED = "facing_bias"
EDGES = "left", "upper", "right", "lower"
MAY_BE_ZERO = "relative", "common_error", "confidence", SIGNED, "facing_slope", *EDGES
POSITIVE = [entry for entry in NUMBERS if not entry[2].endswith(MAY_BE_ZERO)]


def test_defaults_are_valid_and_names_are_understood():
    assert Options().strategy.name is StrategyName.MIXTURE
    named = Options(strategy="tukey", box="cuboid", disabled_terms=["box", "ground"])
    assert named.strategy == RobustStrategy(StrategyName.TUKEY) == strategy("tukey")
    assert named.box == BoxOptions(BoxModel.CUBOID)
    assert named.disabled_terms == frozenset({"box", "ground"})
    assert dataclasses.replace(named, keep_history=False).box.model is BoxModel.CUBOID


@pytest.mark.parametrize(("kind", "group", "name"), NUMBERS)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, 1e300, "1", True])
def test_numbers_out_of_range_or_of_another_type(kind, group, name, value):
    if name == SIGNED and value == -1.0:
        value = -100.0
    with pytest.raises(InvalidInputError) as caught:
        kind(**{name: value})
    assert caught.value.field == f"options.{group}.{name}"


@pytest.mark.parametrize(("kind", "group", "name"), POSITIVE)
def test_standard_deviations_of_zero_are_refused(kind, group, name):
    with pytest.raises(InvalidInputError, match=f"options.{group}.{name}"):
        kind(**{name: 0.0})


@pytest.mark.parametrize("kind", [KeypointOptions, BoxOptions])
def test_zero_is_allowed_where_it_means_something(kind):
    assert kind(sigma_relative=0).sigma_relative == 0.0


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: SearchOptions(azimuths=0), "search.azimuths"),
        (lambda: SearchOptions(azimuths=361), "search.azimuths"),
        (lambda: SearchOptions(azimuths=24.0), "search.azimuths"),
        (lambda: ShapeOptions(basis_vectors=-1), "shape.basis_vectors"),
        (lambda: ShapeOptions(basis_vectors=1.5), "shape.basis_vectors"),
        (lambda: ShapeOptions(joint=1), "shape.joint"),
        (lambda: BoxOptions(model="sphere"), "box.model"),
        (lambda: Options(box="sphere"), "box"),
        (lambda: Options(box=3), "box"),
        (lambda: Options(shape=BoxOptions()), "shape"),
        (lambda: Options(disabled_terms={"planarity", "gravity"}), "disabled_terms"),
        (lambda: Options(disabled_terms="box"), "disabled_terms"),
        (lambda: Options(disabled_terms=3), "disabled_terms"),
        (lambda: Options(ambiguity_margin=-1.0), "ambiguity_margin"),
        (lambda: Options(keep_history="yes"), "keep_history"),
    ],
)
def test_choices(make, field):
    with pytest.raises(InvalidInputError) as caught:
        make()
    assert caught.value.field == f"options.{field}"


def test_an_unknown_strategy():
    for value in ("l1", 3, None):
        with pytest.raises(InvalidInputError, match="strategy: got"):
            Options(strategy=value)


def test_options_of_a_call():
    assert checked_options(None, joint=True) == Options()
    proposals = Options(shape=ShapeOptions(joint=False))
    assert checked_options(proposals) is proposals
    with pytest.raises(InvalidInputError, match=r"options\.shape\.joint"):
        checked_options(proposals, joint=True)


@pytest.mark.parametrize(
    "call",
    [
        lambda options: fgrecon.reconstruct(PIXELS, CAMERA, options=options),
        lambda options: fgrecon.reconstruct_track([], CAMERA, options=options),
        lambda options: fgrecon.reconstruct_scene([], CAMERA, options=options),
        lambda options: fgrecon.reconstruct_scenes([], CAMERA, options=options),
        lambda options: fgrecon.reconstruct_image(IMAGE, CAMERA, [], options=options),
        lambda options: fgrecon.refine_boxes(IMAGE, [], CAMERA, options=options),
        lambda options: reconstruct_detections([], CAMERA, options=options),
        for_detected,
        lambda options: Reconstructor(options=options),
    ],
)
@pytest.mark.parametrize("options", [3, "tukey", ShapeOptions()])
def test_whoever_takes_options_refuses_what_is_none(call, options):
    with pytest.raises(InvalidInputError) as caught:
        call(options)
    assert caught.value.field == "options"
