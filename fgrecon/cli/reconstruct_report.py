"""Printed output of `fgrecon reconstruct`: its table, and details of results. Imported when it runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.markup import escape

from fgrecon.batch.solve_tasks import Outcome, SolvedImage
from fgrecon.cli.terminal import Screen, compact_table
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.text import printable
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz.outcomes import HEADINGS, cells_of, clause_of, message_of

_ROWS = 300  # vehicles that the table has at most: it is for eyes, and slow to lay out
NAMED = 8  # vehicles with the same message that are named with it
_CELL = 120  # characters of a cell: ids come from anywhere


def print_table(screen: Screen, outcomes: Sequence[Outcome]) -> None:
    """One row per vehicle, refused ones included; messages are below.

    A verbose screen has whole messages below, with energies and times. Of very many vehicles the first are shown.
    """
    if screen.quiet:
        return
    outcomes, others = outcomes[:_ROWS], outcomes[_ROWS:]
    table = compact_table(*HEADINGS, text=("id", "status"), no_wrap=True, overflow="fold")
    for outcome in outcomes:
        table.add_row(*(escape(printable(cell.replace("\n", " "), _CELL)) for cell in cells_of(outcome)[:-1]))
    screen.print(table)
    clauses: dict[str, list[str]] = {}
    for outcome in outcomes:
        if screen.verbose:
            screen.print(f"{outcome.name}: {message_of(outcome)}", *details(outcome.result))
        elif clause := clause_of(outcome):
            clauses.setdefault(clause, []).append(outcome.name)
    for clause, names in clauses.items():
        listed = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
        screen.print(f"{listed}: {clause}")
    for outcome in outcomes:
        if outcome.closest is not None:
            screen.print(f"{outcome.name}: closest model {printable(str(outcome.closest))}.")
    if others:
        counts = Counter("refused" if other.result is None else other.result.status.value for other in others)
        listed = ", ".join(f"{count} {status}" for status, count in counts.most_common())
        screen.print(f"... and {len(others)} more ({listed}). The results file of --json or --out has all of them.")


def image_lines(image: SolvedImage) -> list[str]:
    """What was estimated of an image beside its vehicles."""
    lines = [] if image.image is None else [f"{image.image}:"]
    return lines + repr(image.result).splitlines()[: -len(image.result.vehicles) or None]


def details(result: Reconstruction | TrackReconstruction | None) -> list[str]:
    """Lines about energies and times of a result."""
    if result is None:
        return []
    of = result.diagnostics if isinstance(result, Reconstruction) else result
    energies = ", ".join(f"{term} {energy:.2f}" for term, energy in of.energies.items())
    times = ", ".join(f"{stage} {ms:.1f}" for stage, ms in of.milliseconds.items())
    regions = f"  regions: {result.uncertainty.regions.value}" if isinstance(result, Reconstruction) else ""
    return [line for line in (f"  energies (nats): {energies}", f"  times (ms): {times}", regions) if line]
