"""Damage files and read them, for as long as wanted: `python -m benchmarks.fuzz --minutes N [--reader NAME]`.

Goes on where the last run with the same --out ended. What a reader raises that fgrecon does not raise on purpose is
kept there as a file and printed; exit code 1 says that there was something. Slow files are told as well.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.fuzz.readers import READERS
from benchmarks.fuzz.run import Find, fuzz


def main() -> int:
    """Fuzz."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="CPU minutes for each reader")
    parser.add_argument("--reader", action="append", choices=list(READERS), help="only this one; repeat for more")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder of what was found and how far it came")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    progress = given.out / "progress.json"
    before: dict[str, Mapping[str, float]] = json.loads(progress.read_text()) if progress.exists() else {}
    found: list[Find] = []
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # decoders of pictures tell all that they dislike
    for name in given.reader or list(READERS):
        start = int(before.get(name, {}).get("files", 0))
        ended = fuzz(name, start, 60.0 * given.minutes, given.out)
        found += ended.finds
        spent = float(before.get(name, {}).get("cpu_minutes", 0.0)) + ended.seconds / 60.0
        before[name] = {"files": start + ended.files, "cpu_minutes": round(spent, 2)}
        progress.write_text(json.dumps(before, indent=1))
        slow = f", slowest {ended.slowest:.2f} s"
        print(f"{name}: {before[name]['files']} files in {spent:.1f} CPU minutes, {len(ended.finds)} new finds{slow}")
    _print(found)
    return int(bool(found))


def _print(found: Sequence[Find]) -> None:
    for find in found:
        print(f"{find.reader}: {find.error} ({find.place}); {find.file}")


if __name__ == "__main__":
    sys.exit(main())
