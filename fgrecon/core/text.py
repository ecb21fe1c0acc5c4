"""Text of unknown origin, made safe to be shown and used as names."""

from __future__ import annotations

import re
from collections.abc import Iterable

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def counted(count: int, thing: str, things: str | None = None) -> str:
    """How many there are, in words: `1 car`, `2 cars`.

    Args:
        count: How many.
        thing: What one is called.
        things: What several are called, where that is not the same with an s.
    """
    return f"{count} {thing if count == 1 else things or f'{thing}s'}"


def without_numbers(text: str) -> str:
    """A text with `n` for each number, which is the same for what differs by numbers alone."""
    return _NUMBER.sub("n", text)


def most_frequent(texts: Iterable[str]) -> list[tuple[str, int]]:
    """The first of texts that differ by numbers alone, and how many these are; the most frequent first."""
    alike: dict[str, list[str]] = {}
    for text in texts:
        alike.setdefault(without_numbers(text), []).append(text)
    return [(some[0], len(some)) for some in sorted(alike.values(), key=len, reverse=True)]


def printable(text: str, most: int = 4000) -> str:
    """A text as it may be shown: without characters that command a terminal, and not endlessly long.

    Args:
        text: Such as an id or a path, from anywhere.
        most: Characters from which on the middle is left out.
    """
    shown = text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 4 :]}"
    if shown.isprintable():
        return shown
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in shown)


def whole_text(text: str) -> str:
    """A text that UTF-8 can hold: half a pair of surrogates becomes a replacement character.

    JSON can write such halves, and names of files that are not UTF-8 have them.
    """
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def one_word(text: object) -> str:
    """A name as one word: what separated its words is `_`."""
    return "_".join(str(text).split())


def distinct(name: str, taken: set[str]) -> str:
    """A name, with a number behind it where it is taken; it is taken from then on."""
    own, number = name, 1
    while own in taken:
        number += 1
        own = f"{name}-{number}"
    taken.add(own)
    return own


def markdown_row(cells: Iterable[str]) -> str:
    """A row of a Markdown table with its line's end; no cell ends it or begins another one."""
    escaped = (cell.replace("|", "\\|").replace("\n", " ") for cell in cells)
    return f"| {' | '.join(escaped)} |\n"
