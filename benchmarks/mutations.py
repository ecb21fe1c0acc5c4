"""Faults put into the solver on purpose, one at a time: each must turn a test red.

Run from the repository root:
    python -m benchmarks.mutations [--list] [--only NAME ...] [--seconds 600]
A fault is a replacement of text in a temporary copy of the packages, in which the tests that guard the place are run.
Before any of them the same tests must pass on the unchanged copy. Prints the first failing test of each; the exit code
is 1 where a fault survives, that is where the tests pass all the same. The real data is not used.

`tests/test_mutations.py` checks that each text is still there, exactly once; the faults are listed in
`benchmarks.mutations_list`.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.mutations_list import MUTATIONS, Mutation

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("factors", "fgrecon", "tests", "pyproject.toml")
TESTS_FAILED = 1  # pytest's exit code; the others say that it could not run them


class OutdatedError(Exception):
    """A mutation's text is not in its file exactly once, or its tests do not pass without it."""


def mutated(text: str, mutation: Mutation) -> str:
    """A file's text with the fault in it.

    Raises:
        OutdatedError: A text to be replaced is not there exactly once.
    """
    for old, new in mutation.edits:
        count = text.count(old)
        if count != 1:
            raise OutdatedError(f"{mutation.name}: {mutation.file} has {count} times\n{old}")
        text = text.replace(old, new)
    return text


def copy_to(folder: Path) -> None:
    """Copy what the tests need of the repository."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            shutil.copy2(source, folder / name)


def run_tests(folder: Path, tests: Sequence[str], seconds: float, failures: int) -> tuple[int, list[str], str]:
    """Run tests of a copy up to so many failures.

    Returns:
        pytest's exit code (-1 where the time was up), the tests that failed, and what it printed.
    """
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", "--tb=no", f"--maxfail={failures}", "-m", "not data"]
    # No bytecode: a change of one character within a second would not be seen.
    settings = {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [*command, "-p", "no:cacheprovider", *tests],
            cwd=folder,
            env={**os.environ, "FGRECON_KERNEL": "numpy", **settings},  # the faults are in the numpy versions
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return -1, [f"no end within {seconds:.0f} s"], ""
    failed = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return done.returncode, failed, done.stdout + done.stderr


def judge(folder: Path, mutation: Mutation, seconds: float) -> list[str]:
    """The tests that fail under a fault; fewer than it asks for where it survives.

    Raises:
        OutdatedError: A text is not there exactly once, or the tests could not be run.
    """
    path = folder / mutation.file
    text = path.read_text(encoding="utf-8")
    path.write_text(mutated(text, mutation), encoding="utf-8")
    try:
        code, failed, output = run_tests(folder, mutation.tests, seconds, mutation.red)
    finally:
        path.write_text(text, encoding="utf-8")
    if code > TESTS_FAILED:
        raise OutdatedError(f"{mutation.name}: pytest ended with {code}\n{output}")
    return failed * mutation.red if code < 0 else failed  # a hang or a dead process is seen by everybody


def run(chosen: Sequence[Mutation], seconds: float, console: Console) -> int:
    """Try the mutations and print how each ends; the number that survive."""
    survivors = 0
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with tempfile.TemporaryDirectory() as name, Progress(*columns, console=console, transient=True) as progress:
        folder = Path(name)
        copy_to(folder)
        task = progress.add_task("without any", total=len(chosen) + 1)
        guards = {test for mutation in chosen for test in mutation.tests}
        whole = [test for test in guards if test.partition("::")[0] not in guards - {test}]
        code, failed, output = run_tests(folder, sorted(whole), len(chosen) * seconds, len(guards))
        if code != 0:
            raise OutdatedError(f"the tests do not pass without any mutation: {failed}\n{output}")
        progress.advance(task)
        for mutation in chosen:
            progress.update(task, description=mutation.name)
            started = time.monotonic()
            failed = judge(folder, mutation, seconds)
            killed = len(failed) >= mutation.red
            survivors += not killed
            ending = "[green]killed  [/]" if killed else "[red]survived[/]"
            first = escape(failed[0]) if failed else "no test fails"
            more = f" and {len(failed) - 1} more" if len(failed) > 1 else ""
            took = f"{time.monotonic() - started:3.0f} s"
            progress.console.print(f"{ending} {took}  {mutation.name}: {first}{more}", soft_wrap=True, highlight=False)
            progress.advance(task)
    console.print(f"{len(chosen) - survivors} of {len(chosen)} killed")
    return survivors


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="name the mutations and end")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=[m.name for m in MUTATIONS], help="try these")
    parser.add_argument("--seconds", type=float, default=600.0, help="limit for the tests of one mutation")
    arguments = parser.parse_args()
    console = Console()
    if arguments.list:
        for mutation in MUTATIONS:
            console.print(f"{mutation.name}: {mutation.what} ({mutation.file})", soft_wrap=True, highlight=False)
        return 0
    chosen = [m for m in MUTATIONS if arguments.only is None or m.name in arguments.only]
    try:
        return int(run(chosen, arguments.seconds, console) > 0)
    except OutdatedError as error:
        console.print(str(error), style="red", soft_wrap=True, markup=False)
        return 2


if __name__ == "__main__":
    sys.exit(main())
