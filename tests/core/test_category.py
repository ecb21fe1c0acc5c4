"""Categories: the shipped files, and errors that name the field."""

import json

import numpy as np
import pytest

from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from tests.conftest import REPOSITORY

FILE = REPOSITORY / "fgrecon/data/categories/car14.json"

_FOUR = ["left_front_wheel", "right_front_wheel", "left_back_wheel", "right_back_wheel"]


@pytest.fixture
def content():
    return json.loads(FILE.read_text())


def test_car14_round_trip(content):
    category = Category.from_dict(content)
    assert category.size == 14
    assert Category.from_dict(category.to_dict()) == category


def test_mirror_is_an_involution(content):
    mirror = Category.from_dict(content).mirror
    assert (mirror[mirror] == np.arange(14)).all()
    assert (mirror != np.arange(14)).all()


def test_mirrors_are_on_no_face(content):
    category = Category.from_dict(content)
    assert [category.keypoints[i] for i in category.off_faces] == ["left_side_mirror", "right_side_mirror"]


def test_dimensions_of_a_box_with_known_size(content):
    category = Category.from_dict(content)
    shape = np.zeros((14, 3))
    for dimension, axis, sign in zip(category.dimensions, (0, 2, 1), (1, 1, -1), strict=True):
        shape[list(dimension.plus), axis] += sign * dimension.ratio * 2.0
        shape[list(dimension.minus), axis] -= sign * dimension.ratio * 2.0
    assert np.tensordot(category.dimension_operator, shape, axes=2) == pytest.approx([4.0, 4.0, 4.0])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"keypoints": ["a", "a", "b", "c"]}, "category.keypoints"),
        ({"edges": [["left_front_wheel", "nose"]]}, "category.edges"),
        ({"symmetric_pairs": [["left_front_wheel", "right_front_wheel"]] * 2}, "category.symmetric_pairs"),
        ({"faces": [{"name": "f", "keypoints": ["left_front_wheel"]}]}, "category.faces.f"),
        ({"dimensions": {}}, "category.dimensions.length"),
        ({"name": 3}, "category.name"),
        ({"neighbors": {}}, "category"),
        ({"neighbours": {"nose": ["left_front_wheel"]}}, "category.neighbours"),
        ({"ground": {"keypoints": ["left_front_wheel"], "ratio": 0.2, "height": 1}}, "category.ground"),
        ({"faces": [{"name": "f", "keypoints": _FOUR, "rectangle": True}]}, "category.faces.f"),
        ({"faces": [{"name": "f", "keypoints": _FOUR, "ground_parallel": "no"}]}, "category.faces.f.ground_parallel"),
    ],
)
def test_errors_name_the_field(content, change, field):
    with pytest.raises(InvalidInputError) as error:
        Category.from_dict({**content, **change})
    assert error.value.field == field
