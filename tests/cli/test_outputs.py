"""No command writes over what it reads, or two results to one file."""

import os

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.cli.outputs import OUTPUTS, check_apart
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
    (tmp_path / "inside" / "part-000000.parquet").write_bytes(b"rows")
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
        (["run", ".", "--out", "inside", "--picture", "st.png"], "picture"),
        (["run", "s*.png", "--out", "inside", "--picture", "st.png"], "picture"),
        (["track", "c.json", "--images", ".", "--picture", "st.png"], "picture"),
        (["export", "inside", "inside/part-000000.parquet"], "out"),
        (["run", "st.png", "--out", "inside", "--json", "inside/frames.jsonl"], "json"),
    ],
)
def test_an_output_that_is_an_input_is_refused_before_the_work(files, monkeypatch, arguments, field):
    monkeypatch.chdir(files)
    before = bytes_of(files)
    assert refused(*arguments).startswith(f"{field}: got ")
    assert bytes_of(files) == before


def test_results_do_not_go_over_boxes_of_a_folder(files):
    (files / "inside" / "st.json").write_text("[]")
    message = refused("reconstruct", files / "st.png", "--boxes", files / "inside", "--out", files / "inside")
    assert "st.json" in message
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
    *("start", "marks", "street", "settings", "trained", "cfg", "silhouettes", "lidar", "lidar_pose", "depth", "right"),
    *("masks", "right_camera", "right_pose", "package"),
}


def test_each_option_with_a_file_is_known_as_read_or_written():
    """A new output has to be named in OUTPUTS."""
    named = {p.name for command in COMMANDS.values() for p in command.params if "FILE" in (p.metavar or "")}
    assert named - set(OUTPUTS) <= READ
    assert not READ & set(OUTPUTS)


def test_refined_boxes_do_not_go_over_calibrations_or_images(files):
    for name in ("boxes", "images", "calib"):
        (files / name).mkdir()
    line = "Car 0 0 1.5 20 20 110 80 1.5 1.6 4.0 0.1 1.6 15 1.5 0.9\n"
    (files / "boxes" / "000001.txt").write_text(line)
    (files / "images" / "000001.png").write_bytes((files / "st.png").read_bytes())
    (files / "calib" / "000001.txt").write_text("P2: 700 0 80 40 0 700 50 0.2 0 0 1 0.002\n")
    given = ("refine", files / "boxes", files / "images", "--calib", files / "calib")
    assert "000001.txt" in refused(*given, "--out", files / "calib")
    assert (files / "calib" / "000001.txt").read_text().startswith("P2")


def test_results_of_before_in_other_folders_are_written_over(files):
    (files / "r.json").write_text("{}")
    check_apart({"source": str(files / "inside"), "out": str(files / "tracked"), "json_out": str(files / "r.json")})
    check_apart({"data": files, "json_out": str(files / "r.json")})
