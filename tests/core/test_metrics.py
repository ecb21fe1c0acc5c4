"""Each measure on an example worked by hand, and what a failure counts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core import metrics
from fgrecon.core.errors import InvalidInputError

FIXED = settings(deadline=None, derandomize=True, max_examples=50)
ANGLES = st.floats(-50.0, 50.0)


def test_orientation_error_by_hand():
    # 10 degrees across the seam at +-180, a reversed car (180, not 0), 30 degrees, a failure
    estimated = np.radians([175.0, 0.0, -90.0, np.nan])
    true = np.radians([-175.0, 180.0, -120.0, 20.0])
    assert metrics.orientation_error(estimated, true) == pytest.approx([10.0, 180.0, 30.0, 180.0])


@FIXED
@given(ANGLES, ANGLES, st.integers(-3, 3))
def test_orientation_error_is_a_distance_on_the_circle(a, b, turns):
    error = metrics.orientation_error([a], [b])[0]
    assert 0 <= error <= 180
    assert metrics.orientation_error([b], [a])[0] == pytest.approx(error, abs=1e-9)
    assert metrics.orientation_error([a + 2 * np.pi * turns], [b])[0] == pytest.approx(error, abs=1e-9)
    assert metrics.orientation_error([a + np.pi], [b])[0] == pytest.approx(180 - error, abs=1e-9)


def test_translation_error_by_hand():
    estimated = [[3.0, 4.0, 0.0], [1.0, 1.0, 1.0], [np.nan] * 3]
    true = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 9.0]]
    errors = metrics.translation_error(estimated, true)
    assert errors.tolist() == [5.0, 0.0, np.inf]
    assert np.median(errors) == 5.0


def test_hausdorff_distance_by_hand():
    # every point of the first set lies in the second, whose last point is 2 m from the nearest one of the first
    first = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    second = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0]]
    assert metrics.hausdorff_distance(first, second) == 2.0
    assert metrics.hausdorff_distance(second, first) == 2.0
    assert metrics.hausdorff_distance(first, first) == 0.0


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: metrics.orientation_error([0.0, 1.0], [0.0]), "estimated"),
        (lambda: metrics.orientation_error([0.0], [np.nan]), "true[0]"),
        (lambda: metrics.translation_error(np.zeros((1, 2)), np.zeros((1, 3))), "estimated"),
        (lambda: metrics.hausdorff_distance(np.zeros((0, 3)), np.zeros((1, 3))), "first"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(InvalidInputError) as error:
        call()
    assert error.value.field == field


def test_average_precision_by_hand():
    # right, wrong, right, of three: precision 1 up to a third, 2/3 up to two thirds, then nothing
    assert metrics.average_precision([0.9, 0.8, 0.7], [True, False, True], 3) == pytest.approx(5 / 9)
    assert metrics.average_precision([0.7, 0.9, 0.8], [True, True, False], 3) == pytest.approx(5 / 9)
    # a precision is the largest from there on: wrong, right, right
    assert metrics.average_precision([0.9, 0.8, 0.7], [False, True, True], 2) == pytest.approx(2 / 3)
    # equal scores count together, in whatever order they come
    for right in ([True, False], [False, True]):
        assert metrics.average_precision([0.5, 0.5], right, 1) == pytest.approx(0.5)
    assert metrics.average_precision([], [], 2) == 0.0
    assert np.isnan(metrics.average_precision([0.5], [False], 0))
    for scores, right, total in (([np.nan], [True], 1), ([0.5], [True, False], 1), ([0.5, 0.4], [True, True], 1)):
        with pytest.raises(InvalidInputError):
            metrics.average_precision(scores, right, total)
