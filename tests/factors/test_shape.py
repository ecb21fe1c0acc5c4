"""The linear shape: values, derivative, caching."""

import gtsam
import numpy as np
import pytest

from factors.errors import InvalidInputError
from factors.keys import L, O
from factors.shape import LinearShape
from tests.factors.support import bound_shape, car_like


@pytest.mark.parametrize("with_offsets", [False, True])
def test_points_and_derivative(with_offsets):
    shape, values = bound_shape(np.random.default_rng(0), with_offsets=with_offsets)
    coefficients = values.atVector(L())
    expected = shape.mean + np.tensordot(coefficients, shape.basis, axes=1)
    variables = coefficients
    if with_offsets:
        expected = expected + values.atVector(O()).reshape(-1, 3)
        variables = np.append(coefficients, values.atVector(O()))
    np.testing.assert_allclose(shape.points(values), expected, atol=1e-14)
    np.testing.assert_allclose(shape.mean + shape.derivative @ variables, expected, atol=1e-14)


def test_constants():
    rng = np.random.default_rng(1)
    mean, basis = car_like(rng)
    coefficients, offsets = rng.normal(size=5), rng.normal(size=(14, 3))
    expected = mean + np.tensordot(coefficients, basis, axes=1) + offsets
    values = gtsam.Values()
    values.insert(L(), coefficients)
    values.insert(O(), offsets.ravel())
    for c, o in ((coefficients, offsets), (L(), offsets), (coefficients, O()), (L(), O())):
        shape = LinearShape(mean, basis, c, o)
        np.testing.assert_allclose(shape.points(values), expected, atol=1e-14)
        assert shape.dims == (5,) * isinstance(c, int) + (42,) * isinstance(o, int)
        assert shape.derivative.shape == (14, 3, sum(shape.dims))


def test_cache_is_never_stale():
    shape, values = bound_shape(np.random.default_rng(2), with_offsets=True)
    first = shape.points(values)
    assert shape.points(gtsam.Values(values)) is first
    for key in (L(), O()):
        changed = gtsam.Values(values)
        vector = values.atVector(key)
        vector[-1] += 1e-9
        changed.update(key, vector)
        assert np.abs(shape.points(changed) - first).max() > 1e-11
    np.testing.assert_array_equal(shape.points(values), first)
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"mean": np.zeros((14, 2))}, "mean"),
        ({"mean": np.zeros((0, 3)), "basis": np.zeros((5, 0, 3))}, "mean"),
        ({"basis": np.zeros((5, 13, 3))}, "basis"),
        ({"basis": np.full((5, 14, 3), np.nan)}, "basis"),
        ({"coefficients": np.zeros(4)}, "coefficients"),
        ({"basis": np.zeros((0, 14, 3)), "coefficients": L()}, "coefficients"),
        ({"offsets": np.zeros((13, 3))}, "offsets"),
        ({"mean": "car"}, "mean"),
    ],
)
def test_bad_input(change, field):
    mean, basis = car_like(np.random.default_rng(3))
    with pytest.raises(InvalidInputError) as error:
        LinearShape(**{"mean": mean, "basis": basis, "coefficients": np.zeros(5), **change})
    assert error.value.field == field
