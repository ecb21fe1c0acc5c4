"""Damage: to bytes, to lines and words, and to the values of JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

__all__ = ["mutated"]

_ODD: tuple[Any, ...] = (
    *(None, [], {}, "", "x", -1, 0, 1e308, 10**400, True, [[]], {"a": [1]}, [None], 0.5, ["a", 1], "\ud800", "nan"),
    *("../x", "=1", "\x1b[31m", "a" * 5000, 2**63, -0.0, [1e308] * 3, {"": ""}, "$\\frac{$"),
)
_WORDS = ("", "nan", "inf", "-1", "1e999", "x", "0x1", "1" * 400, "\x00", "é", "1,2", "-")


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content of a file, changed in one to three places."""
    for _ in range(int(rng.integers(1, 4))):
        text = _decoded(content)
        if text is not None and text.lstrip().startswith(("{", "[")) and rng.random() < 0.7:
            content = _json(text, rng)
        elif text is not None and rng.random() < 0.6:
            content = _words(text, rng)
        else:
            content = _bytes(content, rng)
    return content


def _decoded(content: bytes) -> str | None:
    try:
        return content.decode()
    except UnicodeDecodeError:
        return None


def _json(text: str, rng: np.random.Generator) -> bytes:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return _words(text, rng)
    places = list(_places(value, ()))
    place = places[int(rng.integers(len(places)))]
    odd = _ODD[int(rng.integers(len(_ODD)))] if rng.random() < 0.8 else _DELETE
    return json.dumps(_put(value, place, odd)).encode()


_DELETE = object()


def _places(value: Any, place: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    yield place
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _places(item, (*place, key))
    elif isinstance(value, list):
        for index, item in list(enumerate(value))[:3]:
            yield from _places(item, (*place, index))


def _put(value: Any, place: tuple[Any, ...], odd: Any) -> Any:
    if not place:
        return None if odd is _DELETE else odd
    copy = dict(value) if isinstance(value, dict) else list(value)
    if len(place) == 1 and odd is _DELETE:
        del copy[place[0]]
    else:
        copy[place[0]] = _put(value[place[0]], place[1:], odd)
    return copy


def _words(text: str, rng: np.random.Generator) -> bytes:
    """A word replaced, a line doubled, dropped or swapped with another."""
    lines = text.split("\n")
    at, other = (int(rng.integers(len(lines))) for _ in range(2))
    kind = rng.integers(4)
    if kind == 0:
        words = lines[at].split(" ")
        words[int(rng.integers(len(words)))] = _WORDS[int(rng.integers(len(_WORDS)))]
        lines[at] = " ".join(words)
    elif kind == 1:
        lines.insert(at, lines[other])
    elif kind == 2:
        del lines[at]
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return "\n".join(lines).encode(errors="surrogatepass")


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Bits flipped, bytes overwritten, the end cut off, a part doubled."""
    if not content:
        return b"\xff"
    data, at = bytearray(content), int(rng.integers(len(content)))
    kind = rng.integers(4)
    if kind == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        size = int(rng.integers(1, 9))
        data[at : at + size] = bytes([(0, 255, 127, 128)[int(rng.integers(4))]]) * size
    elif kind == 2:
        del data[at:]
    else:
        data[at:at] = data[at : at + int(rng.integers(1, 65))]
    return bytes(data)
