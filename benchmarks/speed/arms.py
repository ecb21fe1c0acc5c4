"""This tree beside itself without the compiled kernel, and beside the first release: the same cars, in turn."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.speed.builds import Build, unpacked
from benchmarks.speed.cases import Case, write_cases
from benchmarks.speed.measure import Arm, Table, interleaved, timing_rows
from benchmarks.speed.stages import pose_difference

FIRST_RELEASE = "c5fe3798cd6d69755e6545064fff383b5219f4f7"
"""The last commit before modules moved into rooms: what the changelog calls 0.1.0."""

NUMPY = {"FGRECON_KERNEL": "numpy"}
"""What makes the solver do without its compiled kernel, where it has one."""

NOW, PLAIN, FIRST = "this version", "this version, kernel off", "first release"


def compare(kinds: dict[str, Sequence[Case]], folder: Path, repeats: int) -> tuple[list[Table], Table]:
    """Times of all arms for each kind of car, and how far their results are from this version's.

    Args:
        kinds: Cars by what they are.
        folder: For files.
        repeats: How often each car is solved in each arm.
    """
    release = unpacked(FIRST_RELEASE, folder / "first_release", "fgrecon", "factors")
    differences = Table("Differences between versions", ("", "metres: median", "worst", "degrees: median", "worst"))
    times = [_timed(kind, cases, folder, release, repeats, differences) for kind, cases in kinds.items() if cases]
    if release is None:
        differences.notes.append("The first release is left out: this is no checkout with its history.")
    differences.notes.append(
        "Distance of pose between results, of this version without the compiled kernel and of the first release "
        "(which had other defaults) from this version's."
    )
    return times, differences


def _timed(
    kind: str, cases: Sequence[Case], folder: Path, release: Path | None, repeats: int, differences: Table
) -> Table:
    file = write_cases(folder / "cases.json", cases)
    with ExitStack() as stack:
        arms = {NOW: stack.enter_context(Arm(file)), PLAIN: stack.enter_context(Arm(file, **NUMPY))}
        if release is not None:
            arms[FIRST] = stack.enter_context(Arm(file, Build(FIRST, path=(release,))))
        answers = {name: [{} for _ in cases] for name in arms}
        for arm in arms.values():
            arm.ask(solve=0)  # loads what is loaded on use
        rows = {
            name: [arm.clock(i, answers[name], history=False) for i in range(len(cases))] for name, arm in arms.items()
        }
        taken = interleaved(rows, repeats)
    solved = [i for i in range(len(cases)) if all("pose" in answers[name][i] for name in arms)]
    table = Table(f"Versions: {kind}")
    table.rows = timing_rows({name: times[solved] for name, times in taken.items()})
    table.notes.append(f"{len(solved)} cars, {len(cases) - len(solved)} that a version refuses left out.")
    for name in list(arms)[1:]:
        pairs = [(answers[NOW][i]["pose"], answers[name][i]["pose"]) for i in solved]
        metres, degrees = np.array([pose_difference(np.array(a), np.array(b)) for a, b in pairs]).T
        values = map(float, (np.median(metres), metres.max(), np.median(degrees), degrees.max()))
        differences.rows.append([f"{kind}: {name}", *values])
    return table
