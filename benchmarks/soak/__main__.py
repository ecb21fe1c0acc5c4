"""Random problems, most of them nonsense: `python -m benchmarks.soak --problems N [--seed S] [--out FOLDER]`.

Cars, scenes, tracks with missing images and videos: 0 to 14 points, 0 to 100 % outliers, all depths, views, intrinsics,
kinds of evidence and, of cars, robust strategies. Counts what they come to and prints what must not be: an error that
fgrecon does not raise on purpose, a number that is not finite, an absurd size or a place behind the camera in a result
that is not flagged, an energy that rises, other bits for the same input, more than five seconds of CPU time. What takes
twenty minutes is a hang: its place is printed and the run ends. Exit code 1 says that there was something.

With --out the run goes on where the last one with the same seed ended; --minutes ends it before all are solved.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from benchmarks.soak.problems import faults, problem
from benchmarks.soak.watch import watched
from fgrecon.core.errors import FactorCallbackError, FgreconError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.files import write_text

_SLOW = 5.0  # CPU seconds for one car, or for a car of a scene or an image of a track
_AGAIN = 20  # every so many-th problem is solved twice
_HANG = 1200.0  # seconds by the clock, which may be few of one's own
_SAVED = 50  # problems after which the counts are written


@dataclass
class Soak:
    """How far it has come.

    Attributes:
        seed: Of all problems.
        problems: Solved so far; the same number makes the same problem.
        minutes: CPU time.
        counts: How many came to what.
        faults: What must not be.
        slowest: CPU seconds for each car or image of the slowest problem, and which.
        steps: Steps of the solvers.
        highest: The highest rise of an energy, relative to it and one nat.
    """

    seed: int = 0
    problems: int = 0
    minutes: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    slowest: tuple[float, str] = (0.0, "")
    steps: int = 0
    highest: float = 0.0

    def one_more(self) -> None:
        """Solve the next problem."""
        number = self.problems
        kind, size, solve = problem([self.seed, number])
        counts, name = Counter(self.counts), f"{kind} {number}"
        results: Sequence[Reconstruction] = []
        began = time.process_time()
        faulthandler.dump_traceback_later(_HANG, exit=True)
        with watched() as watch:
            try:
                results = solve()
                counts.update(f"{kind}: {result.status.value}" for result in results)
            except FactorCallbackError as error:  # of a caller's own factor alone
                self.faults.append(f"{name}: {error}")
            except FgreconError as error:
                counts[f"{kind}: {type(error).__name__}"] += 1
            except Exception as error:  # noqa: BLE001  # that is the question
                self.faults.append(f"{name}: {type(error).__name__}: {error}")
            seconds = time.process_time() - began
            again = [one.camera_T_object.tobytes() for one in solve()] if results and number % _AGAIN == 0 else None
        faulthandler.cancel_dump_traceback_later()
        self.slowest = max(self.slowest, (round(seconds / size, 2), name))
        self.faults += [f"{name}: {fault}" for fault in faults(results)]
        if seconds / size > _SLOW:
            self.faults.append(f"{name}: {seconds / size:.2f} s each")
        if watch.rises:
            self.faults.append(
                f"{name}: {watch.rises} of {watch.steps} steps rise, by {watch.highest:.1e} of the energy"
            )
        if again is not None and again != [one.camera_T_object.tobytes() for one in results]:
            self.faults.append(f"{name}: other bits")
        self.counts, self.problems = dict(sorted(counts.items())), number + 1
        self.steps, self.highest = self.steps + watch.steps, max(self.highest, watch.highest)
        self.minutes += (time.process_time() - began) / 60.0


def main() -> int:
    """Solve them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=1000, help="how many in all, over all runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="CPU minutes after which this run ends")
    parser.add_argument("--out", type=Path, help="folder of how far it came")
    given = parser.parse_args()
    soak, path = Soak(given.seed), None
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        path = given.out / f"soak-{given.seed}.json"
        if path.exists():
            soak = Soak(**json.loads(path.read_text()))
            soak.slowest = (soak.slowest[0], soak.slowest[1])
    problem([0, 0])[2]()  # loads what is loaded on use
    most = soak.minutes + given.minutes
    while soak.problems < given.problems and soak.minutes < most:
        soak.one_more()
        if path is not None and soak.problems % _SAVED == 0:
            write_text(path, json.dumps(asdict(soak), indent=1))
    if path is not None:
        write_text(path, json.dumps(asdict(soak), indent=1))
    for name, count in soak.counts.items():
        print(f"{name}: {count}")
    print(f"{soak.problems} problems in {soak.minutes:.1f} CPU minutes, {len(soak.faults)} faults")
    print(f"slowest {soak.slowest[0]:.2f} s each: {soak.slowest[1]}")
    print(f"{soak.steps} steps, the highest rise of an energy {soak.highest:.1e} of it")
    print(*soak.faults, sep="\n")
    return int(bool(soak.faults))


if __name__ == "__main__":
    sys.exit(main())
