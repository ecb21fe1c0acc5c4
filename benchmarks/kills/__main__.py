"""Kill long runs and let them go on: `python -m benchmarks.kills [--trials N] [--job NAME] [--out FOLDER]`.

`batch`, `run` and `keypoints train` on made-up input. A trial starts a command, kills it (SIGKILL, its workers as well
in half of the trials) at a random time, starts it again, and so on up to six times, and lets the last run end. It must
end with what an undisturbed run has, to the last byte but for times of solves, and no file may be there after a kill
that cannot be read. With the same --out it goes on where it was. Exit code 1 says that there was something.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.kills.jobs import JOBS, Job, torn
from fgrecon.io.files import write_text

_MOST_KILLS = 6
_LONGEST = 600.0  # seconds


@dataclass
class Tally:
    """What came of a job.

    Attributes:
        trials: Runs that were killed and went on.
        kills: How often they were killed.
        seconds: How long the undisturbed run worked.
        faults: What must not be.
    """

    trials: int = 0
    kills: int = 0
    seconds: float = 0.0
    faults: list[str] = field(default_factory=list)


def _started(job: Job, given: Path, out: Path) -> tuple[subprocess.Popen[bytes], Path]:
    """A child that has imported everything."""
    mark = given / "mark"
    mark.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.kills.child", str(mark), *job.arguments(given, out)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)
    while not mark.exists() and child.poll() is None:
        time.sleep(0.005)
    return child, mark


def _ended(child: subprocess.Popen[bytes]) -> str | None:
    """What went wrong with a run that was left to end."""
    said, _ = child.communicate(timeout=_LONGEST)
    return None if child.returncode == 0 else f"exit code {child.returncode}: {said.decode()[-300:]}"


def _digests(job: Job, out: Path) -> Mapping[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in job.end(out).items()}


def _trial(job: Job, given: Path, out: Path, expected: Mapping[str, str], tally: Tally, seed: list[int]) -> None:
    rng = np.random.default_rng(seed)
    whole_group = bool(rng.random() < 0.5)
    for _ in range(int(rng.integers(1, _MOST_KILLS + 1))):
        child, _ = _started(job, given, out)
        try:
            child.wait(float(rng.uniform(0.0, tally.seconds)))
        except subprocess.TimeoutExpired:
            tally.kills += 1
            if whole_group:
                os.killpg(child.pid, signal.SIGKILL)
            child.kill()
            child.communicate()
        tally.faults += [f"trial {tally.trials}: torn {one}" for one in torn(out)]
    child, _ = _started(job, given, out)
    wrong = _ended(child)
    if wrong is None:
        found = _digests(job, out)
        differ = sorted(name for name in found.keys() | expected if found.get(name) != expected.get(name))
        wrong = f"differs in {', '.join(differ[:5])}" if differ else None
    if wrong is not None:
        tally.faults.append(f"trial {tally.trials}: {wrong}")
    tally.trials += 1


def _killed(name: str, trials: int, tally: Tally) -> None:
    """Trials of a job."""
    job = JOBS[name]
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "given"
        given.mkdir()
        job.prepare(given)
        child, _ = _started(job, given, Path(folder) / "whole")
        began = time.perf_counter()
        wrong = _ended(child)
        tally.seconds = time.perf_counter() - began
        if wrong is not None:
            tally.faults.append(f"undisturbed: {wrong}")
            return
        expected = _digests(job, Path(folder) / "whole")
        for _ in range(trials):
            out = Path(folder) / "out"
            _trial(job, given, out, expected, tally, [tally.trials, *name.encode()])
            shutil.rmtree(out, ignore_errors=True)


def main() -> int:
    """Kill."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=3, help="of each command, in this run")
    parser.add_argument("--job", action="append", choices=list(JOBS), help="only this one; repeat for more")
    parser.add_argument("--out", type=Path, default=Path("kills"), help="folder of the counts")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "kills.json"
    before = json.loads(path.read_text()) if path.exists() else {}
    tallies = {name: Tally(**before.get(name, {})) for name in JOBS}
    for name in given.job or list(JOBS):
        tally = tallies[name]
        _killed(name, given.trials, tally)
        write_text(path, json.dumps({key: asdict(one) for key, one in tallies.items()}, indent=1))
        counts = f"{tally.trials} trials, {tally.kills} kills, {len(tally.faults)} faults"
        print(f"{name}: {counts}; undisturbed {tally.seconds:.1f} s", flush=True)
        print(*tally.faults, sep="\n", end="\n" if tally.faults else "")
    return int(any(tally.faults for tally in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
