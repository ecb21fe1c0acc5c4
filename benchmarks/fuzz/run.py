"""One reader and many damaged files."""

from __future__ import annotations

import hashlib
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.fuzz.mutate import mutated
from benchmarks.fuzz.readers import READERS
from benchmarks.process_tree import processor_time
from fgrecon.core.errors import FgreconError

__all__ = ["Ended", "Find", "fuzz", "judge", "keep", "numbered", "read"]

_WAITED = 5.0  # so many times the CPU time may pass by the clock
_SLOW = 20.0  # seconds for one small file: a find; a picture of 178 million equal pixels takes six


@dataclass(frozen=True)
class Find:
    """A file that a reader does not bear.

    Attributes:
        reader: Its name.
        error: What it raised.
        place: Where.
        file: The file that was kept.
    """

    reader: str
    error: str
    place: str
    file: Path


@dataclass
class Ended:
    """How a run ended.

    Attributes:
        files: How many were read.
        seconds: CPU time, that of child processes included.
        slowest: Wall time of the slowest file, seconds.
        finds: One for each place that raised.
    """

    files: int = 0
    seconds: float = 0.0
    slowest: float = 0.0
    finds: list[Find] = field(default_factory=list)


def fuzz(name: str, start: int, seconds: float, out: Path | None = None, most: int | None = None) -> Ended:
    """Damage and read.

    Args:
        name: Of the reader.
        start: Number of the first file; the same number makes the same file.
        seconds: CPU time, that of child processes included.
        out: Where files are kept that a reader does not bear.
        most: At most so many files.
    """
    seeds = sorted(READERS[name].seeds().items())
    ended = Ended()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in numbered(start, seconds, ended, most):
            rng = np.random.default_rng([number, *name.encode()])
            title, content = seeds[int(rng.integers(len(seeds)))]
            judge(name, Path(folder) / title, mutated(content, rng), ended, out)
    return ended


def numbered(start: int, seconds: float, ended: Ended, most: int | None) -> Iterator[int]:
    """Numbers of files from `start` on until the time is over or there are enough; takes note of the CPU time."""
    began, wall = processor_time(), time.perf_counter()
    while (
        processor_time() - began < seconds
        and time.perf_counter() - wall < _WAITED * seconds
        and (most is None or ended.files < most)
    ):
        yield start + ended.files
    ended.seconds = processor_time() - began


def judge(name: str, path: Path, content: bytes, ended: Ended, out: Path | None) -> None:
    """Read one file and take note: of a place that raised, the first file alone.

    Args:
        name: Of the reader.
        path: Where the file is written.
        content: What is in it.
        ended: Where note is taken.
        out: Where files are kept that a reader does not bear.
    """
    clock = time.perf_counter()
    error = read(name, path, content)
    took = time.perf_counter() - clock
    ended.slowest = max(ended.slowest, took)
    ended.files += 1
    if error is None and took > _SLOW:
        error = TimeoutError(f"{took:.1f} seconds")
    if error is None:
        return
    last = traceback.extract_tb(error.__traceback__)[-1:]
    place = f"{Path(last[0].filename).name}:{last[0].lineno}" if last else "?"
    kind = type(error).__name__
    if all(find.place != place or not find.error.startswith(kind) for find in ended.finds):
        kept = keep(out, name, path.name, content)
        ended.finds.append(Find(name, f"{kind}: {error}"[:200], place, kept))


def read(name: str, path: Path, content: bytes) -> Exception | None:
    """What a reader raises that it should not; None where it reads the file or refuses it on purpose."""
    path.write_bytes(content)
    try:
        READERS[name].read(path)
    except FgreconError:
        return None
    except Exception as error:  # noqa: BLE001  # that is the question
        return error
    return None


def keep(out: Path | None, name: str, title: str, content: bytes) -> Path:
    """Where a file is kept that a reader does not bear, or would be without a folder."""
    digest = hashlib.sha256(content).hexdigest()[:10]
    path = (out or Path()) / name.replace(" ", "_") / f"{digest}-{title}"
    if out is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return path
