"""How a category's vehicles move: from its file and back, and what is refused."""

import pytest

from fgrecon.core.category import Category, MotionModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_category


@pytest.fixture
def content():
    return load_category("car14").to_dict()


def test_a_category_says_how_its_vehicles_move(content):
    assert Category.from_dict(content).motion == MotionModel()
    assert "motion" not in Category.from_dict(content).to_dict()
    sliding = Category.from_dict({**content, "motion": {"wheeled": False, "acceleration": 4}})
    assert sliding.motion == MotionModel(wheeled=False, acceleration=4.0)
    assert Category.from_dict(sliding.to_dict()) == sliding


@pytest.mark.parametrize("motion", [3, {"speed": 1.0}, {"acceleration": 0.0}, {"wheeled": "yes"}])
def test_what_cannot_be_used_is_refused(content, motion):
    with pytest.raises(InvalidInputError, match=r"category\.motion"):
        Category.from_dict({**content, "motion": motion})
