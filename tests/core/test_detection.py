"""What a detection says of the side that a vehicle is seen from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgrecon.core.detection import Detection, at_direction
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation

SEEN = Observation(np.array([[1.0, 2.0], [30.0, 4.0], [5.0, 60.0]]), np.ones(3))


def towards(degrees, bins=36):
    azimuth = np.zeros(bins)
    azimuth[round(degrees / 360.0 * bins) % bins] = 1.0
    return Detection(SEEN, azimuth)


@pytest.mark.parametrize(
    ("degrees", "front", "left"),
    [(0, 1, 0.5), (80, 1, 1), (90, 0.5, 1), (100, 0, 1), (180, 0, 0.5), (-90, 0.5, 0), (-30, 1, 0), (-170, 0, 0)],
)
def test_sides_of_one_direction(degrees, front, left):
    detection = towards(degrees)
    assert detection.front_probability == pytest.approx(front)
    assert detection.left_probability == pytest.approx(left)


def test_without_directions_there_is_no_side():
    assert Detection(SEEN).front_probability is None
    assert Detection(SEEN).left_probability is None


@given(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=40).filter(lambda values: sum(values) > 1e-3))
def test_a_mirror_image_keeps_the_front_and_swaps_the_sides(values):
    azimuth = np.array(values) / sum(values)
    here, mirrored = Detection(SEEN, azimuth), Detection(SEEN, np.roll(azimuth[::-1], 1))
    assert mirrored.front_probability == pytest.approx(here.front_probability)
    assert mirrored.left_probability == pytest.approx(1.0 - here.left_probability)


def test_between_two_directions_lies_what_is_between_their_values():
    values, width = np.array([1.0, 5.0, 2.0, 4.0]), np.pi / 2.0
    found = at_direction(values, width * np.array([0.0, 1.0, 1.5, 3.5, -0.5, -1e-20, 4.25]))
    np.testing.assert_allclose(found, [1.0, 5.0, 3.5, 2.5, 2.5, 1.0, 2.0])


@pytest.mark.parametrize("kinds", [{"car": 0.5, "van": 0.4}, {"car": 1.2, "van": -0.2}, {"car": float("nan")}])
def test_kinds_are_probabilities(kinds):
    assert Detection(SEEN, kinds={"car": 0.25, "van": 0.75}).kinds == {"car": 0.25, "van": 0.75}
    with pytest.raises(InvalidInputError, match="kinds"):
        Detection(SEEN, kinds=kinds)
