"""Files are written whole or not at all."""

import os

import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes, write_text


def test_content_and_permissions(tmp_path):
    file = tmp_path / "a.txt"
    assert write_text(file, "één\r\n") == file
    assert file.read_bytes() == "één\r\n".encode()
    (tmp_path / "plain").touch()
    assert file.stat().st_mode == (tmp_path / "plain").stat().st_mode
    file.chmod(0o600)
    write_bytes(str(file), b"new")
    assert (file.read_bytes(), file.stat().st_mode & 0o777) == (b"new", 0o600)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "plain"]


@pytest.mark.parametrize("step", ["fsync", "fdopen"])
def test_a_failure_leaves_the_old_file_and_no_other(tmp_path, monkeypatch, step):
    file = tmp_path / "a.txt"
    write_text(file, "old")

    def fail(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(InvalidInputError, match="No space left"):
        write_text(file, "new")
    assert file.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_link_keeps_pointing(tmp_path):
    (tmp_path / "target").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "new"


def test_no_folder(tmp_path):
    with pytest.raises(InvalidInputError, match="folder"):
        write_text(tmp_path / "missing" / "a.txt", "x")
    with pytest.raises(InvalidInputError, match="folder"):
        write_text(tmp_path, "x")
    assert list(tmp_path.iterdir()) == []
