"""Fuzzing that goes by coverage: atheris keeps what reaches new code and damages that further.

One harness for all readers, in a process of its own for each, since libFuzzer does not give one back. The first byte of
an input chooses the kind of file, the rest is the file. Half of the damage is that of `benchmarks.fuzz.mutate`, which
knows lines and JSON, the other half libFuzzer's. What reaches new code is kept in the folder `corpus` and is where the
next run begins. Of readers that decode in a child process (MATLAB files, recordings) coverage ends where that begins.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.fuzz.mutate import mutated

if TYPE_CHECKING:
    from benchmarks.fuzz.run import Ended

__all__ = ["guided", "why_not"]

_SLOW = 20  # seconds for one file: a find
_MEMORY = 4096  # MiB of the whole process
_NOTE_SECONDS = 2.0  # seconds between two notes of how far it has come
_GRACE = 120.0  # seconds beside the run itself: imports, instrumentation


def why_not() -> str | None:
    """Why there is no such fuzzing here; None where there is."""
    if find_spec("atheris") is None:
        return "atheris is not installed: pip install 'fgrecon[fuzzing]' (Linux, macOS)"
    return None


def guided(name: str, seconds: float, out: Path) -> Ended:
    """Fuzz a reader in a child process.

    Args:
        name: Of the reader.
        seconds: By the clock.
        out: Folder of what was found; the corpus and the child's words are below it.
    """
    from benchmarks.fuzz.run import Ended, Find

    folder = out / "guided" / name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "benchmarks.fuzz.guided", name, str(int(seconds)), str(out.resolve())]
    with (folder / "log.txt").open("wb") as log:
        code = subprocess.run(command, stdout=log, stderr=log, timeout=seconds + _GRACE, check=False).returncode
    notes = json.loads(_notes(folder).read_text()) if _notes(folder).exists() else {}
    finds = [Find(one["reader"], one["error"], one["place"], Path(one["file"])) for one in notes.pop("finds", [])]
    if code != 0:  # what no exception says: a crash, a time-out, too much memory
        left = max(folder.glob("*-*"), key=lambda path: path.stat().st_mtime, default=folder / "log.txt")
        finds.append(Find(name, f"the process ended with code {code}", "libFuzzer", left))
    return Ended(**notes, finds=finds)


def _notes(folder: Path) -> Path:
    return folder / "last.json"


class _Harness:
    """Reads what libFuzzer makes, and keeps notes."""

    def __init__(self, name: str, out: Path) -> None:
        with _instrumented():
            from benchmarks.fuzz.readers import READERS
            from benchmarks.fuzz.run import Ended, judge

            self._seeds = sorted(READERS[name].seeds().items())
            self._judge, self._name, self._out = judge, name, out
            self.ended = Ended()
            self._place = Path(tempfile.mkdtemp())
            for title, content in self._seeds:  # imports what is imported on use
                judge(name, self._place / title, content, Ended(), None)
        self.folder = out / "guided" / name.replace(" ", "_")
        self._began, self._noted = time.process_time(), 0.0

    def seeds(self) -> list[bytes]:
        """The valid files, as inputs."""
        return [bytes([i]) + content for i, (_, content) in enumerate(self._seeds)]

    def one(self, data: bytes) -> None:
        """Read one input."""
        title, _ = self._seeds[(data[0] if data else 0) % len(self._seeds)]
        self._judge(self._name, self._place / title, bytes(data[1:]), self.ended, self._out)
        if time.perf_counter() - self._noted > _NOTE_SECONDS:
            self.note()

    def note(self) -> None:
        """Write down how far it has come: libFuzzer ends the process without a word to it."""
        from dataclasses import asdict

        self.ended.seconds = time.process_time() - self._began
        _notes(self.folder).write_text(json.dumps(asdict(self.ended), default=str))
        self._noted = time.perf_counter()


def _instrumented() -> Any:
    import atheris

    return atheris.instrument_imports(include=["fgrecon"], enable_loader_override=False)


def _mutator(data: bytes, most: int, seed: int) -> bytes:
    import atheris

    if seed % 2 or len(data) < 2:
        return bytes(atheris.Mutate(data, most))
    return (data[:1] + mutated(data[1:], np.random.default_rng(seed)))[:most]


def _child(name: str, seconds: int, out: Path) -> None:
    import atheris

    harness = _Harness(name, out)
    corpus = harness.folder / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(harness.seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    warnings.simplefilter("ignore")
    largest = max(len(seed) for seed in harness.seeds())
    flags = [f"-max_total_time={seconds}", f"-timeout={_SLOW}", f"-rss_limit_mb={_MEMORY}"]
    flags += [f"-max_len={max(4096, 2 * largest)}", f"-artifact_prefix={harness.folder}/"]
    harness.note()
    atheris.Setup([sys.argv[0], *flags, str(corpus)], harness.one, custom_mutator=_mutator)
    atheris.Fuzz()


if __name__ == "__main__":
    _child(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
