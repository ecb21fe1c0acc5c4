"""Settings are checked where they are made, and errors name the setting."""

import dataclasses

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.robust import RobustStrategy, StrategyName

POSITIVE = [f.name for f in dataclasses.fields(Options) if f.name.endswith(("sigma", "_pixels", "_midpoint"))]
NOT_NEGATIVE = ["sigma_relative", "box_sigma_relative", "ambiguity_margin"]


def test_defaults_are_valid_and_names_are_understood():
    assert Options().strategy.name is StrategyName.MIXTURE
    named = Options(strategy="tukey", box_model="cuboid", disabled_terms=["box", "ground"])
    assert named.strategy == RobustStrategy(StrategyName.TUKEY, tuning=4.685)
    assert named.box_model is BoxModel.CUBOID
    assert named.disabled_terms == frozenset({"box", "ground"})


@pytest.mark.parametrize("name", [*POSITIVE, *NOT_NEGATIVE])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_numbers_out_of_range(name, value):
    with pytest.raises(InvalidInputError) as caught:
        Options(**{name: value})
    assert caught.value.field == f"options.{name}"


@pytest.mark.parametrize("name", POSITIVE)
def test_standard_deviations_of_zero_are_refused(name):
    with pytest.raises(InvalidInputError, match=f"options.{name}"):
        Options(**{name: 0.0})


@pytest.mark.parametrize("name", NOT_NEGATIVE)
def test_zero_is_allowed_where_it_means_something(name):
    assert getattr(Options(**{name: 0.0}), name) == 0.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("azimuths", 0),
        ("azimuths", 361),
        ("basis_vectors", -1),
        ("box_model", "sphere"),
        ("plane_penalty", 0.0),
        ("plane_penalty", np.nan),
        ("disabled_terms", {"planarity", "gravity"}),
    ],
)
def test_choices(field, value):
    with pytest.raises(InvalidInputError) as caught:
        Options(**{field: value})
    assert caught.value.field == f"options.{field}"


def test_an_unknown_strategy():
    with pytest.raises(InvalidInputError, match="strategy: got l1"):
        Options(strategy="l1")
