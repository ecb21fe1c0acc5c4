"""Memory and processor time of a process and all that it started, from Linux's /proc."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_PROC = Path("/proc")
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Usage:
    """What a process takes.

    Attributes:
        resident: Memory that it has in the machine, shared pages counted whole, MB (1,000,000 bytes).
        proportional: The same with every page divided by how many processes share it, MB: these can be summed.
        cpu: Processor time so far, seconds.
    """

    resident: float
    proportional: float
    cpu: float


def usage_of_tree(root: int) -> dict[int, Usage]:
    """Usage of a process and its descendants by their numbers; those that end meanwhile are left out."""
    found = {}
    for process in _tree(root):
        usage = _usage(process)
        if usage is not None:
            found[process] = usage
    return found


def _tree(root: int) -> list[int]:
    """A process and its descendants, parents before children."""
    found, waiting = [], [root]
    while waiting:
        process = waiting.pop(0)
        found.append(process)
        try:
            children = (_PROC / str(process) / "task" / str(process) / "children").read_text(encoding="ascii")
        except OSError:
            continue
        waiting += map(int, children.split())
    return found


def _usage(process: int) -> Usage | None:
    folder = _PROC / str(process)
    try:
        rollup = (folder / "smaps_rollup").read_text(encoding="ascii")
        times = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    sizes = {line.split(":")[0]: int(line.split()[1]) for line in rollup.splitlines() if line.endswith(" kB")}
    if "Rss" not in sizes or "Pss" not in sizes:
        return None  # it is ending
    return Usage(sizes["Rss"] * 1.024e-3, sizes["Pss"] * 1.024e-3, (int(times[11]) + int(times[12])) / _TICKS)
