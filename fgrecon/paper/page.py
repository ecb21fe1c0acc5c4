"""The evaluation as Markdown, as JSON and as one HTML page that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

from fgrecon.evaluation import report
from fgrecon.evaluation.bootstrap import Interval
from fgrecon.paper.run import Page
from fgrecon.paper.tables import Cell, Table

__all__ = ["FORMAT", "document", "html", "markdown"]

FORMAT = "fgrecon.evaluation.paper/1"
_NAMED = 20

_STYLE = """
:root { --ink: #1b2733; --muted: #6b7785; --line: #e3e8ee; --accent: #c8313a; --paper: #f6f8fa; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); margin: 0; background: white; }
main { max-width: 72rem; margin: 0 auto; padding: 2rem 1.5rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.15rem; margin: 2.4rem 0 .4rem; }
p { max-width: 60rem; } p.note, footer { color: var(--muted); font-size: .87rem; }
ul.claims { padding: 0; list-style: none; }
ul.claims li { border-left: 4px solid var(--accent); background: var(--paper); padding: .7rem 1rem; margin: .7rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; margin: .6rem 0; }
th, td { padding: .28rem .6rem; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 600; vertical-align: bottom; white-space: normal; min-width: 4.2rem; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: white; }
tr.printed td { color: var(--muted); font-style: italic; } tr.ours td:first-child { font-weight: 600; }
td.best { background: #fdecec; } td small { color: var(--muted); }
figure { margin: 1.2rem 0; } figure svg { max-width: 100%; height: auto; } figcaption { color: var(--muted); }
"""


def document(page: Page, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON document: tables with intervals, claims, conditions, machine and versions."""
    return {
        "format": FORMAT,
        "conditions": list(page.conditions),
        "claims": list(page.claims),
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
    parts += [f"- {text}\n" for text in page.claims]
    for table in page.tables:
        parts.append(f"## {table.title}\n")
        if table.note:
            parts.append(f"{table.note}\n")
        rows = [("", *table.columns), ("---", *("---:" for _ in table.columns))]
        rows += [(label, *(table.text(cell) for cell in cells)) for label, cells in table.rows]
        parts.append("".join(f"| {' | '.join(row)} |\n" for row in rows))
    parts.append("## Run\n")
    parts.append("\n\n".join(_run(page)) + "\n")
    return "\n".join(parts)


def html(page: Page) -> str:
    """One self-contained page."""
    claims = "".join(f"<li>{escape(text)}</li>" for text in page.claims)
    conditions = "".join(f"<p class=note>{escape(text)}</p>" for text in page.conditions)
    figures = "".join(
        f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>" for caption, svg in page.plots.items()
    )
    tables = "".join(_table(table) for table in page.tables)
    run = "".join(f"<p>{escape(line)}</p>" for line in _run(page))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>fgrecon: evaluation</title><style>{_STYLE}</style></head><body><main>"
        f"<h1>fgrecon: evaluation</h1><p>Every table of Murthy et al., ICRA 2017, on real tracks, real images and "
        f"simulated keypoints.</p>{conditions}<h2>The paper's claims</h2><ul class=claims>{claims}</ul>"
        f"<h2>Plots</h2>{figures}{tables}<footer><h2>Run</h2>{run}</footer></main></body></html>\n"
    )


def _run(page: Page) -> list[str]:
    machine, versions = report.machine(), report.versions()
    speed = page.throughput
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python {machine['python']}; "
        + ", ".join(f"{name} {version}" for name, version in versions.items() if version),
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


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in ("", *table.columns))
    best = _best(table)
    body = ""
    for label, cells in table.rows:
        kind = "printed" if label in table.printed else "ours" if label.startswith("fgrecon") else ""
        row = "".join(
            f"<td{' class=best' if (label, c) in best else ''}>{_cell(table, cell)}</td>"
            for c, cell in enumerate(cells)
        )
        body += f"<tr class='{kind}'><td>{escape(label)}</td>{row}</tr>"
    note = f"<p class=note>{escape(table.note)}</p>" if table.note else ""
    return f"<h2>{escape(table.title)}</h2>{note}<div class=scroll><table><tr>{head}</tr>{body}</table></div>"


def _cell(table: Table, cell: Cell) -> str:
    value, _, spread = table.text(cell).partition(" ")
    return f"{value} <small>{spread}</small>" if spread else value


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
