"""Ctrl-C ends the command line by exit code 130 without a traceback, from its first import on."""

import signal
import subprocess
import sys
import tomllib

import pytest

from fgrecon.cli import entry, main
from tests.conftest import REPOSITORY

DURING = """
import os, signal, sys

class Interrupts:
    def find_spec(self, name, *_):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
from fgrecon.cli.entry import main
main()
"""


@pytest.mark.parametrize("module", ["fgrecon.cli.main", "typer", "fgrecon.cli.run", "gtsam", "rich.markup"])
def test_while_modules_are_imported(module, write, instance):
    command = [sys.executable, "-c", DURING.format(module=module), "reconstruct", write(instance)]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 130
    assert b"Traceback" not in done.stderr


def test_what_an_interrupt_turned_into(monkeypatch):
    """As compiled modules make an ImportError of it."""

    def turned():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(main, "main", turned)
    try:
        with pytest.raises(SystemExit) as end:
            entry.main()
    finally:
        signal.signal(signal.SIGINT, before)
    assert end.value.code == 130


def test_other_errors_keep_their_traceback_and_who_ignores_interrupts_goes_on(monkeypatch):
    def fail():
        signal.raise_signal(signal.SIGINT)
        raise ZeroDivisionError

    monkeypatch.setattr(main, "main", fail)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with pytest.raises(ZeroDivisionError):
            entry.main()
    finally:
        signal.signal(signal.SIGINT, before)


def test_it_is_the_command():
    scripts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {"fgrecon": "fgrecon.cli.entry:main"}
