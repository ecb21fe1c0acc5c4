"""The evaluation as Markdown and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.paper.run import PaperEvaluation

FORMAT = "fgrecon_research.evaluation.paper/1"
_NAMED = 20


def document(found: PaperEvaluation, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON document: tables with intervals, claims, conditions, machine and versions."""
    return {
        "format": FORMAT,
        "conditions": list(found.conditions),
        "claims": [str(claim) for claim in found.claims],
        "tables": {table.key: table.document() for table in found.tables},
        "problems": dict(found.problems),
        "defects": list(found.defects),
        "failures": list(found.failures),
        "throughput": dict(found.throughput),
        "settings": dict(settings),
        "machine": report.machine(),
        "versions": report.versions(),
    }


def markdown(found: PaperEvaluation) -> str:
    """Claims, conditions and tables as Markdown."""
    parts = ["# Evaluation\n", *(f"{text}\n" for text in found.conditions), "## The paper's claims\n"]
    parts += [
        "".join(f"{line}\n" for line in (f"**{claim.heading}**\n", *(f"- {text}" for text in claim.sentences)))
        for claim in found.claims
    ]
    for table in found.tables:
        parts.append(f"## {table.title}\n")
        if table.note:
            parts.append(f"{table.note}\n")
        rows = [(label, *(table.text(cell) for cell in cells)) for label, cells in table.rows]
        parts.append(TextTable(("", *table.columns), rows).markdown())
    parts.append("## Run\n")
    parts.append("\n\n".join(_run(found)) + "\n")
    return "\n".join(parts)


def _run(found: PaperEvaluation) -> list[str]:
    machine, versions = report.machine(), report.versions()
    speed = found.throughput
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
    problems = ", ".join(f"{name}: {count}" for name, count in found.problems.items()) or "none"
    lines.append(f"Defects of the files: {problems}. Failures: {len(found.failures)}.")
    for kind, named in (("Defect", found.defects), ("Failed", found.failures)):
        lines += [f"{kind}: {text}" for text in named[:_NAMED]]
        if len(named) > _NAMED:
            lines.append(f"{kind}: {len(named) - _NAMED} more in the JSON document.")
    return lines
