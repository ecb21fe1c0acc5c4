"""The encoding of protocol buffers, as far as a few messages need it: fields by their numbers, without a schema."""

from __future__ import annotations

import struct

import numpy as np

_VARINT, _EIGHT, _LENGTH, _FOUR = 0, 1, 2, 5  # wire types


def field(number: int, value: float | np.float32 | str | bytes) -> bytes:
    """A field of a message: floats as `double`, numpy's float32 as `float`, integers from 0 on as `int32` or `int64`.

    Args:
        number: Of the field in the schema.
        value: What it holds; bytes are a message.
    """
    if isinstance(value, np.float32):
        return _varint(number << 3 | _FOUR) + struct.pack("<f", value)
    if isinstance(value, int):
        return _varint(number << 3 | _VARINT) + _varint(value)
    if isinstance(value, float):
        return _varint(number << 3 | _EIGHT) + struct.pack("<d", value)
    content = value.encode() if isinstance(value, str) else bytes(value)
    return _varint(number << 3 | _LENGTH) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; the eighth says whether more follow."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])
