"""How many processor cores are free for this process: those that it may use, less those that others keep busy.

affinity (one for each core) ---- cgroup's share ---- load of other processes ---- at least one
"""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

_BEGAN = time.monotonic() - time.process_time()  # about when this process began
_QUOTAS = ("cpu.max", "cpu/cpu.cfs_quota_us")  # of version 2 and 1
_CGROUPS = Path("/sys/fs/cgroup")


def free_cores() -> int:
    """The cores that are free now; 1 where none is.

    Threads that wait for one that does not run cost more than they gain: a network's take ten times as long where two
    share a core with other work.
    """
    return max(1, math.floor(min(allowed_cores(), share_of_cgroup())) - round(load_of_others()))


def allowed_cores() -> int:
    """The cores that this process may use; a second thread of the same core is no gain where all do arithmetic."""
    if not hasattr(os, "sched_getaffinity"):
        return os.cpu_count() or 1
    return len({_core(processor) for processor in os.sched_getaffinity(0)})


def share_of_cgroup() -> float:
    """Processors that the limit of a container amounts to; infinite where there is none."""
    try:
        quota, period = (_CGROUPS / _QUOTAS[0]).read_text(encoding="ascii").split()
    except (OSError, ValueError):
        try:
            old = _CGROUPS / _QUOTAS[1]
            quota = old.read_text(encoding="ascii").strip()
            period = old.with_name("cpu.cfs_period_us").read_text(encoding="ascii").strip()
        except OSError:
            return math.inf
    return float(quota) / float(period) if quota.isdecimal() and period.isdecimal() and int(period) else math.inf


def load_of_others() -> float:
    """Processors that other processes kept busy over the last minute, about; 0 where the system does not tell."""
    try:
        load = os.getloadavg()[0]
    except (AttributeError, OSError):
        return 0.0
    own = time.process_time() / max(time.monotonic() - _BEGAN, 60.0)  # the load has forgotten what is a minute ago
    return max(0.0, load - own)


def _core(processor: int) -> str:
    """One name for all the processors of a core."""
    try:
        return Path(f"/sys/devices/system/cpu/cpu{processor}/topology/thread_siblings_list").read_text()
    except OSError:  # not given, as in some containers
        return f"processor {processor}"
