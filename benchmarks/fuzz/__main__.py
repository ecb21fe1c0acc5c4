"""Damage files and read them: `python -m benchmarks.fuzz --minutes N [--reader NAME] [--guided] [--commands [NAME]]`.

Goes on where the last run with the same --out ended. What a reader raises that fgrecon does not raise on purpose is
kept there as a file and printed; exit code 1 says that there was something. Slow files are printed too. With --guided
coverage leads the way (atheris, extra `fuzzing`), and the minutes are those of the clock. With --commands it is whole
commands that read the files, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.fuzz.commands import COMMANDS, fuzz_commands
from benchmarks.fuzz.guided import guided, why_not
from benchmarks.fuzz.readers import READERS
from benchmarks.fuzz.run import Ended, Find, fuzz
from fgrecon.io.files import write_text


def main() -> int:
    """Fuzz."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="CPU minutes for each reader")
    parser.add_argument("--reader", action="append", choices=list(READERS), help="only this one; repeat for more")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder of what was found and how far it came")
    parser.add_argument("--first", type=int, default=0, help="number of the first file, where --out is a new folder")
    parser.add_argument("--guided", action="store_true", help="by coverage, with atheris; --minutes go by the clock")
    parser.add_argument(
        "--commands",
        nargs="*",
        choices=list(COMMANDS),
        metavar="NAME",
        help="whole commands that read files: these, or all",
    )
    given = parser.parse_args()
    if given.commands is not None and (given.reader or given.guided):
        parser.error("--commands goes with neither --reader nor --guided")
    if given.guided and (reason := why_not()) is not None:
        print(f"Skipped: {reason}.")
        return 0
    given.out.mkdir(parents=True, exist_ok=True)
    progress = given.out / "progress.json"
    before: dict[str, Mapping[str, float]] = json.loads(progress.read_text()) if progress.exists() else {}
    found: list[Find] = []
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # decoders of pictures tell all that they dislike
    run: Callable[[str, int, float, Path], Ended] = _guided if given.guided else fuzz
    names, kind = given.reader or list(READERS), " (guided)" if given.guided else ""
    if given.commands is not None:
        run, names, kind = fuzz_commands, given.commands or list(COMMANDS), " (command)"
    for name in names:
        key = name + kind
        start, seconds = int(before.get(key, {}).get("files", given.first)), 60.0 * given.minutes
        ended = run(name, start, seconds, given.out)
        found += ended.finds
        spent = float(before.get(key, {}).get("cpu_minutes", 0.0)) + ended.seconds / 60.0
        before[key] = {"files": start + ended.files, "cpu_minutes": round(spent, 2)}
        write_text(progress, json.dumps(before, indent=1))
        counts = f"{before[key]['files']} files in {spent:.1f} CPU minutes, {len(ended.finds)} new finds"
        print(f"{key}: {counts}, slowest {ended.slowest:.2f} s", flush=True)
    _print(found)
    return int(bool(found))


def _guided(name: str, _start: int, seconds: float, out: Path) -> Ended:
    return guided(name, seconds, out)


def _print(found: Sequence[Find]) -> None:
    for find in found:
        print(f"{find.reader}: {find.error} ({find.place}); {find.file}")


if __name__ == "__main__":
    sys.exit(main())
