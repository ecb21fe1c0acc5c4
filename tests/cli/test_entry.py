"""Ctrl-C ends the command line by exit code 130 without a traceback, from its first import on."""

import os
import signal
import subprocess
import sys
import tomllib

import pytest

from fgrecon.cli import entry, main
from tests.cli.conftest import INTRINSICS
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


@pytest.fixture(autouse=True)
def threads(monkeypatch):
    """What `main` says of threads is no longer said after the test."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
def test_what_is_closed_is_not_used(closed, write, instance):
    """As some that start programs leave it; what shall go there is refused."""
    command = f"{sys.executable} -m fgrecon reconstruct {write(instance)} {INTRINSICS}"
    done = subprocess.run(f"{command} {closed}", shell=True, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run(f"{command} --json - {closed}", shell=True, capture_output=True, text=True, check=False)
    assert done.returncode == (2 if closed == ">&-" else 0)
    assert "Traceback" not in done.stderr


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
    assert scripts == {"fgrecon": "fgrecon.cli.entry:run"}


ENDING = """
import atexit, threading, time
from fgrecon.cli import entry

def late():
    time.sleep(0.2)
    print("thread", flush=True)

atexit.register(print, "registered")
threading.Thread(target=late).start()
entry.main = lambda: exit({code!r})
entry.run()
"""


@pytest.mark.parametrize(("code", "status"), [(None, 0), (3, 3), ("a message", 1)])
def test_the_end_waits_for_threads_and_calls_what_is_registered(code, status):
    command = [sys.executable, "-c", ENDING.format(code=code)]
    done = subprocess.run(command, capture_output=True, check=False, text=True)
    assert (done.returncode, done.stdout.split()) == (status, ["thread", "registered"])
    assert done.stderr == ("" if code != "a message" else "a message\n")


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "1"), ({"OMP_NUM_THREADS": "2"}, None), ({"OPENBLAS_NUM_THREADS": "3"}, "3")],
)
def test_no_thread_waits_for_large_matrices_unless_somebody_wants_some(monkeypatch, given, expected):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, given[name]) if name in given else monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(main, "main", lambda: None)
    entry.main()
    assert os.environ.get("OPENBLAS_NUM_THREADS") == expected


def test_a_reader_that_has_gone_is_an_error_as_ever():
    program = "from fgrecon.cli import entry; entry.main = lambda: print('x' * 10); entry.run()"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert b"BrokenPipeError" in process.stderr.read()
    assert process.returncode != 0
