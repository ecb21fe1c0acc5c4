"""No command writes over what it reads, or two results to one file."""

import os

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.cli.overwrites import OUTPUTS, check_apart
from fgrecon.core.errors import InvalidInputError

from .test_commands import COMMANDS


def refused(*arguments):
    with pytest.raises(InvalidInputError) as error:
        CliRunner().invoke(main.app, [str(argument) for argument in arguments], catch_exceptions=False)
    return str(error.value)


def bytes_of(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def files(tmp_path, write, instance):
    """A keypoint file, links to it, and files that are not read before the check."""
    write({"instances": [instance]}, "c.json")
    (tmp_path / "link.json").symlink_to("c.json")
    os.link(tmp_path / "c.json", tmp_path / "same.json")
    (tmp_path / "st.png").write_bytes(b"pixels")
    (tmp_path / "tracks.txt").write_text("boxes")
    (tmp_path / "inside").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["reconstruct", "c.json", "--json", "c.json"], "json"),
        (["reconstruct", "c.json", "--json", "inside/../c.json"], "json"),
        (["reconstruct", "c.json", "--json", "link.json"], "json"),
        (["reconstruct", "link.json", "--json", "c.json"], "json"),
        (["reconstruct", "c.json", "--json", "same.json"], "json"),
        (["reconstruct", "c.json", "--image", "st.png", "--picture", "st.png"], "picture"),
        (["reconstruct", "c.json", "--camera", "link.json#front", "--json", "c.json"], "json"),
        (["reconstruct", "st.png", "--detect", "--out", ".", "--pictures"], "out"),
        (["track", "c.json", "--picture", "c.json"], "picture"),
        (["refine", "c.json", "st.png", "--out", "st.png"], "out"),
        (["export", "c.json", "link.json"], "out"),
        (["replay", "c.json", "--json", "c.json"], "json"),
        (["run", "inside", "--out", ".", "--tracks", "tracks.txt"], "out"),
        (["evaluate", "tracks", "c.json", "--per-frame", "c.json"], "per-frame"),
        (["evaluate", "video", "c.json", "--fold", "drive=st.png", "--table", "st.png"], "table"),
        (["prior", "compare", "car14", "c.json", "--json", "c.json"], "json"),
        (["vehicles", "detect", "st.png", "--out", "st.png"], "out"),
    ],
)
def test_an_output_that_is_an_input_is_refused_before_the_work(files, monkeypatch, arguments, field):
    monkeypatch.chdir(files)
    before = bytes_of(files)
    assert refused(*arguments).startswith(f"{field}: got ")
    assert bytes_of(files) == before


def test_results_do_not_go_over_boxes_of_a_folder(files):
    (files / "inside" / "st.json").write_text("[]")
    told = refused("reconstruct", files / "st.png", "--boxes", files / "inside", "--out", files / "inside")
    assert "st.json" in told
    assert (files / "inside" / "st.json").read_text() == "[]"


@pytest.mark.parametrize("other", ["x.svg", "inside/../x.svg"])
@pytest.mark.parametrize("there", [False, True])
def test_two_outputs_are_not_one_file(files, monkeypatch, other, there):
    monkeypatch.chdir(files)
    if there:
        (files / "x.svg").touch()
    assert "written to it" in refused("reconstruct", "c.json", "--json", "x.svg", "--picture", other)


def test_what_is_no_file_may_be_both(tmp_path):
    pipe = str(tmp_path / "pipe")
    os.mkfifo(pipe)
    check_apart({"file": pipe, "json_out": pipe, "picture": pipe})
    check_apart({"file": "-", "json_out": "-", "out": str(tmp_path), "folder": tmp_path})
    check_apart({"file": "no\0name", "json_out": "no\0name", "picture": "no\0name"})
    check_apart({"file": "n" * 5000, "json_out": "n" * 5000, "picture": "n" * 5000})


READ = {
    *("files", "calib", "camera", "prior", "calibration", "boxes", "weights", "image", "images", "names", "models"),
    *("source", "poses", "tracks", "recording", "fold", "labels", "split", "first", "second", "category", "imagenet"),
    *("start", "marks", "street", "settings", "trained", "cfg", "silhouettes"),
}


def test_each_option_with_a_file_is_known_as_read_or_written():
    """A new output has to be named in OUTPUTS."""
    named = {p.name for command in COMMANDS.values() for p in command.params if "FILE" in (p.metavar or "")}
    assert named - set(OUTPUTS) <= READ
    assert not READ & set(OUTPUTS)
