"""`fgrecon` with frames that come when they are due, and a clock: when each came, and when its estimates were there.

It is started as a file, with a file for the report, seconds from frame to frame (0: as fast as they are read) and the
arguments of `fgrecon`; the package is the one that the interpreter finds. What it wraps has these names in all builds
that are compared: `ImageFrames.read` and `Follower.__call__`.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from fgrecon.cli.main import app
from fgrecon.io.frames import ImageFrames
from fgrecon.video.follow import Follower

came: dict[int, float] = {}
done: dict[int, float] = {}
memory: list[float] = []


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
            frame = next(frames, None)
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


def main() -> None:
    """Run, and write the report."""
    report, interval, *arguments = sys.argv[1:]
    pace(float(interval))
    with suppress(SystemExit):
        app(arguments)
    delays = [done[number] - came[number] for number in sorted(done)]
    Path(report).write_text(json.dumps({"delays": delays, "memory": memory}), encoding="utf-8")


if __name__ == "__main__":
    main()
