"""Paths that are links to themselves: one line, whichever command has them and whatever for."""

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError


@pytest.fixture
def files(tmp_path):
    for name in ("loop.json", "loop.csv"):
        (tmp_path / name).symlink_to(name)
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / "b.txt").write_text("Car 0 0 0 20 30 110 80 1.5 1.6 4.0 0.5 1.6 15.0 1.5\n")
    (tmp_path / "st.png").write_bytes(b"no pixels")
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "0.png").write_bytes(b"no pixels")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ["export", "c.json", "loop.csv"],
        ["reconstruct", "c.json", "--json", "loop.json"],
        ["reconstruct", "c.json", "--prior", "loop.json"],
        ["run", "images", "--out", "loop.json"],
        ["run", "images", "--out", "loop.json/deeper"],
        ["run", "loop.json", "--out", "out"],
        ["run", "images", "--out", "out", "--tracks", "loop.json"],
        ["batch", "c.json", "--out", "loop.json"],
        ["refine", "b.txt", "st.png", "--out", "loop.json"],
    ],
)
def test_a_link_to_itself_is_refused(files, monkeypatch, arguments):
    monkeypatch.chdir(files)
    done = CliRunner().invoke(main.app, arguments)
    assert isinstance(done.exception, InvalidInputError | OSError), repr(done.exception)  # one line in `main`
    assert "loop." in str(done.exception)
