"""`fgrecon` with frames that come when they are due, and a clock: when each came, and when its estimates were there.

It is started as a file, with a file for the report, seconds from frame to frame (0: as fast as they are read) and the
arguments of `fgrecon`; the package is the one that the interpreter finds. What it wraps has these names in all builds
that are compared, but for what estimates the camera's motion. The CPU time of a stage is that of the thread that it is
in.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import gtsam

from fgrecon.cli.main import app
from fgrecon.io.frames import ImageFrames
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.vehicles import NanodetVehicleDetector
from fgrecon.solve.tracker import Tracker
from fgrecon.video.follow import Follower
from fgrecon.video.run import VideoRun

ELIMINATION, OPTIMISER, NETWORKS = "GTSAM's elimination", "GTSAM's optimiser, callbacks in it", "ONNX Runtime"
COMPILED = "rows and elimination, compiled"

came: dict[int, float] = {}
done: dict[int, float] = {}
memory: list[float] = []
spent: defaultdict[str, float] = defaultdict(float)
"""Seconds of CPU by stage."""
least: defaultdict[str, float] = defaultdict(float)
"""Seconds of CPU, within those, of what no code of ours can make less: by library."""


def resident() -> float:
    """Resident memory, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return sum(1.024e-3 * int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))


def pace(interval: float) -> None:
    """Let frames come so many seconds apart, and note when they do and when they are done."""
    read, follow = ImageFrames.read, Follower.__call__

    def paced(self: Any, after: int | None = None) -> Iterator[Any]:
        frames, began = read(self, after), time.perf_counter()
        for place in range(self.count):
            due = began + place * interval
            time.sleep(max(0.0, due - time.perf_counter()))
            arrived = due if interval else time.perf_counter()
            before = time.thread_time()
            frame = next(frames, None)
            spent["reading"] += time.thread_time() - before
            if frame is None:
                return
            came[frame.number] = arrived
            yield frame

    def followed(self: Any, record: Any) -> Any:
        frame = follow(self, record)
        done[frame.number] = time.perf_counter()
        memory.append(resident())
        return frame

    ImageFrames.read, Follower.__call__ = paced, followed  # type: ignore[method-assign]


def clock(owner: type, name: str, stage: str, counted_in: defaultdict[str, float] = spent) -> None:
    """Count the CPU time of a method for a stage."""
    inner = getattr(owner, name)

    def counted(*args: Any, **kwargs: Any) -> Any:
        before = time.thread_time()
        try:
            return inner(*args, **kwargs)
        finally:
            counted_in[stage] += time.thread_time() - before

    setattr(owner, name, counted)


def motion_stage() -> type:
    """What estimates the camera's motion; its name in the first of the builds was another one."""
    try:
        return import_module("fgrecon.video.camera_path").MotionEstimator
    except ModuleNotFoundError:
        return import_module("fgrecon.video.motion_look").MotionLook


def main() -> None:
    """Run, and write the report."""
    report, interval, *arguments = sys.argv[1:]
    clock(Follower, "__call__", "solving")
    pace(float(interval))
    clock(NanodetVehicleDetector, "__call__", "car detector")
    clock(KeypointCascade, "__call__", "keypoint networks")
    clock(motion_stage(), "__call__", "the camera's motion")
    clock(VideoRun if hasattr(VideoRun, "smooth") else Tracker, "smooth", "smoothing")
    clock(gtsam.GaussianFactorGraph, "optimize", ELIMINATION, least)
    clock(gtsam.LevenbergMarquardtOptimizer, "optimize", OPTIMISER, least)
    with suppress(ImportError):
        system = import_module("factors.system").CompiledSystem
        clock(system, "step", COMPILED, least)
        clock(system, "covariance", COMPILED, least)
    with suppress(ImportError):
        clock(import_module("onnxruntime").InferenceSession, "run", NETWORKS, least)
    with suppress(SystemExit):
        app(arguments)
    delays = [done[number] - came[number] for number in sorted(done)]
    spent["start, files, the rest"] = time.process_time() - sum(spent.values())
    Path(report).write_text(
        json.dumps({"delays": delays, "memory": memory, "spent": spent, "least": least}), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
