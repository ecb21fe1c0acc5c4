"""Each measure of research's tables on an example worked by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.errors import InvalidInputError
from fgrecon_research.evaluation import measures
from fgrecon_research.evaluation.text_table import number_or_dash

FIXED = settings(deadline=None, derandomize=True, max_examples=50)


def rotation(axis, angle):
    """Rotation about a coordinate axis, radians."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def test_orientation_precision_by_hand():
    errors = [1.0, 5.0, 14.0, 180.0]
    assert [measures.instances_within(errors, t) for t in (5, 15, 30)] == [2, 3, 3]
    assert [measures.orientation_precision(errors, t) for t in (5, 15, 30)] == [0.5, 0.75, 0.75]


def test_rotation_error_by_hand():
    # 90 degrees about y; then 90 about x after 90 about y, whose axis is a cube's diagonal: 120 degrees
    estimated = np.array(
        [rotation(1, np.pi / 2), rotation(0, np.pi / 2) @ rotation(1, np.pi / 2), np.full((3, 3), np.nan)]
    )
    assert measures.rotation_error(estimated, np.stack([np.eye(3)] * 3)) == pytest.approx([90.0, 120.0, 180.0])


@FIXED
@given(st.integers(0, 2), st.floats(0, np.pi))
def test_rotation_error_keeps_its_digits_near_0_and_180_degrees(axis, angle):
    base = rotation(0, 0.7) @ rotation(2, -1.1)
    error = measures.rotation_error([base @ rotation(axis, angle)], [base])[0]
    assert error == pytest.approx(np.degrees(angle), abs=1e-7)


def test_keypoint_error_by_hand():
    true = np.zeros((2, 2, 3))
    estimated = np.array([[[1.0, 2.0, 2.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, -0.5], [np.nan] * 3]])
    assert measures.keypoint_error(estimated, true).tolist() == [[3.0, 0.0], [0.5, np.inf]]


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: measures.orientation_precision([], 5), "errors"),
        (lambda: measures.rotation_error(np.zeros((1, 3, 3)), np.full((1, 3, 3), np.nan)), "true[0, 0, 0]"),
        (lambda: measures.keypoint_error(np.zeros((4, 3)), np.zeros((5, 3))), "estimated"),
    ],
)
def test_bad_input_names_the_field(call, field):
    with pytest.raises(InvalidInputError) as error:
        call()
    assert error.value.field == field


def test_a_number_that_nobody_knows_is_a_dash():
    assert number_or_dash(None, ".2f") == "-"
    assert number_or_dash(1.23, ".1f") == "1.2"
