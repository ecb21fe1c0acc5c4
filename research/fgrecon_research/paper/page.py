"""The evaluation as Markdown, as JSON and as one HTML page that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.paper.run import Page
from fgrecon_research.paper.tables import Cell, Table

FORMAT = "fgrecon_research.evaluation.paper/1"
_NAMED = 20


def document(page: Page, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON document: tables with intervals, claims, conditions, machine and versions."""
    return {
        "format": FORMAT,
        "conditions": list(page.conditions),
        "claims": [str(claim) for claim in page.claims],
        "tables": {table.key: table.document() for table in page.tables},
        "problems": dict(page.problems),
        "defects": list(page.defects),
        "failures": list(page.failures),
        "throughput": dict(page.throughput),
        "settings": dict(settings),
        "machine": report.machine(),
        "versions": report.versions(),
    }


def markdown(page: Page) -> str:
    """Claims, conditions and tables as Markdown."""
    parts = ["# Evaluation\n", *(f"{text}\n" for text in page.conditions), "## The paper's claims\n"]
    parts += [
        "".join(f"{line}\n" for line in (f"**{claim.heading}**\n", *(f"- {text}" for text in claim.sentences)))
        for claim in page.claims
    ]
    for table in page.tables:
        parts.append(f"## {table.title}\n")
        if table.note:
            parts.append(f"{table.note}\n")
        rows = [(label, *(table.text(cell) for cell in cells)) for label, cells in table.rows]
        parts.append(TextTable(("", *table.columns), rows).markdown())
    parts.append("## Run\n")
    parts.append("\n\n".join(_run(page)) + "\n")
    return "\n".join(parts)


def html(page: Page, pictures: Mapping[str, str] | None = None) -> str:
    """One self-contained page."""
    environment = Environment(
        loader=PackageLoader("fgrecon_research.paper", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html.j2").render(
        page=page, pictures=pictures or {}, run=_run(page), best_of=_best
    )


def _run(page: Page) -> list[str]:
    machine, versions = report.machine(), report.versions()
    speed = page.throughput
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}; "
        + ", ".join(f"{name} {version}" for name, version in versions.items()),
    ]
    if speed["instances"]:
        lines.append(
            f"{speed['instances']:.0f} simulated instances by all methods in {speed['seconds']:.0f} s: "
            f"{speed['per_second']:.1f} a second."
        )
    else:
        lines.append("The simulated instances were read from an earlier run.")
    problems = ", ".join(f"{name}: {count}" for name, count in page.problems.items()) or "none"
    lines.append(f"Defects of the files: {problems}. Failures: {len(page.failures)}.")
    for kind, named in (("Defect", page.defects), ("Failed", page.failures)):
        lines += [f"{kind}: {text}" for text in named[:_NAMED]]
        if len(named) > _NAMED:
            lines.append(f"{kind}: {len(named) - _NAMED} more in the JSON document.")
    return lines


def _best(table: Table) -> set[tuple[str, int]]:
    """Cells with the highest precision of their column, the printed rows aside; errors are not marked."""
    found: set[tuple[str, int]] = set()
    for c, column in enumerate(table.columns):
        if "≤" not in column:
            continue
        values = {label: _value(cells[c]) for label, cells in table.rows if label not in table.printed}
        top = max(values.values(), default=math.nan)
        found |= {(label, c) for label, value in values.items() if value == top}
    return found


def _value(cell: Cell) -> float:
    value = cell.value if isinstance(cell, Interval) else cell
    return -math.inf if value is None else value
