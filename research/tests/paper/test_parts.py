"""`fgrecon evaluate paper --fresh` deletes the parts that it stored, after it has read its data, and nothing else."""

from dataclasses import fields

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon_research.evaluation import methods
from fgrecon_research.paper import run
from fgrecon_research.paper.parts import delete_parts, stored_parts
from fgrecon_research.paper.simulated_scores import Scores

DIGEST = "0123456789ab"


@pytest.fixture
def parts(tmp_path):
    """Two stored parts among files of the user's."""
    folder = tmp_path / "out" / "parts"
    for name in ("validation", "known_shape", "mine"):
        (folder / name).mkdir(parents=True)
    np.savez(folder / "validation" / f"000035-{DIGEST}.npz", **{f.name: np.zeros(1) for f in fields(Scores)})
    np.savez(folder / "known_shape" / f"27-{DIGEST}.npz", table=np.zeros(1), failures=np.zeros(1))
    (folder / "notes.txt").write_text("mine")
    (folder / "validation" / "notes.npz").write_text("mine")
    (folder / "validation" / f"mine-{DIGEST}.npz").write_text("mine")
    np.savez(folder / "validation" / f"other-{DIGEST}.npz", mine=np.zeros(1))
    np.savez(folder / "mine" / f"27-{DIGEST}.npz", table=np.zeros(1), failures=np.zeros(1))
    return folder


def files(folder):
    return {path for path in folder.rglob("*") if path.is_file()}


def test_only_stored_parts_are_deleted(parts):
    before, stored = files(parts), set(stored_parts(parts))
    assert {path.relative_to(parts).as_posix() for path in stored} == {
        f"validation/000035-{DIGEST}.npz",
        f"known_shape/27-{DIGEST}.npz",
    }
    assert delete_parts(parts) == 2
    assert files(parts) == before - stored
    assert delete_parts(parts / "absent") == 0


def evaluate(parts, data):
    arguments = ["evaluate", "paper", "--fresh", "--out", parts.parent, "--data", data, "--quiet"]
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_nothing_is_deleted_without_data(parts, tmp_path):
    before = files(parts)
    done = evaluate(parts, tmp_path / "absent")
    assert isinstance(done.exception, InvalidInputError)
    assert done.exception.field == "data"
    assert files(parts) == before


def test_parts_are_deleted_once_the_data_are_read(parts, tmp_path, monkeypatch):
    class StopError(Exception):
        pass

    def conditions(*_, **__):
        raise StopError

    monkeypatch.setattr(run._Inputs, "read", lambda settings: run._Inputs(None, None, [], [], None))
    monkeypatch.setattr(run, "run_conditions", conditions)
    before, stored = files(parts), set(stored_parts(parts))
    assert isinstance(evaluate(parts, tmp_path).exception, StopError)
    assert files(parts) == before - stored


def test_a_baseline_that_is_not_installed_is_told_before_the_data_are_read(parts, tmp_path, monkeypatch):
    monkeypatch.setattr(methods, "find_spec", lambda name: None)
    error = evaluate(parts, tmp_path).exception
    assert isinstance(error, InvalidInputError)
    assert "fgrecon-research" in error.fix
