"""Kernels that were compiled from other sources than those that are there are refused: they may compute otherwise."""

import shutil
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

import factors.native
from factors.errors import InvalidInputError
from factors.native import native
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.skipif(native("factors._rows") is None, reason="no compiled kernel")


@pytest.fixture
def found(monkeypatch):
    """As in a process that has not looked for any."""
    kept: dict[str, object] = {}
    monkeypatch.setattr(factors.native, "_FOUND", kept)
    return kept


@pytest.mark.parametrize("changed", ["_rows.pyx", "_rows.pxd"])
def test_a_source_that_changed_is_named_with_the_fix(changed, found, tmp_path, monkeypatch):
    for name in ("_rows.pyx", "_rows.pxd"):
        shutil.copy(REPOSITORY / "factors" / name, tmp_path)
    module = sys.modules["factors._rows"]
    monkeypatch.setattr(module, "__file__", str(tmp_path / f"_rows{EXTENSION_SUFFIXES[0]}"))
    assert native("factors._rows") is module
    found.clear()
    with (tmp_path / changed).open("a") as file:
        file.write("# another\n")
    with pytest.raises(InvalidInputError, match=r"pip install -e \.") as caught:
        native("factors._rows")
    assert caught.value.field == "factors._rows"


def test_one_without_a_checksum_is_of_an_older_version(found, monkeypatch):
    monkeypatch.delattr(sys.modules["factors._rows"], "SOURCES")
    with pytest.raises(InvalidInputError, match="another version"):
        native("factors._rows")


def test_one_that_wants_what_is_no_longer_there_is_not_taken_for_one_that_was_not_built(found, tmp_path, monkeypatch):
    (tmp_path / "of_before.py").write_text("from factors.box import GONE")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InvalidInputError, match="another version"):
        native("of_before")
    assert native("factors._not_built") is None


def test_without_sources_nothing_is_compared(found, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules["factors._rows"], "__file__", str(Path(tmp_path, "_rows.so")))
    assert native("factors._rows") is not None
