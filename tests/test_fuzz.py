"""A short run of the fuzzer on every reader, and the files that longer ones have found."""

import codecs
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fuzz import __main__ as command
from benchmarks.fuzz import guided as by_coverage
from benchmarks.fuzz.commands import COMMANDS, Outcome, fuzz_commands, outcome
from benchmarks.fuzz.mutate import mutated
from benchmarks.fuzz.readers import READERS
from benchmarks.fuzz.run import fuzz, read

CORPUS = Path(__file__).parent / "corpus"
FILES = sorted(path for path in CORPUS.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", READERS)
def test_the_valid_files_are_read(name, tmp_path):
    for title, content in READERS[name].seeds().items():
        (tmp_path / title).write_bytes(content)
        if name != "weights":  # the start of a network alone: it must be refused
            READERS[name].read(tmp_path / title)


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("how", ["byte order mark", "line ends"])
def test_files_of_windows_read_the_same(name, how, tmp_path):
    for title, content in READERS[name].seeds().items():
        try:
            content.decode()
        except UnicodeDecodeError:
            continue
        (path := tmp_path / title).write_bytes(content)
        expected = repr(READERS[name].read(path))
        path.write_bytes(codecs.BOM_UTF8 + content if how == "byte order mark" else content.replace(b"\n", b"\r\n"))
        assert repr(READERS[name].read(path)) == expected, title


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_refused_on_purpose(name):
    ended = fuzz(name, start=10**9, seconds=2.0, most=150)
    assert ended.finds == []
    assert ended.files > 20


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_was_found_once_is_refused_on_purpose(path, tmp_path):
    title = path.name.partition("-")[2]
    assert read(path.parent.name.replace("_", " "), tmp_path / title, path.read_bytes()) is None


def test_damage_is_the_same_for_the_same_number():
    content = b'{"a": [1, 2, {"b": "c"}]}\n'
    for number in range(50):
        first, second = (mutated(content, np.random.default_rng(number)) for _ in range(2))
        assert first == second
    assert len({mutated(content, np.random.default_rng(number)) for number in range(50)}) > 30


def test_without_atheris_guided_fuzzing_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(by_coverage, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "argv", ["fuzz", "--guided", "--out", str(tmp_path / "out")])
    assert command.main() == 0
    assert "atheris is not installed: pip install 'fgrecon[fuzzing]'" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_coverage_leads_to_more_files(tmp_path):
    pytest.importorskip("atheris")
    ended = by_coverage.guided("names", 4.0, tmp_path)
    assert ended.finds == []
    assert ended.files > 10
    assert len(list((tmp_path / "guided" / "names" / "corpus").iterdir())) > len(READERS["names"].seeds())


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_bear_damaged_files(name):
    ended = fuzz_commands(name, start=10**9, seconds=60.0, most=1)
    assert ended.finds == []
    assert ended.files == 1


def test_what_is_wrong_with_a_command_is_reported(tmp_path):
    assert outcome("prior show nothing", tmp_path).fault is None
    assert outcome("prior show nothing", tmp_path).code == 2
    trace = "Traceback (most recent call last):\n  a\nValueError: b\n"
    for code, said, memory, fault in (
        (1, trace, 10.0, "ValueError: b"),
        (-11, "", 0.0, "ExitCode: -11"),
        (0, "", 2000.0, "MemoryError: 2000 MiB"),
        (None, "", 0.0, "TimeoutError: 60 seconds"),
    ):
        assert fault in str(Outcome(code, said, memory, 60.0).fault)
