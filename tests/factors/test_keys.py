"""Keys carry vehicle and frame, and can be read back."""

import gtsam
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import InvalidInputError
from factors.keys import L, M, O, P, S, X, decode_key, key_name

vehicles = st.integers(0, 2**24 - 1)
lows = st.integers(0, 2**32 - 1)


@settings(deadline=None, derandomize=True)
@given(vehicles, lows)
def test_round_trip(vehicle, low):
    assert decode_key(X(vehicle, low)) == ("X", vehicle, low)
    assert decode_key(P(vehicle, low)) == ("P", vehicle, low)
    for make, letter in ((L, "L"), (O, "O"), (M, "M")):
        assert decode_key(make(vehicle)) == (letter, vehicle, 0)


def test_keys_differ():
    keys = [make(v, i) for make in (X, P) for v in range(3) for i in range(3)]
    keys += [make(v) for make in (L, O, M) for v in range(3)]
    assert len(set(keys)) == len(keys)


def test_keys_work_in_values():
    values = gtsam.Values()
    values.insert(X(3, 7), gtsam.Pose3())
    assert [key_name(k) for k in list(values.keys())] == ["X(v=3,t=7)"]


def test_the_fleet_is_no_vehicle():
    assert decode_key(S()) == ("S", 0, 0)
    assert key_name(S()) == "S()"


def test_names():
    assert [key_name(k) for k in (X(), L(2), O(1), P(1, 4), M())] == [
        "X(v=0,t=0)",
        "L(v=2)",
        "O(v=1)",
        "P(v=1,f=4)",
        "M(v=0)",
    ]


@pytest.mark.parametrize(
    ("make", "arguments", "field"),
    [(X, (-1,), "vehicle"), (L, (2**24,), "vehicle"), (X, (0, -1), "t"), (P, (0, 2**32), "face")],
)
def test_limits(make, arguments, field):
    with pytest.raises(InvalidInputError) as error:
        make(*arguments)
    assert error.value.field == field
