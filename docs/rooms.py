"""Make the table of rooms again, docs/reference/rooms.md, from tests/test_layers.py and the packages' docstrings.

python docs/rooms.py
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT))

from fgrecon.core.text import markdown_row  # noqa: E402 - from the checkout
from tests.test_layers import ROOMS  # noqa: E402

PAGE = ROOT / "docs/reference/rooms.md"


def _folder(room: str) -> Path:
    if room == "factors":
        return ROOT / room
    first, _, rest = room.partition("/")
    return ROOT / "research/fgrecon_research" / rest if first == "research" else ROOT / "fgrecon" / room


def _holds(room: str) -> str:
    """The first paragraph of the package's docstring."""
    if not room:
        return "The public names, `fgrecon/__init__.py`."
    text = ast.get_docstring(ast.parse((_folder(room) / "__init__.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split())


def page() -> str:
    """The table: each room, what it holds, and what it may import."""
    rows = [markdown_row(["room", "holds", "may import"]), "|---|---|---|\n"]
    for room, below in ROOMS.items():
        names = ", ".join(f"`{name}`" for name in ROOMS if name in below)
        rows.append(markdown_row([f"`{room}`" if room else "(public names)", _holds(room), names or "-"]))
    return f"<!-- Made by `python docs/rooms.py`. -->\n\n{''.join(rows)}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
