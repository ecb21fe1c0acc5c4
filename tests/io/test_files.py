"""Files are written whole or not at all."""

import os
import stat
from pathlib import Path
from threading import Thread

import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import replacing, write_bytes, write_text


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


@pytest.mark.parametrize("linked", [False, True])
def test_a_pipe_is_written_to_and_stays_one(tmp_path, linked):
    pipe = named = tmp_path / "pipe"
    os.mkfifo(pipe)
    if linked:
        named = tmp_path / "link"
        named.symlink_to(pipe)
    read = []
    reader = Thread(target=lambda: read.append(pipe.read_bytes()), daemon=True)
    reader.start()
    content = bytes(range(256)) * 1000  # more than a pipe holds
    assert write_bytes(named, content) == named
    reader.join(timeout=60)
    assert read == [content]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert {p.name for p in tmp_path.iterdir()} == {pipe.name, named.name}


def test_a_pipe_whose_reader_goes_away_is_reported(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = Thread(target=lambda: pipe.open("rb").close(), daemon=True)
    reader.start()
    with pytest.raises(InvalidInputError, match=r"pipe.*Broken pipe"):
        write_bytes(pipe, bytes(1 << 20))
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="the system does not name open files")
def test_an_open_pipe_by_its_number_as_shells_name_it():
    end, start = os.pipe()
    write_text(f"/proc/self/fd/{start}", "x")
    assert os.read(end, 9) == b"x"
    os.close(end)
    os.close(start)


@pytest.mark.parametrize("name", ["n" * 255, "n" * 240, "é" * 127, "n" * 200 + ".json", "[a]*?"])
def test_the_longest_name_can_be_written_and_what_was_left_of_it_is_cleared(tmp_path, name):
    file, other = tmp_path / name, tmp_path / f"m{name[1:]}"
    left = []
    for target in (file, other):  # a writer that was killed
        content = replacing(target)
        left.append(content.__enter__())
        os.utime(left[-1], (0, 0))
    write_text(file, "whole")
    assert file.read_text() == "whole"
    assert [part.exists() for part in left] == [False, True]
    assert all(len(os.fsencode(part.name)) <= 255 for part in left)


def test_a_name_that_is_too_long_is_reported(tmp_path):
    with pytest.raises(InvalidInputError, match="too long"):
        write_text(tmp_path / ("n" * 256), "x")


def test_a_link_that_leads_to_itself_is_reported(tmp_path):
    (link := tmp_path / "a.txt").symlink_to("b.txt")
    (tmp_path / "b.txt").symlink_to("a.txt")
    for path in (link, link / "deeper.txt"):
        with pytest.raises(InvalidInputError, match="symbolic links"):
            write_text(path, "x")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "b.txt"]
    assert link.is_symlink()
