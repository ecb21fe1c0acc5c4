"""What arrays are checked for."""

import numpy as np
import pytest

from fgrecon.core.checks import as_finite, as_flag, as_rigid
from fgrecon.core.errors import InvalidInputError
from tests.cars import yaw_pose

POSE = yaw_pose(0.7, np.array([1.0, 2.0, 30.0]))


def _with(row, column, value):
    matrix = POSE.copy()
    matrix[row, column] = value
    return matrix


def test_a_rigid_motion_is_taken_as_it_is():
    np.testing.assert_array_equal(as_rigid("pose", POSE, 1e-9), POSE)
    rounded = np.round(POSE, 3)
    np.testing.assert_array_equal(as_rigid("pose", rounded.tolist(), 1e-2), rounded)
    with pytest.raises(InvalidInputError):
        as_rigid("pose", rounded, 1e-5)


@pytest.mark.parametrize(
    "matrix",
    [
        POSE @ np.diag([1.0, 1.0, -1.0, 1.0]),
        -POSE,
        POSE @ np.diag([1.1, 1.0, 1.0, 1.0]),
        _with(0, 0, 1e200),
        _with(3, 1, 0.1),
        _with(3, 3, 2.0),
        _with(2, 3, np.nan),
        _with(0, 0, np.inf),
        POSE[:3],
        "here",
    ],
)
def test_what_is_no_rigid_motion_is_named(matrix):
    with pytest.raises(InvalidInputError, match=r"pose.*rigid motion"):
        as_rigid("pose", matrix, 1e-2)


class _WithGradient:
    """What a tensor does that belongs to a graph of gradients."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


def test_what_makes_no_array_is_named():
    with pytest.raises(InvalidInputError, match=r"^keypoints"):
        as_finite("keypoints", _WithGradient(), (14, 2))


@pytest.mark.parametrize(
    ("check", "text"),
    [
        (lambda text: as_finite("ground", text, (), "Give metres."), "1.65"),
        (lambda text: as_flag("together", text), "True"),
    ],
)
def test_a_text_that_looks_like_what_is_wanted_is_named(check, text):
    with pytest.raises(InvalidInputError, match=f'got the text "{text}"[.] Give'):
        check(text)
