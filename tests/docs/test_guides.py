"""The guides run as they stand: their commands and their Python, in order, on the files of `fgrecon sample`."""

import shlex

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from tests.conftest import REPOSITORY
from tests.docs.pages import blocks, commands

GUIDES = [
    REPOSITORY / "docs/index.md",
    *(path for path in sorted((REPOSITORY / "docs/guides").glob("*.md"))),
]
NEEDS_MORE = ("DATA", "fgrecon replay", "keypoints.npz", "learnt.npz")
"""Words of commands that need the real data, a window, or annotations of the user's."""


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """A folder in which `fgrecon sample --out sample` has run."""
    folder = tmp_path_factory.mktemp("guides")
    done = CliRunner().invoke(main.app, ["sample", "--out", str(folder / "sample")])
    assert done.exit_code == 0, done.output
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("guide", GUIDES, ids=lambda path: path.stem)
def test_its_python_and_its_commands(guide, sample, monkeypatch, capsys):
    monkeypatch.chdir(sample)
    text = guide.read_text(encoding="utf-8")
    if guide.stem == "rerun":  # its Python reads what its commands write
        run_commands(text)
    for block in blocks(text, "python"):
        exec(compile(block, guide.name, "exec"), {"__name__": guide.stem})
    if guide.stem != "rerun":
        run_commands(text)


def run_commands(text):
    for line in commands(text):
        if not any(word in line for word in NEEDS_MORE):
            done = CliRunner().invoke(main.app, shlex.split(line)[1:])
            assert done.exit_code == 0, f"{line}: {done.output}"
