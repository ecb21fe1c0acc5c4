"""`fgrecon run` a second time into a folder: what may change, and what is refused or done away with."""

import json
import shutil
import signal

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.video.follow import Follower
from tests.video.streets import make_drive

FPS = ("--fps", 10)
INTRINSICS = ("--intrinsics", "721.5,721.5,609.6,172.9")


def run(*arguments):
    return CliRunner().invoke(main.app, ["run", *map(str, arguments)])


@pytest.fixture
def drive(tmp_path):
    return make_drive(tmp_path / "drive", 3)


@pytest.mark.parametrize("alone", [False, True])
def test_given_vehicles_that_were_edited_are_refused(drive, tmp_path, alone):
    """Also where the file is as long as it was."""
    images, file = drive
    asked = ([file] if alone else [images, "--tracks", file]) + [*FPS, "--out", tmp_path / "out"]
    assert run(*asked).exit_code == 0
    assert "3 were looked at before" in run(*asked).stdout
    before = file.read_text()
    file.write_text(before.replace('"track": 10', '"track": 70'))
    assert len(before) == file.stat().st_size
    refused = run(*asked).exception
    name = "source_sha256" if alone else "tracks_sha256"
    assert (refused.field, f"other settings ({name})" in refused.fix) == ("out", True)


def test_weights_of_another_content_are_other_settings(drive, tmp_path):
    images, file = drive
    (weights := tmp_path / "w.safetensors").write_bytes(b"one")  # given keypoints need none
    asked = (images, "--tracks", file, *FPS, "--weights", weights, "--out", tmp_path / "out")
    assert run(*asked).exit_code == 0
    weights.write_bytes(b"two")
    with pytest.raises(InvalidInputError, match=r"other settings \(weights_sha256\)"):
        raise run(*asked).exception


def renamed(images, names):
    """The drive's images by other names."""
    for path, name in list(zip(sorted(images.iterdir()), names, strict=True))[::-1]:  # numbers grow: none is lost
        path.rename(images / name)


@pytest.mark.parametrize(
    ("before", "added", "reasons"),
    [
        (["000004.png", "000005.png"], "000003.png", ("frame 4 (000004.png)", "frame 3 (000003.png)")),
        (["a.png", "c.png"], "b.png", ("frame 1 (c.png)", "frame 1 (b.png)")),
        (["1.png", "3.png"], "2.png", ("frame 3 (3.png)", "frame 2 (2.png)")),
        (["1.png", "2.png"], "x.png", ("frame 1 (1.png)", "frame 0 (1.png)")),
    ],
)
def test_frames_are_added_after_the_last_one_alone(drive, tmp_path, before, added, reasons):
    images, file = drive
    content = json.loads(file.read_text())
    content["instances"] += [
        {**one, "id": f"{k}-{one['id']}", "frame": k} for one in content["instances"][:1] for k in range(3)
    ]
    file.write_text(json.dumps(content))
    renamed(images, [*before, "zzz9.png"])
    later = (images / "zzz9.png").rename(tmp_path / "later.png")
    asked = (images, "--tracks", file, *FPS, "--out", tmp_path / "out", *INTRINSICS)
    assert run(*asked).exit_code in (0, 1)
    later.rename(images / added)
    refused = run(*asked)
    assert refused.exception.field == "out"
    assert [part in refused.exception.fix for part in reasons] == [True, True], refused.exception
    assert "after the last" in refused.exception.fix


def test_frames_that_are_gone_are_refused_and_those_that_come_after_are_looked_at(drive, tmp_path):
    images, file = drive
    last = sorted(images.iterdir())[-1]
    kept = last.rename(tmp_path / last.name)
    asked = (images, "--tracks", file, *FPS, "--out", tmp_path / "out")
    assert run(*asked).exit_code == 0
    kept.rename(last)
    assert "3 frames, 2 cars" in (again := run(*asked)).stdout
    assert "2 were looked at before" in again.stdout
    last.unlink()
    refused = run(*asked).exception
    assert f"({last.name}) was looked at, where there is none now" in refused.fix


def test_no_table_is_left_of_estimates_that_are_no_more(drive, tmp_path):
    images, file = drive
    content = json.loads(file.read_text())
    asked = (images, "--tracks", file, *FPS, "--out", out := tmp_path / "out")
    assert run(*asked).exit_code == 0
    tables = [out / name for name in ("tracks.csv", "tracks.parquet")]
    assert all(path.exists() for path in tables)
    shutil.rmtree(out / "records")
    first = content["instances"][0]
    points = [first["keypoints"][0], *[None] * (len(first["keypoints"]) - 1)]
    file.write_text(json.dumps({**content, "instances": [{**first, "keypoints": points}]}))
    assert run(*asked).exit_code == 1
    assert not any(path.exists() for path in tables)
    assert (out / "tracks.txt").read_text() == ""


def test_images_of_one_name_in_several_folders_go_on(drive, tmp_path):
    images, file = drive
    file.write_text(file.read_text().replace('"frame": 5', '"frame": 1'))
    for number, path in enumerate(sorted(images.iterdir())):
        (folder := images / f"cam{number}").mkdir()
        path.rename(folder / "a.png")
    asked = (images / "*" / "*.png", "--tracks", file, *FPS, "--out", tmp_path / "out", *INTRINSICS)
    first, again = run(*asked), run(*asked)
    assert (first.exit_code, again.exit_code) == (0, 0)
    assert "3 were looked at before" in again.stdout


def test_a_finished_film_is_not_drawn_again(drive, tmp_path, monkeypatch):
    """Unless it, or what it shows, is another."""
    pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    images, file = drive
    film = tmp_path / "a.mp4"
    asked = (images, "--tracks", file, *FPS, "--out", tmp_path / "out", "--video", film)
    assert f"Wrote {film}." in run(*asked).stdout
    drawn = film.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr("fgrecon.cli.run_report.film", pytest.fail)
        again = run(*asked)
    assert (again.exit_code, f"{film} shows this already." in again.stdout) == (0, True)
    assert film.read_bytes() == drawn
    film.write_bytes(b"torn")
    assert f"Wrote {film}." in run(*asked).stdout
    assert f"Wrote {film}." in run(*asked, "--online").stdout


@pytest.mark.parametrize("way", ["--online", "--alone"])
def test_a_film_is_drawn_while_frames_come_where_estimates_stay(drive, tmp_path, monkeypatch, way):
    """It is the one that is drawn afterwards; and afterwards it is where frames were looked at before."""
    av = pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    images, file = drive
    arguments = (images, "--tracks", file, *FPS, way)

    def pictures(film):
        with av.open(str(film)) as container:
            return [(picture.time, picture.to_ndarray()) for picture in container.decode(video=0)]

    with monkeypatch.context() as patched:
        patched.setattr("fgrecon.cli.run_report.film", pytest.fail)
        done = run(*arguments, "--out", tmp_path / "out", "--video", live := tmp_path / "live.mp4")
        assert (done.exit_code, f"Wrote {live}." in done.stdout) == (0, True)
        if way == "--online":  # single images say how long each took
            assert f"{live} shows this already." in run(*arguments, "--out", tmp_path / "out", "--video", live).stdout
    assert (
        f"Wrote {tmp_path / 'b.mp4'}."
        in run(*arguments, "--out", tmp_path / "out", "--video", tmp_path / "b.mp4").stdout
    )
    there, again = pictures(live), pictures(tmp_path / "b.mp4")
    assert len(there) == 3
    for (time, picture), (other_time, other) in zip(there, again, strict=True):
        assert time == other_time
        # Encoded with loss: after other tests in one process 15 of 918,918 values differed, by 5 at most.
        assert np.mean(picture != other) < 1e-4
        np.testing.assert_allclose(picture.astype(int), other.astype(int), atol=8)


def test_what_keeps_a_film_from_being_written_is_said_and_leaves_none(drive, tmp_path, monkeypatch):
    pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    images, file = drive

    def fail(*_, **__):
        raise InvalidInputError("video", "a picture", "Give another.")

    monkeypatch.setattr("fgrecon.viz.film.annotated", fail)
    film = tmp_path / "a.mp4"
    done = run(images, "--tracks", file, *FPS, "--online", "--out", tmp_path / "out", "--video", film)
    assert isinstance(done.exception, InvalidInputError)
    assert (done.exception.value, film.exists()) == ("a picture", False)


def test_a_run_that_is_stopped_leaves_no_film(drive, tmp_path, monkeypatch):
    pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    images, file = drive
    film = tmp_path / "a.mp4"
    follow, seen = Follower.__call__, []

    def interrupted(self, record):
        seen.append(record)
        if len(seen) == 2:
            signal.raise_signal(signal.SIGINT)
        return follow(self, record)

    monkeypatch.setattr(Follower, "__call__", interrupted)
    done = run(images, "--tracks", file, *FPS, "--online", "--out", tmp_path / "out", "--video", film)
    assert (done.exit_code, film.exists()) == (130, False)
    assert not [*tmp_path.glob("*.mp4*")]
