"""Names of files that are not UTF-8: used as they are, and written with replacement characters."""

import json
import os
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fgrecon.batch import sources_of
from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import whole_text
from fgrecon.io.images import write_png

from .conftest import INTRINSICS

BAD = os.fsdecode(b"n\xff\xfe")
WRITTEN = "n\ufffd\ufffd"


def run(*arguments):
    done = CliRunner().invoke(main.app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done


@pytest.fixture
def folder(tmp_path, monkeypatch, write, instance, content):
    """Where names need not be text: a keypoint file and a track of such a name."""
    monkeypatch.chdir(tmp_path)
    try:
        write({"instances": [instance]}).rename(tmp_path / f"{BAD}.json")
    except OSError:
        pytest.skip("the file system takes names in UTF-8 alone")
    write(content, "track.json").rename(tmp_path / f"{BAD}-track.json")
    return tmp_path


def test_a_whole_text_is_one_that_can_be_written():
    assert whole_text("a\udcff\ud800b") == "a\ufffd\ufffdb"
    assert whole_text("\ud83d\ude97 °") == "🚗 °"


def test_results_name_the_file_they_are_of(folder):
    run("reconstruct", f"{BAD}.json", INTRINSICS, "--json", "o.json", "-q")
    run("track", f"{BAD}-track.json", "--json", "t.json", "--picture", f"{BAD}.png", "--save", f"{BAD}.rrd", "-q")
    assert json.loads((folder / "o.json").read_text(encoding="utf-8"))["file"] == f"{WRITTEN}.json"
    (track,) = json.loads((folder / "t.json").read_text(encoding="utf-8"))["tracks"]
    assert (track["track"], track["file"]) == (f"{WRITTEN}-track", f"{WRITTEN}-track.json")
    assert (folder / f"{BAD}.png").stat().st_size > 0


def test_a_recording_is_written_and_read_again(folder):
    run("reconstruct", f"{BAD}.json", INTRINSICS, "--save", f"{BAD}.rrd", "-q")
    summary = json.loads(run("replay", f"{BAD}.rrd", "--json", "-").stdout)
    assert summary["recording"] == f"{WRITTEN}.rrd"
    assert summary["stages"]


def test_a_batch_reads_and_writes_and_goes_on(folder, instance):
    pq.write_table(pa.Table.from_pylist([instance]), "cars.parquet")
    shutil.move("cars.parquet", f"{BAD}.parquet")
    for _ in range(2):
        done = run("batch", f"{BAD}.json", f"{BAD}.parquet", INTRINSICS, "--out", f"{BAD}-out")
    assert "2 of 2 rows are done, 2 of them before" in done.stdout
    (part,) = (folder / f"{BAD}-out").glob("part-*.parquet")
    shutil.copy(part, "part.parquet")
    assert [row["status"] for row in pq.read_table("part.parquet").to_pylist()] == ["converged"] * 2


@pytest.mark.parametrize("ending", [".png", ".mp4"])
def test_an_image_that_no_table_can_name_is_a_row_that_says_so(folder, ending):
    (folder / f"{BAD}{ending}").write_bytes(b"OpenCV must not see this name")
    (source,) = sources_of([f"{BAD}{ending}"])
    (row,) = source.rows()
    assert source.count() == 1
    assert "not UTF-8" in row["problem"]


def test_a_folder_of_a_batch_knows_a_prior_of_such_a_name(folder):
    from fgrecon.io.catalogue import load_prior, save_prior

    save_prior(load_prior("car14"), folder / "prior.npz")
    (folder / "prior.npz").rename(folder / f"{BAD}.npz")
    for _ in range(2):
        run("batch", f"{BAD}.json", INTRINSICS, "--prior", f"{BAD}.npz", "--out", "out", "-q")
    with pytest.raises(InvalidInputError, match="other settings"):
        run("batch", f"{BAD}.json", INTRINSICS, "--out", "out", "-q")


def test_a_run_goes_on_with_keypoints_of_such_a_name(folder, instance):
    shown = [{**instance, "id": f"{number}", "frame": number, "track": 1} for number in range(2)]
    (folder / f"{BAD}.json").write_text(json.dumps({"instances": shown}))
    for _ in range(2):
        run("run", f"{BAD}.json", INTRINSICS, "--out", f"{BAD}-out", "-q")
        lines = (folder / f"{BAD}-out" / "frames.jsonl").read_text(encoding="utf-8").splitlines()
        assert [json.loads(line)["name"] for line in lines] == [f"{WRITTEN}.json#{number}" for number in range(2)]


def test_a_run_over_images_of_such_names_says_which_is_broken(folder, instance):
    (folder / "images").mkdir()
    write_png(folder / "images" / "0.png", np.zeros((360, 1200, 3), dtype=np.uint8))
    (folder / "images" / "0.png").rename(folder / "images" / f"{BAD}0.png")
    (folder / "images" / f"{BAD}1.png").write_bytes(b"torn")
    (folder / f"{BAD}.json").write_text(json.dumps({"instances": [{**instance, "id": "a", "frame": 0, "track": 1}]}))
    run("run", "images", "--tracks", f"{BAD}.json", "--fps", 10, INTRINSICS, "--out", "out", "--save", "r.rrd", "-q")
    *_, torn = (folder / "out" / "frames.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(torn)["name"] == f"{WRITTEN}1.png"
    assert f"{WRITTEN}1.png" in json.loads(torn)["problem"]
