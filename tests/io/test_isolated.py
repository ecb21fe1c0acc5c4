"""Decoders that die, hang or claim too much end in an error that names the file, and in nothing else."""

import io
import os
import pickle
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from fgrecon.core.errors import ChildNotBegunError, DamagedFileWarning, InvalidInputError
from fgrecon.io.arrays import LARGEST, read_arrays
from fgrecon.io.catalogue import load_prior, save_prior
from fgrecon.io.files import check_hash, listed, stored
from fgrecon.io.isolated import Isolated
from tests.conftest import REPOSITORY


def double(number):
    return 2 * number


def die(_):
    os.kill(os.getpid(), signal.SIGSEGV)


def refuse(name):
    raise InvalidInputError(name, 1, "Do not.")


def fill(count):
    return len(bytearray(count))


def sleep(seconds):
    time.sleep(seconds)


def test_a_child_works_dies_and_works_again():
    with Isolated() as child:
        assert child("a", double, 2) == 4
        with pytest.raises(InvalidInputError, match="broken: got damaged: it kills its decoder"):
            child("broken", die, 0)
        assert child("b", double, 3) == 6
        with pytest.raises(InvalidInputError, match="field: got 1"):
            child("c", refuse, "field")


def test_a_child_that_hangs_is_ended():
    with Isolated(seconds=10.0) as child:  # a busy machine takes some for its start
        with pytest.raises(InvalidInputError, match="nothing after 10 seconds"):
            child("slow", sleep, 60)
        assert child("b", double, 3) == 6


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits it")
def test_a_child_that_takes_too_much_memory_is_refused(monkeypatch):
    monkeypatch.setenv(LARGEST, str(1 << 26))
    with Isolated() as child:
        assert child("a", fill, 1 << 20) == 1 << 20
        with pytest.raises(InvalidInputError, match=f"more than fits into memory.*{LARGEST}"):
            child("large", fill, 1 << 30)
        assert child("b", double, 3) == 6


UNGUARDED = """
from tests.io.test_isolated import Isolated, double

print("once")
with Isolated() as child:
    print(child("a", double, 2), child("b", double, 3))
"""


@pytest.mark.parametrize("how", ["script", "stdin", "command"])
def test_a_script_needs_no_main_guard(tmp_path, how):
    """A child that ran the script again would print once more, and start a child of its own."""
    (tmp_path / "script.py").write_text(UNGUARDED)
    program = {"script": ["script.py"], "stdin": ["-"], "command": ["-c", UNGUARDED]}[how]
    done = subprocess.run(
        [sys.executable, *program],
        input=UNGUARDED if how == "stdin" else "",
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        check=False,
    )
    assert (done.stdout.split(), done.stderr, done.returncode) == (["once", "4", "6"], "", 0)


def shout(number):
    os.write(1, b"not an answer")
    os.write(2, b"nor this")
    return number


def test_what_a_decoder_prints_is_no_answer(capfd):
    with Isolated() as child:
        assert child("a", shout, 2) == 2
    assert capfd.readouterr() == ("", "")


def unpicklable(_):
    return lambda: 1


class OddError(Exception):
    """One that cannot be made again from its arguments."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def raise_odd(_):
    raise OddError(1, 2)


def test_what_a_pipe_cannot_carry_is_an_error_and_not_the_files_fault():
    with Isolated() as child:
        with pytest.raises((AttributeError, pickle.PicklingError), match="unpicklable"):
            child("a", unpicklable, 0)
        with pytest.raises(RuntimeError, match="OddError: 1 and 2"):
            child("a", raise_odd, 0)
        with pytest.raises(TypeError) as caught:
            child("a", double, None)
        assert "in double" in caught.value.__notes__[0]  # where in the child
        assert child("b", double, 3) == 6


def test_a_child_that_never_began_is_not_the_files_fault(monkeypatch, tmp_path, capfd):
    broken = tmp_path / "fgrecon"
    broken.mkdir()
    (broken / "__init__.py").write_text("raise SystemExit(7)")
    with monkeypatch.context() as patch, Isolated() as child:
        patch.syspath_prepend(tmp_path)
        with pytest.raises(ChildNotBegunError, match="exit code 7"):
            child("fine", double, 2)
    with monkeypatch.context() as patch, Isolated() as child:
        patch.setattr("fgrecon.io.isolated.get_executable", lambda: str(tmp_path / "no-python"))
        with pytest.raises(ChildNotBegunError, match="no-python"):
            child("fine", double, 2)
        patch.undo()
        assert child("fine", double, 2) == 4
    assert capfd.readouterr().out == ""


def test_a_frozen_program_decodes_by_itself(monkeypatch):
    """Its executable is the program: started for a child, it would start children without end."""
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    with Isolated() as child:
        assert child("a", os.getpid) == os.getpid()


def npz(**members):
    """An npz file of raw members."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


def header(shape, kind="<f8", content=b""):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def test_arrays_come_back(tmp_path):
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "c": np.array("text"),
        "d": np.zeros((0, 3)),
    }
    np.savez(tmp_path / "x.npz", **arrays)
    found = read_arrays(tmp_path / "x.npz", "x", "")
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert list(read_arrays((tmp_path / "x.npz").read_bytes(), "x", "", ["b", "z"])) == ["b"]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (npz(mean=header((1 << 48,))), "shape .* in "),
        (npz(mean=header((-1,))), "shape"),
        (npz(mean=header((3,), content=b"\0" * 8)), "cut off"),
        (npz(mean=b"\x80\x04K\x01."), "mean"),
        (npz(mean=header((1,), "|O", b"\0" * 8)), "pickled"),
        (b"PK\x03\x04 no archive", "unreadable"),
        (b"", "unreadable"),
    ],
    ids=["256 TiB", "negative", "cut off", "pickle", "objects", "text", "empty"],
)
def test_what_arrays_cannot_be_is_refused(content, match):
    with pytest.raises(InvalidInputError, match=match):
        read_arrays(content, "prior.npz", "Give another.")


def test_a_small_file_of_many_zeros_is_not_unpacked(tmp_path, monkeypatch):
    """A thousand times its size; the limit is an environment variable."""
    bomb = tmp_path / "bomb.npz"
    bomb.write_bytes(npz(keypoints=header((1 << 17, 14, 2), content=bytes(8 * 28 << 17))))
    monkeypatch.setenv(LARGEST, str(1 << 20))
    with pytest.raises(InvalidInputError, match=f"{LARGEST} raises that"):
        read_arrays(bomb, "bomb.npz", "")
    monkeypatch.setenv(LARGEST, "many")
    with pytest.raises(InvalidInputError, match=LARGEST):
        read_arrays(bomb, "bomb.npz", "")
    monkeypatch.delenv(LARGEST)
    assert list(read_arrays(bomb, "bomb.npz", "")) == ["keypoints"]


def test_narrow_numbers_count_as_what_they_become(monkeypatch):
    """A reader makes floats of them: bytes take eight times their room."""
    monkeypatch.setenv(LARGEST, str(1 << 20))
    content = npz(a=header((1 << 17,), "|u1", bytes(1 << 17)), b=header((1,), content=bytes(8)))
    with pytest.raises(InvalidInputError, match="1048584 bytes when unpacked"):
        read_arrays(content, "x", "")
    monkeypatch.setenv(LARGEST, str((1 << 20) + 8))
    assert read_arrays(content, "x", "")["a"].sum() == 0


@pytest.mark.parametrize("folder", ["weights", "priors"])
def test_the_packages_files_are_what_their_lists_say(folder):
    place = REPOSITORY / "fgrecon" / "data" / folder
    files = {path.name for path in place.iterdir() if path.suffix in (".npz", ".onnx", ".safetensors")}
    assert set(listed(place)) == files
    for name in files:
        content = (place / name).read_bytes()
        check_hash(place / name, content)
        with pytest.raises(InvalidInputError, match="changed or damaged"):
            check_hash(place / name, content[:-1])


def test_a_damaged_part_is_named_and_put_aside(tmp_path):
    path = save_prior(load_prior("car14"), tmp_path / "part.npz")
    assert stored(path, load_prior).name == "car14"
    assert stored(tmp_path / "none.npz", load_prior) is None
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.warns(DamagedFileWarning, match=r"part\.npz is damaged"):
        assert stored(path, load_prior) is None
    assert [file.name for file in tmp_path.iterdir()] == ["_part.npz.damaged"]
