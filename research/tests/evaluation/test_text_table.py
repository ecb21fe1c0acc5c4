from __future__ import annotations

from io import StringIO

from rich.console import Console

from fgrecon_research.evaluation.text_table import TextTable


def test_narrow_tables_lose_no_digit():
    table = TextTable(["group", "mean m", "median m"], [["beyond 30 m", "1.73 (0.95-2.65)", "1.01 (0.77-2.18)"]])
    screen = Console(width=30, file=StringIO())
    screen.print(table.shown())
    shown = screen.file.getvalue()
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= 30
    assert sum(one.isdigit() for one in shown) == sum(
        one.isdigit() for row in table.rows for cell in row for one in cell
    )
