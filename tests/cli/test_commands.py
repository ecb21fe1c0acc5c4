"""Groups of options, and what holds for every command: help, completion, quiet and verbose."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from rich.text import Text
from typer.main import get_command
from typer.testing import CliRunner

from fgrecon.cli.commands import add_command
from fgrecon.cli.main import app

ROOT = get_command(app)


def commands(group=ROOT, path=()):
    """Path and command of everything that can be run."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


COMMANDS = dict(commands())


@dataclass(frozen=True)
class Pair:
    left: Annotated[int, typer.Option(help="One.")]
    right: Annotated[int, typer.Option("--right", "-r", help="Other.")] = 2


def test_a_group_becomes_its_fields():
    seen = []
    made = typer.Typer()

    @made.callback()
    def root():
        """A command line."""

    def command(pair: Pair, name: Annotated[str, typer.Argument()], last: bool = False):
        """Add."""
        seen.append((pair, name, last))

    add_command(made, "add", command)
    assert CliRunner().invoke(made, ["add", "x", "--left", "1", "-r", "3", "--last"]).exit_code == 0
    assert seen == [(Pair(1, 3), "x", True)]
    assert CliRunner().invoke(made, ["add", "x"]).exit_code == 2  # --left has no default


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_the_help_shows_all_that_was_written(path):
    """Brackets are markup to rich, which drops what it takes for a tag."""
    texts = [COMMANDS[path].help, *(getattr(p, "help", None) for p in COMMANDS[path].params)]
    for text in filter(None, texts):
        assert Text.from_markup(text).plain == text.replace("\\[", "["), text


@pytest.mark.parametrize("words", ["evaluate", "keypoints train", "prior learn", "vehicles convert"])
def test_what_another_package_brings_says_so(words):
    """In a process that finds no installed command of another package."""
    code = (
        "import sys, importlib.metadata as m; m.entry_points = lambda **_: ();"
        f"sys.argv = ['fgrecon', *{words.split()}]; from fgrecon.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"fgrecon {words} needs fgrecon-research" in done.stderr
    assert done.stderr.endswith("in a checkout of fgrecon, pip install ./research\n")  # no index has it


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_the_words_are_the_same_everywhere(path):
    options = {name: p for p in COMMANDS[path].params for name in p.opts}
    assert "--quiet" in options
    assert "-q" in options
    assert {"--rrd", "--csv", "--md"}.isdisjoint(options)
    if "--json" in options:
        assert options["--json"].metavar == "FILE"
    if "--save" in options:
        assert options["--save"].metavar == "FILE.rrd"
    if "--data" in options:
        assert options["--data"].envvar == "FGRECON_DATA"
    if "--verbose" in options:
        assert "--verbose" in COMMANDS[path].help


def complete(words):
    """What bash is offered for the last word."""
    environment = {**os.environ, "_FGRECON_COMPLETE": "complete_bash", "COMP_WORDS": words}
    environment["COMP_CWORD"] = str(len(words.split(" ")) - 1)
    code = "import sys; sys.argv[0] = 'fgrecon'; from fgrecon.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    return done.stdout.split()


def test_the_shell_completes_names():
    assert "car14" in complete("fgrecon prior show car")
    assert complete("fgrecon reconstruct cars.json --size-prior k") == ["kitti", "kitti_traffic"]
    assert "sqpnp+size" in complete("fgrecon evaluate tracks t.json --method sq")
    assert "gnc" in complete("fgrecon reconstruct cars.json --strategy g")


@pytest.mark.parametrize("words", ["", "evaluate", "keypoints", "prior", "vehicles"])
def test_the_help_imports_nothing_heavy(words):
    heavy = {"torch", "cv2", "gtsam", "rerun", "matplotlib", "scipy"}
    code = (
        "import sys; from fgrecon.cli import main; from typer.testing import CliRunner;"
        f"shown = CliRunner().invoke(main.app, [*{words.split()}, '--help']); assert shown.exit_code == 0;"
        f"print(*{heavy} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_progress_is_shown_when_asked_for_and_never_when_quiet(tmp_path):
    assert CliRunner().invoke(app, ["sample", "--out", str(tmp_path), "--quiet"]).output == ""
    arguments = [
        "evaluate",
        "tracks",
        str(tmp_path / "TRACK.json"),
        "--method",
        "epnp",
        "--json",
        str(tmp_path / "r.json"),
    ]
    shown = CliRunner().invoke(app, [*arguments, "--progress"], env={"TERM": "xterm", "FORCE_COLOR": "1"})
    assert re.search(r"Frames.*8/8", shown.stderr), shown.stderr
    assert "Frames" not in CliRunner().invoke(app, arguments).stderr
    quiet = CliRunner().invoke(app, [*arguments, "--progress", "--quiet"])
    assert quiet.output == ""
    assert (tmp_path / "r.json").exists()
