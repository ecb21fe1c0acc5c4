"""A table of texts, for the terminal and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from fgrecon.core.text import markdown_row


@dataclass(frozen=True)
class TextTable:
    """Headings and rows; the first columns hold texts, the others numbers."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1  # how many columns of texts
    title: str = ""

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, str]], texts: int = 1, title: str = "") -> TextTable:
        """Of rows whose cells are by the headings, alike in all; of one row at least."""
        return cls(list(rows[0]), [list(row.values()) for row in rows], texts, title)

    def markdown(self) -> str:
        """As Markdown, the title above it in bold."""
        rule = ["---"] * self.texts + ["---:"] * (len(self.headings) - self.texts)
        title = f"**{self.title}**\n\n" if self.title else ""
        return title + "".join(map(markdown_row, (self.headings, rule, *self.rows)))

    def shown(self, *, tight: bool = False) -> Table:
        """As the terminal shows it, maybe without padding: where it is narrow numbers are wrapped, never cut."""
        padding = (0, 0 if tight else 1)
        table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=padding, title=self.title or None)
        for number, heading in enumerate(self.headings):
            is_text = number < self.texts
            justify: Literal["left", "right"] = "left" if is_text else "right"
            table.add_column(heading, justify=justify, no_wrap=is_text, overflow="fold")
        for row in self.rows:
            table.add_row(*map(escape, row))
        return table

    def filled(self) -> TextTable:
        """The same without columns of numbers that hold dashes alone."""
        some = [n for n in range(len(self.headings)) if n < self.texts or any(row[n] != "-" for row in self.rows)]
        rows = [[row[n] for n in some] for row in self.rows]
        return TextTable([self.headings[n] for n in some], rows, self.texts, self.title)


def number_or_dash(value: float | None, digits: str) -> str:
    """A number in a format such as `.2f`; a dash for None."""
    return "-" if value is None else format(value, digits)
