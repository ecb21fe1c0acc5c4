"""Priors on coefficients and offsets."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.keys import L, O
from factors.shape_prior import coefficients_prior, offsets_prior


def test_energies():
    values = gtsam.Values()
    values.insert(L(), np.array([1.0, -2.0]))
    values.insert(O(), np.array([0.1, 0.0, 0.2, 0.0, 0.3, 0.0]))
    assert coefficients_prior(L(), 2).error(values) == pytest.approx(0.5 * 5)
    assert coefficients_prior(L(), 2, 2.0).error(values) == pytest.approx(0.5 * 5 / 4)
    assert offsets_prior(O(), [0.1, 0.2]).error(values) == pytest.approx(0.5 * (1 + 4 + 2.25))
    each = np.array([[0.1, 1.0, 0.2], [1.0, 0.1, 1.0]])
    assert offsets_prior(O(), each).error(values) == pytest.approx(0.5 * (1 + 1 + 9))


@pytest.mark.parametrize(
    "call",
    [
        lambda: coefficients_prior(L(), 0),
        lambda: coefficients_prior(L(), 3, 0.0),
        lambda: offsets_prior(O(), [0.1, 0.0]),
        lambda: offsets_prior(O(), []),
        lambda: offsets_prior(O(), [np.nan]),
        lambda: offsets_prior(O(), np.full((2, 2), 0.1)),
        lambda: offsets_prior(O(), np.array([[0.1, 0.1, 0.0]])),
    ],
)
def test_bad_input(call):
    with pytest.raises(InvalidInputError):
        call()
