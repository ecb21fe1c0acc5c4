"""Arguments of factors are checked, copied and named in errors."""

import numpy as np
import pytest

from factors.checks import finite_array, index_array, unit_vector
from factors.errors import InvalidInputError


def test_arrays_are_copied():
    given = np.zeros((2, 3))
    array = finite_array("field", given, (None, 3))
    given[0, 0] = 7
    assert not array.any()
    assert array.dtype == np.float64
    assert finite_array("field", 3, ()) == 3.0


@pytest.mark.parametrize(
    "value", [np.zeros(3), np.zeros((2, 4)), [[0, 0, np.nan]], [[0, 0, np.inf]], "x", [[1, 2], [3]]]
)
def test_wrong_arrays(value):
    with pytest.raises(InvalidInputError) as error:
        finite_array("field", value, (None, 3))
    assert error.value.field == "field"


def test_indices():
    np.testing.assert_array_equal(index_array("field", (2, 0), 3), [2, 0])


@pytest.mark.parametrize("value", [[], [0, 0], [-1], [3], [0.0], [[0]], 1, [True]])
def test_wrong_indices(value):
    with pytest.raises(InvalidInputError) as error:
        index_array("field", value, 3)
    assert error.value.field == "field"


def test_unit_vector():
    np.testing.assert_allclose(unit_vector("field", [0, 3, 4]), [0, 0.6, 0.8])
    with pytest.raises(InvalidInputError):
        unit_vector("field", [0, 0, 1e-12])
