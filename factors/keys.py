"""Keys of the graph's variables: one letter, one vehicle, and a frame or a face.

Every key carries its vehicle, and a pose its frame, so that a graph over many vehicles and frames has the same factors
as one over a single image, with more keys. A key is a GTSAM symbol: 8 bits for the letter and 56 for an index, which
holds the vehicle in its upper 24 bits and the frame or face in its lower 32.

=========  ==================  ==============================================  ======================
key        type in `Values`    meaning                                         unit
=========  ==================  ==============================================  ======================
``X(v,t)`` ``Pose3``           camera_T_object of vehicle v in frame t         radians, metres
``L(v)``   vector (N,)         shape coefficients lambda                       standard deviations
``O(v)``   vector (3K,)        free offsets, (K, 3) flattened row by row       metres, object frame
``P(v,f)`` ``OrientedPlane3``  plane of face f, n'X + d = 0                    metres, object frame
``M(v)``   ``OrientedPlane3``  medial plane, n'X + d = 0                       metres, object frame
``G(t)``   vector (3,)         ground of frame t: height, pitch, roll          metres, radians
``V(v,t)`` vector (3,)         velocity in frame t: forward, left, turn rate   metres, radians per second
``F(t)``   vector (1,)         focal length of frame t: log of its ratio to     -
                               the nominal one
``D(t,n)`` vector (2,)         scale and shift of depth map n of frame t: log  -, metres or 1 / metres
                               of their ratio to the nominal one, difference
           or (6,)             turn and shift of a sensor's points             radians, metres
``S()``    vector (3,)         how far the mean length, width and height of    metres
                               the vehicles' fleet are from the prior's
=========  ==================  ==============================================  ======================

The functions raise `InvalidInputError` where a number is negative or too large.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import gtsam

from factors.errors import InvalidInputError

_LOW_BITS = 32
_VEHICLES = 1 << (56 - _LOW_BITS)
_LOWS = 1 << _LOW_BITS


class DecodedKey(NamedTuple):
    """What a key stands for.

    Attributes:
        letter: `X`, `L`, `O`, `P`, `M`, `G`, `V`, `F`, `D` or `S`.
        vehicle: Number of the vehicle, or of the depth map; 0 for the ground, the focal length and the fleet.
        low: Frame of a pose, a velocity, the ground, the focal length or a depth map, face of a plane, 0 of others.
    """

    letter: str
    vehicle: int
    low: int


def X(vehicle: int = 0, t: int = 0) -> int:
    """Key of the pose camera_T_object of a vehicle in frame t."""
    return _key("X", vehicle, t, "t")


def L(vehicle: int = 0) -> int:
    """Key of a vehicle's shape coefficients lambda (N,)."""
    return _key("L", vehicle, 0, "")


def O(vehicle: int = 0) -> int:  # noqa: E743  # the letter of the variable
    """Key of a vehicle's free offsets, one vector of 3K numbers."""
    return _key("O", vehicle, 0, "")


def P(vehicle: int = 0, face: int = 0) -> int:
    """Key of the plane of a vehicle's face."""
    return _key("P", vehicle, face, "face")


def M(vehicle: int = 0) -> int:
    """Key of a vehicle's medial plane."""
    return _key("M", vehicle, 0, "")


def G(t: int = 0) -> int:
    """Key of the ground of frame t: its plane's difference (h, a, b) from the nominal one (`factors.contact`)."""
    return _key("G", 0, t, "t")


def V(vehicle: int = 0, t: int = 0) -> int:
    """Key of a vehicle's velocity in frame t: forward, left and turn rate (`factors.motion`)."""
    return _key("V", vehicle, t, "t")


def F(t: int = 0) -> int:
    """Key of the focal length of frame t (1,): the logarithm of its ratio to the nominal one."""
    return _key("F", 0, t, "t")


def D(t: int = 0, n: int = 0) -> int:
    """Key of what points of frame t share: of a depth map scale and shift (2,), of a sensor's place the error (6,).

    See `factors.surface_points.Shared` and `factors.placed_points`.
    """
    return _key("D", n, t, "t")


def S() -> int:
    """Key of the fleet (3,): by how much the vehicles are larger than those of the prior on average, metres."""
    return _key("S", 0, 0, "")


def decode_key(key: int) -> DecodedKey:
    """Letter, vehicle and frame or face of a key; the reverse of the functions of this module that make one."""
    symbol = gtsam.Symbol(key)
    index = symbol.index()
    return DecodedKey(chr(symbol.chr()), index >> _LOW_BITS, index & (_LOWS - 1))


def key_name(key: int) -> str:
    """A key for people to read, such as `X(v=0,t=3)`, `L(v=0)` or `P(v=0,f=2)`."""
    letter, vehicle, low = decode_key(key)
    if letter == "S":
        return "S()"
    if letter == "D":
        return f"D(t={low},n={vehicle})"
    if letter in "GF":
        return f"{letter}(t={low})"
    detail = {"X": f",t={low}", "V": f",t={low}", "P": f",f={low}"}.get(letter, "")
    return f"{letter}(v={vehicle}{detail})"


@lru_cache(maxsize=4096)
def _key(letter: str, vehicle: int, low: int, low_name: str) -> int:
    if not 0 <= vehicle < _VEHICLES:
        raise InvalidInputError("vehicle", vehicle, f"Number vehicles from 0 to {_VEHICLES - 1}.")
    if not 0 <= low < _LOWS:
        raise InvalidInputError(low_name, low, f"Use a number from 0 to {_LOWS - 1}.")
    return int(gtsam.symbol(letter, (int(vehicle) << _LOW_BITS) | int(low)))
