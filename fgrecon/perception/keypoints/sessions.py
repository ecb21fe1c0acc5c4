"""Sessions of ONNX Runtime, which is faster than PyTorch and OpenCV, and the number of the networks' threads."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError

_BEGAN = time.monotonic() - time.process_time()  # about when this process began
_QUOTAS = ("cpu.max", "cpu/cpu.cfs_quota_us")  # of version 2 and 1
_CGROUPS = Path("/sys/fs/cgroup")


def free_cores() -> int:
    """The processor cores that are free now: those that this process may use, less those that others keep busy.

    affinity (one for each core) ---- cgroup's share ---- load of other processes ---- at least one

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


Network = Callable[[NDArray[Any]], Sequence[NDArray[np.float32]]]
"""From the network's input to its outputs."""

_PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}
"""What ONNX Runtime calls what runs networks, by the device's name."""

_MOST: ContextVar[int | None] = ContextVar("most", default=None)


@contextmanager
def at_most(threads: int | None) -> Iterator[None]:
    """Networks that are made inside have so many threads, whatever is free; None changes nothing."""
    before = _MOST.set(threads)
    try:
        yield
    finally:
        _MOST.reset(before)


def threads_of_networks() -> int:
    """Threads for networks that are made now: as many as cores are free, and not more than PyTorch has been given.

    Of `at_most`, and of OMP_NUM_THREADS where PyTorch is not loaded, just as many.
    """
    most, torch = _MOST.get(), sys.modules.get("torch")
    if most is not None:
        return most
    if torch is not None and hasattr(torch, "get_num_threads"):
        return min(int(torch.get_num_threads()), free_cores())
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return int(asked) if asked.isdecimal() and int(asked) > 0 else free_cores()


def runs_on(device: str) -> bool:
    """Whether ONNX Runtime runs networks on a device: `cpu`, `cuda` or `cuda:1`."""
    import onnxruntime

    kind = device.partition(":")[0]
    return kind == "cpu" or _PROVIDERS.get(kind) in onnxruntime.get_available_providers()


def open_session(model: bytes, threads: int, device: str = "cpu") -> Network:
    """A network on the processor's cores, or on another device.

    Args:
        model: ONNX file, of a network with one input.
        threads: At most so many cores. They sleep when there is nothing to do: those that wait for work keep others'
            from the cores.

        device: One that it `runs_on`.

    Raises:
        InvalidInputError: There is no network in it.
    """
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as errors

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = max(threads, 1)
    options.enable_cpu_mem_arena = options.enable_mem_pattern = False  # 70 MB less for the cascade, and as fast
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        session = onnxruntime.InferenceSession(model, options, providers=_providers(device))
    except (errors.Fail, errors.InvalidProtobuf, errors.InvalidGraph, errors.NotImplemented) as error:
        raise InvalidInputError("model", str(error), "Give an ONNX file of a network.") from error
    (entry,) = session.get_inputs()

    def run(values: NDArray[Any]) -> Sequence[NDArray[np.float32]]:
        return session.run(None, {entry.name: np.ascontiguousarray(values)})

    return run


def _providers(device: str) -> list[Any]:
    kind, _, number = device.partition(":")
    first = (_PROVIDERS[kind], {"device_id": int(number)}) if number else _PROVIDERS[kind]
    return [first] if kind == "cpu" else [first, _PROVIDERS["cpu"]]
