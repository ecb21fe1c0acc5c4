"""The soak and the kills: that they go on where they were, and see what they are to see."""

import json
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.kills.jobs import torn
from benchmarks.soak import __main__ as command
from benchmarks.soak.problems import faults, problem

pytestmark = pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")  # they are odd


def soak(monkeypatch, out, problems):
    arguments = ["soak", "--problems", str(problems), "--seed", "5", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", arguments)
    assert command.main() == 0
    found = json.loads((out / "soak-5.json").read_text())
    return {name: value for name, value in found.items() if name not in ("minutes", "slowest")}


def test_a_soak_goes_on_where_it_was(monkeypatch, tmp_path):
    first = soak(monkeypatch, tmp_path / "a", 2)
    assert first["problems"] == 2
    assert soak(monkeypatch, tmp_path / "a", 4) == soak(monkeypatch, tmp_path / "b", 4)


def test_a_soak_finds_faults(monkeypatch, tmp_path):
    def bad(seed):
        return "car", 1, lambda: [][seed[-1]]

    monkeypatch.setattr(command, "problem", bad)
    found = command.Soak(1)
    found.one_more()
    assert found.faults == ["car 0: IndexError: list index out of range"]
    assert faults([]) == []


def test_the_same_number_is_the_same_problem():
    kinds = [(problem([9, number])[:2], problem([9, number])[:2]) for number in range(20)]
    assert all(first == second for first, second in kinds)
    assert {kind for (kind, _), _ in kinds} == {"car", "scene", "track", "video"}


@pytest.mark.parametrize("name", ["a.parquet", "b.json", "c.npz", "d.csv"])
def test_half_written_files_are_seen(tmp_path, name):
    path = tmp_path / name
    if path.suffix == ".parquet":
        pq.write_table(pa.table({"x": [1, 2, 3]}), path)
    elif path.suffix == ".npz":
        np.savez(path, x=np.arange(100))
    else:
        path.write_text('{"a": [1, 2]}' if path.suffix == ".json" else "x,y\n1,2\n")
    assert torn(tmp_path) == []
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 3])
    (found,) = torn(tmp_path)
    assert found.startswith(f"{name}: ")
    path.rename(tmp_path / f".{name}.part")
    assert torn(tmp_path) == []


@pytest.mark.parametrize("number", [446, 861])
def test_no_step_of_a_scene_raises_its_energy(number):
    """Not the last one of a solve that ends early either, as vehicles do that the scene goes on from."""
    found = command.Soak(31, problems=number)
    found.one_more()
    assert found.faults == []
    assert found.steps > 50


@pytest.mark.parametrize("number", [(48, 3810)])
def test_what_a_soak_has_found_stays_mended(number):
    """A scene whose ground is as good as undetermined."""
    _, _, solve = problem([*number])
    assert faults(solve()) == []
