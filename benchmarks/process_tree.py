"""Memory and processor time of a process and all that it started, from Linux's /proc."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_PROC = Path("/proc")
_MB = 1.024e-3  # of a kB as /proc counts them
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Usage:
    """What a process takes.

    Attributes:
        own: Memory that it shares with nobody, MB (1,000,000 bytes).
        files: Memory of files that it has mapped, such as libraries, MB by file: other processes have the same pages.
        cpu: Processor time so far, seconds.
    """

    own: float
    files: dict[str, float]
    cpu: float

    @property
    def resident(self) -> float:
        """All memory that it has in the machine, MB."""
        return self.own + sum(self.files.values())


def memory_of(processes: Iterable[Usage]) -> float:
    """Memory of several processes, MB, that of files once: what they take on a machine of their own."""
    known = list(processes)
    files: dict[str, float] = {}
    for one in known:
        files |= {name: max(size, files.get(name, 0.0)) for name, size in one.files.items()}
    return sum(one.own for one in known) + sum(files.values())


def usage_of_tree(root: int) -> dict[int, Usage]:
    """Usage of a process and its descendants by their numbers; those that end meanwhile are left out."""
    found = {}
    for process in _tree(root):
        usage = _usage(process)
        if usage is not None:
            found[process] = usage
    return found


def processor_time() -> float:
    """Processor time of this process and of all that it started, those that ended as well, seconds."""
    own = os.getpid()
    alive = sum(sum(_times(process)) for process in _tree(own) if process != own)
    return sum(os.times()[:4]) + alive


def _times(process: int) -> list[float]:
    """Processor time of a process and of its children that ended: user, system, both of the children, seconds."""
    try:
        words = (_PROC / str(process) / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return []
    return [int(word) / _TICKS for word in words[11:15]]


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
        maps = (folder / "smaps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    times = _times(process)
    if not times:
        return None
    own, name, resident = 0.0, "", 0.0
    files: dict[str, float] = {}
    for line in maps.splitlines():
        words = line.split()
        if not words[0].endswith(":"):  # a mapping: addresses, permissions, offset, device, inode, file
            name = words[5] if len(words) > 5 else ""
        elif words[0] == "Rss:":
            resident = int(words[1]) * _MB
        elif words[0] == "Anonymous:":
            alone = int(words[1]) * _MB
            own += alone
            if resident > alone:
                files[name] = files.get(name, 0.0) + resident - alone
    return Usage(own, files, sum(times[:2]))
