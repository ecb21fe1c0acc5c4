"""Make the tables of fields in docs/reference/fields again, from the descriptions in the JSON schemas.

python docs/fields.py
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fgrecon.core.text import markdown_row
from fgrecon.io.export.losses import LACKS

DOCS = Path(__file__).parent
TABLES = {
    "keypoints": ("instance", "camera"),
    "keypoint_labels": ("image", "annotation", "category"),
    "track": ("", "frame"),
}
"""Of each schema the definitions whose fields are shown; the empty name is the file itself."""


def fields(schema: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and description of each property that has one, those of objects inside after their own."""
    for name, content in schema.get("properties", {}).items():
        if "description" in content:
            yield f"{prefix}{name}", content["description"]
        for inner in (content, *content.get("anyOf", ())):
            yield from fields(inner, f"{prefix}{name}.")


def table(name: str) -> str:
    """The table of one schema."""
    schema = json.loads((DOCS / f"schemas/{name}.schema.json").read_text(encoding="utf-8"))
    rows = [markdown_row(["field", "content"]), "|---|---|\n"]
    for part in TABLES[name]:
        owner = f"{part}." if part and len(TABLES[name]) > 2 else "frames[]." if part == "frame" else ""
        found = fields(schema["$defs"][part] if part else schema)
        rows += [markdown_row([f"`{owner}{field}`", text]) for field, text in found]
    return f"<!-- Made by `python docs/fields.py`. -->\n\n{''.join(rows)}"


def exports() -> str:
    """The table of what kinds of files have no place for."""
    rows = [(kind, ", ".join(parts)) for kind, parts in LACKS.items() if parts]
    found = [markdown_row([f"`{kind}`", parts]) for kind, parts in rows]
    head = [markdown_row(["`--format`", "not written"]), "|---|---|\n"]
    return f"<!-- Made by `python docs/fields.py`. -->\n\n{''.join([*head, *found])}"


if __name__ == "__main__":
    (DOCS / "reference/fields/exports.md").write_text(exports(), encoding="utf-8")
    for name in TABLES:
        (DOCS / f"reference/fields/{name}.md").write_text(table(name), encoding="utf-8")
