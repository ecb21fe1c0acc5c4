"""The entry point: help, version, exit codes."""

import json
import os
import resource
import subprocess
import sys
from importlib import metadata

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import FgreconError

from .conftest import INTRINSICS

MAIN = "from fgrecon.cli.main import main; main()"


def test_version_and_help():
    runner = CliRunner()
    assert runner.invoke(main.app, ["--version"]).stdout == f"fgrecon {metadata.version('fgrecon')}\n"
    shown = runner.invoke(main.app, ["--help"])
    assert shown.exit_code == 0
    for command in ("demo", "reconstruct", "evaluate", "prior"):
        assert command in shown.stdout


@pytest.mark.parametrize("arguments", [["fly"], ["reconstruct"], ["reconstruct", "a.json", "--strategy", "best"]])
def test_bad_usage_gives_exit_code_2(arguments):
    command = [sys.executable, "-c", MAIN, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (FgreconError("box: got 3. Give 4."), "fgrecon: box: got 3. Give 4.\n"),
        (PermissionError(13, "Permission denied", "out.json"), "fgrecon: out.json: Permission denied. "),
        (OSError("the disk is full"), "fgrecon: file: the disk is full. "),
    ],
)
def test_expected_errors_are_one_line_and_exit_code_2(monkeypatch, capsys, error, line):
    def fail():
        raise error

    monkeypatch.setattr(main, "app", fail)
    with pytest.raises(SystemExit) as end:
        main.main()
    assert end.value.code == 2
    printed = capsys.readouterr().err
    assert printed.startswith(line)
    assert printed.count("\n") == 1


def test_unexpected_errors_keep_their_traceback(monkeypatch):
    def fail():
        raise ZeroDivisionError

    monkeypatch.setattr(main, "app", fail)
    with pytest.raises(ZeroDivisionError):
        main.main()


def fgrecon(*arguments, **how):
    """The command in a process of its own."""
    command = [sys.executable, "-c", MAIN, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, check=False, **how)


@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}]
)
def test_an_output_that_knows_ascii_alone(write, instance, environment):
    file = write({"instances": [instance | {"id": "Käfer 🚗"}]})
    environment = {**os.environ, **environment}
    done = fgrecon("reconstruct", file, INTRINSICS, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"yaw ?" in done.stdout
    data = fgrecon("reconstruct", file, INTRINSICS, "--json", "-", "-q", env=environment)
    assert data.returncode == 0
    assert json.loads(data.stdout.decode("ascii"))["instances"][0]["id"] == "Käfer 🚗"


def without_room():
    """Let no file of this process grow, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


@pytest.mark.parametrize("arguments", [[], ["--json", "-", "-q"]])
def test_an_output_without_room_is_named(write, instance, tmp_path, arguments):
    file = write({"instances": [instance]})
    with (tmp_path / "output").open("w") as output:
        command = [sys.executable, "-c", MAIN, "reconstruct", file, INTRINSICS, *arguments]
        done = subprocess.run(command, stdout=output, stderr=subprocess.PIPE, preexec_fn=without_room, check=False)
    assert done.stderr.decode() == "fgrecon: standard output: File too large. Send it where there is room.\n"
    assert done.returncode == 2


@pytest.mark.parametrize("arguments", [["reconstruct", "none.json"], ["reconstruct", "--strategy", "none"]])
def test_bad_input_is_exit_code_2_where_nothing_can_be_said(tmp_path, arguments):
    with (tmp_path / "errors").open("w") as errors:
        done = subprocess.run(
            [sys.executable, "-c", MAIN, *arguments], stderr=errors, preexec_fn=without_room, check=False
        )
    assert done.returncode == 2


@pytest.mark.parametrize("arguments", [[], ["--json", "-", "-q"]])
def test_a_reader_that_has_enough_ends_it_without_a_word(write, instance, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-c", MAIN, "reconstruct", write(instance), INTRINSICS, *arguments]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")
