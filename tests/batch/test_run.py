"""Runs: every row exactly once, whatever is killed and whenever; the same bits as ever; memory that does not grow."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fgrecon.batch import Reconstructor, read_folder, result_schema, run, sources_of
from fgrecon.batch.parts import Parts
from fgrecon.batch.schema import task_schema
from fgrecon.cli import main
from fgrecon.core.detector_calibration import BoxSource, DetectorCalibration
from fgrecon.core.errors import DamagedFileWarning, InvalidInputError, MissingPackageError
from fgrecon.io.catalogue import load_prior, save_calibration, save_prior
from fgrecon.io.images import write_png
from tests.batch.support import Deadly, instances, results, untimed, write_lines
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """A file of twenty cars, and what the reconstructor makes of them in this process."""
    folder = tmp_path_factory.mktemp("cars")
    content = instances(20)
    file = write_lines(folder / "cars.jsonl", content)
    tasks = [
        {"row_id": f"{file}#{i}", "source": str(file), "instance": json.dumps(c)} for i, c in enumerate(content, 1)
    ]
    table = Reconstructor(size_prior="kitti")(pa.Table.from_pylist(tasks, schema=task_schema()))
    return file, {row["row_id"]: untimed(row) for row in table.to_pylist()}


def batch(*arguments):
    return CliRunner().invoke(main.app, ["batch", *map(str, arguments)])


def test_two_processes_give_the_bits_of_one(cars, tmp_path):
    file, expected = cars
    done = batch(file, "--out", tmp_path / "out", "--jobs", 2, "--size-prior", "kitti", "--batch-rows", 3)
    assert done.exit_code == 0, done.output
    assert "20 of 20 rows are done, 0 of them before." in done.stdout
    found = results(tmp_path / "out")
    assert {name: untimed(row) for name, row in found.items()} == expected
    schema = pq.read_schema(next((tmp_path / "out").glob("part-*.parquet")))
    assert schema.equals(result_schema())
    assert schema.metadata[b"fgrecon.format"] == b"fgrecon.batch/2"
    again = batch(file, "--out", tmp_path / "out", "--size-prior", "kitti")
    assert again.exit_code == 0
    assert "20 of 20 rows are done, 20 of them before." in again.stdout
    assert results(tmp_path / "out") == found


def test_a_folder_is_for_one_kind_of_run(cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:2])
    assert batch(few, "--out", tmp_path / "out").exit_code == 0
    other = batch(few, "--out", tmp_path / "out", "--size-prior", "kitti")
    assert isinstance(other.exception, InvalidInputError)
    assert "other settings" in str(other.exception)
    deep = tmp_path / ("a" * 100) / ("b" * 100)
    assert batch(few, "--out", deep).exit_code == 0
    named = str(batch(few, "--out", deep, "--size-prior", "kitti").exception)
    assert "this one has a run with other settings (size_prior)" in named, "however long its path is"
    (tmp_path / "out" / "_run.json").unlink()
    assert "no _run.json" in str(batch(few, "--out", tmp_path / "out").exception)


def test_a_folder_is_for_one_content_of_the_files_that_settings_name(cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:2])
    prior = save_prior(load_prior("car14"), tmp_path / "mine.npz")
    assert batch(few, "--out", tmp_path / "out", "--prior", prior).exit_code == 0
    assert batch(few, "--out", tmp_path / "out", "--prior", prior).exit_code == 0
    save_prior(load_prior("car14").scaled(1.1), prior)
    other = batch(few, "--out", tmp_path / "out", "--prior", prior)
    assert "other settings (prior_sha256)" in str(other.exception)


def test_edges_of_boxes_that_a_calibration_tells_are_settings(cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:1])
    calibrations = []
    for left in (0.0, 0.1):
        source = BoxSource(left, 0.0, 0.0, 0.0)
        calibrations.append(save_calibration(DetectorCalibration(boxes=source), tmp_path / f"{left}.json"))
    assert batch(few, "--out", tmp_path / "out", "--calibration", calibrations[0]).exit_code == 0
    other = batch(few, "--out", tmp_path / "out", "--calibration", calibrations[1])
    assert "other settings (boxes)" in str(other.exception)


def test_results_are_in_the_order_of_their_files_whenever_they_were_solved(cars, tmp_path):
    file, _ = cars
    lines = file.read_text().splitlines()[:3]
    for name, some in (("b", lines[1:]), ("a", lines[:1])):
        folder = tmp_path / name
        folder.mkdir()
        write_lines(folder / "cars.jsonl", some)
        assert batch(folder / "cars.jsonl", "--out", tmp_path / "out").exit_code == 0
    assert [item.name for item in read_folder(tmp_path / "out")] == ["car-0", "car-1", "car-2"]


def test_readers_leave_alone_what_a_run_is_writing(cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:1])
    assert batch(few, "--out", tmp_path / "out").exit_code == 0
    (torn := tmp_path / "out" / ".part-000001.parquet.0.part").write_text("x")
    read_folder(tmp_path / "out")
    assert torn.exists()
    assert batch(few, "--out", tmp_path / "out").exit_code == 0
    assert not torn.exists()


@pytest.mark.parametrize(
    "damaged",
    ["1e999", '"x"', "[]", "{}", '{"settings": 5}', '{"format": "fgrecon.batch/2", "settings": {"ground": 7}}'],
)
def test_damaged_settings_of_a_folder_are_one_clear_line(damaged, cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:1])
    assert batch(few, "--out", tmp_path / "out").exit_code == 0
    (tmp_path / "out" / "_run.json").write_text(damaged)
    assert isinstance(batch(few, "--out", tmp_path / "out").exception, InvalidInputError)
    with pytest.raises(InvalidInputError, match=r"_run\.json"):
        read_folder(tmp_path / "out")


def test_a_folder_of_a_videos_run_is_refused(cars, tmp_path):
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "_run.json").write_text("{}")
    refused = batch(cars[0], "--out", tmp_path).exception
    assert isinstance(refused, InvalidInputError)
    assert refused.field == "out"
    assert "a video's run" in refused.fix
    assert [p.name for p in tmp_path.iterdir()] == ["records"]


def test_poison_becomes_a_row_and_the_unlucky_are_tried_again(cars, tmp_path):
    file, expected = cars
    content = [json.loads(line) for line in file.read_text().splitlines()[:6]]
    content[1]["id"], content[4]["id"] = "poison", "unlucky"
    lines = [json.dumps(item) for item in content]
    mixed = write_lines(tmp_path / "mixed.jsonl", [*lines[:3], "{torn", *lines[3:]])
    deadly = Deadly(tmp_path, size_prior="kitti")
    tally = run(sources_of([mixed]), tmp_path / "out", deadly, jobs=2, batch_rows=4)
    assert (tally.done, tally.total) == (7, 7)
    found = results(tmp_path / "out")
    states = {int(name.rpartition("#")[2]): row["status"] for name, row in found.items()}
    assert (states.pop(2), states.pop(4)) == ("error", "refused")
    assert set(states.values()) <= {"converged", "ambiguous", "degenerate"}
    poisoned = found[f"{mixed}#2"]
    assert (poisoned["error_type"], poisoned["x"]) == ("WorkerDiedError", None)
    healthy = expected[f"{file}#1"]
    assert found[f"{mixed}#1"]["camera_T_object"] == healthy["camera_T_object"]


def test_a_killed_run_goes_on_where_it_was(cars, tmp_path):
    file, expected = cars
    out = tmp_path / "out"
    command = [sys.executable, "-c", "from fgrecon.cli.main import main; main()", "batch", str(file), "--out", str(out)]
    command += ["--jobs", "2", "--size-prior", "kitti", "--batch-rows", "2"]
    script = f"import fgrecon.batch.parts as p; p._ROWS = 4; import sys; sys.argv = {command[2:]!r}; "
    code = script + "from fgrecon.cli.main import main\nif __name__ == '__main__': main()"
    (program := tmp_path / "program.py").write_text(code)
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    running = subprocess.Popen([sys.executable, str(program)], env=environment, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while len(list(out.glob("part-*.parquet"))) < 2 and running.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
    finally:
        running.kill()
        running.wait()
    before = results(out)
    assert 4 <= len(before) < 20
    (out / ".part-000009.parquet.torn.part").write_bytes(b"half")
    _wait_for_orphans(running.pid)
    done = batch(file, "--out", out, "--jobs", 2, "--size-prior", "kitti")
    assert done.exit_code == 0, done.output
    assert f"20 of 20 rows are done, {len(before)} of them before." in done.stdout
    assert {name: untimed(row) for name, row in results(out).items()} == expected
    assert not list(out.glob(".part-*"))


def _wait_for_orphans(session):
    """The workers of a killed run end themselves."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.killpg(session, signal.SIGKILL)
    pytest.fail("workers outlive a run that was killed")


def test_one_run_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    from fgrecon.batch.parts import claimed

    with claimed(tmp_path), pytest.raises(InvalidInputError, match="going on"), claimed(tmp_path):
        pass


def test_a_damaged_part_is_named_and_its_rows_are_computed_again(cars, tmp_path):
    file, expected = cars
    given = (file, "--out", tmp_path / "out", "--size-prior", "kitti")
    assert batch(*given).exit_code == 0
    (part,) = (tmp_path / "out").glob("part-*.parquet")
    content = part.read_bytes()
    part.write_bytes(content[: len(content) // 2])
    with pytest.warns(DamagedFileWarning, match=r"part-\d+\.parquet is damaged"):
        assert batch(*given).exit_code == 0
    assert {name: untimed(row) for name, row in results(tmp_path / "out").items()} == expected


def test_nothing_solved_is_exit_code_1_and_bad_input_2(tmp_path):
    bad = write_lines(tmp_path / "bad.jsonl", ["{", "[]", '{"id": "\\ud800"}'])
    done = batch(bad, "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "refused" in done.stdout
    write_png(tmp_path / "dark.png", np.zeros((64, 96, 3), np.uint8))
    assert batch(bad, tmp_path / "dark.png", "--out", tmp_path / "dark").exit_code == 1  # a good image, without a car
    for arguments, field in ((["none.jsonl"], "input"), ([bad, "--prior", "none"], "prior")):
        assert batch(*arguments, "--out", tmp_path / "x").exception.field == field
    assert not (tmp_path / "x").exists()


def test_where_nothing_is_solved_the_commonest_errors_say_what_to_do(tmp_path):
    keypoints = instances(1)[0]["keypoints"]
    bare = [{"keypoints": keypoints}] * 3  # no camera
    others = ["{", {"keypoints": keypoints, "K": [1, 2]}, {"keypoints": 1}, {"keypoints": keypoints, "box": 1}]
    file = write_lines(tmp_path / "bare.jsonl", [*bare, *others])
    done = batch(file, "--out", tmp_path / "out")
    said = done.stderr.partition("No vehicle could be reconstructed.\n")[2].splitlines()
    assert said[0] == "fgrecon: 3 x intrinsics: got nothing. Give K with the row, or a camera for all of them."
    assert len(said) == 3


def test_a_run_that_reconstructed_nothing_makes_place_for_other_settings(tmp_path):
    """Its exit code stays the same as long as the command does."""
    bare = [{"keypoints": one["keypoints"], "id": str(n)} for n, one in enumerate(instances(2))]  # no camera
    file, out = write_lines(tmp_path / "bare.jsonl", bare), tmp_path / "out"
    first, again = (batch(file, "--out", out) for _ in range(2))
    assert (first.exit_code, again.exit_code) == (2, 2)
    assert "2 of 2 rows are done, 2 of them before." in again.stdout
    assert first.stderr == again.stderr
    assert "2 x intrinsics: got nothing" in again.stderr
    camera = "--intrinsics=721.5,721.5,609.6,172.9"
    mended = batch(file, "--out", out, camera)
    assert mended.exit_code == 0, mended.output
    assert "2 of 2 rows are done, 0 of them before." in mended.stdout
    assert "begun anew" in " ".join(mended.stderr.split())
    assert all(row["x"] is not None for row in results(out).values())
    for extra in ([], [camera, "--size-prior", "kitti"]):
        assert "other settings" in str(batch(file, "--out", out, *extra).exception), "these are worth something"
    assert batch(file, "--out", out, camera).exit_code == 0


def test_what_another_run_is_at_is_not_thrown_away(tmp_path):
    pytest.importorskip("fcntl")
    from fgrecon.batch.parts import claimed

    bare = write_lines(tmp_path / "bare.jsonl", [{"keypoints": instances(1)[0]["keypoints"]}])
    assert batch(bare, "--out", tmp_path / "out").exit_code == 2
    with claimed(tmp_path / "out"):
        refused = batch(bare, "--out", tmp_path / "out", "--intrinsics=700,700,600,170")
    assert "going on" in str(refused.exception)
    assert len(results(tmp_path / "out")) == 1


class Copying(Reconstructor):
    """Gives every row the result of the first: what a run costs beside solving."""

    def __init__(self, row):
        super().__init__()
        self.row = row

    def __call__(self, table):
        rows = [self.row | {"row_id": name} for name in table.column("row_id").to_pylist()]
        return pa.Table.from_pylist(rows, schema=result_schema())


@pytest.mark.slow
def test_memory_stays_flat_over_many_cars(cars, tmp_path):
    """Twenty thousand rows cost the parent no more memory than the first four thousand did."""
    file, expected = cars
    line = file.read_text().splitlines()[0]
    many = write_lines(tmp_path / "many.jsonl", [line] * 20_000)
    seen = []

    def report(tally):
        if tally.done in (4096, 20_000) or not tally.done % 4096:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
            seen.append(pages * os.sysconf("SC_PAGE_SIZE") / 2**20)

    copying = Copying(next(iter(expected.values())))
    tally = run(sources_of([many]), tmp_path / "out", copying, jobs=1, batch_rows=512, report=report)
    assert tally.done == 20_000
    assert len(results(tmp_path / "out")) == 20_000
    assert max(seen) - seen[1] < 60


def test_ray_is_asked_for_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    file = write_lines(tmp_path / "one.jsonl", instances(1))
    done = batch(file, "--out", tmp_path / "out", "--ray", "auto")
    assert isinstance(done.exception, MissingPackageError)
    assert "pip install 'ray[data]>=2.40'" in str(done.exception)


def test_no_changed_byte_of_a_part_goes_unnoticed(tmp_path):
    """Parquet's own checksums: a changed number would be read as it is without them."""
    rng = np.random.default_rng(0)
    parts = Parts(tmp_path, pa.schema([("row_id", pa.string()), ("x", pa.float64())]))
    parts.add(pa.table({"row_id": [str(i) for i in range(200)], "x": rng.random(200)}))
    parts.flush()
    path = tmp_path / "part-000000.parquet"
    content, rows = path.read_bytes(), list(parts.rows())
    noticed = 0
    for at in rng.integers(4, len(content) - 8, 100):
        changed = bytearray(content)
        changed[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(changed)
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            done = parts.done()
        noticed += bool(warned)
        assert warned or (len(done) == 200 and list(parts.rows()) == rows)
    assert noticed > 50


def test_an_edited_file_is_not_taken_for_done(cars, tmp_path, monkeypatch):
    file, _ = cars
    lines = file.read_text().splitlines()
    out = tmp_path / "out"
    monkeypatch.chdir(tmp_path)
    few = write_lines(tmp_path / "few.jsonl", lines[:2])
    assert batch("few.jsonl", "--out", out).exit_code == 0

    few.touch()
    assert "2 of 2 rows are done, 2 of them before" in batch("few.jsonl", "--out", out).stdout
    write_lines(few, lines[:3])
    assert "3 of 3 rows are done, 2 of them before" in batch("few.jsonl", "--out", out).stdout, (
        "more at the end goes on"
    )

    write_lines(few, [lines[1], *lines[1:3]])
    edited = batch("few.jsonl", "--out", out).exception
    assert isinstance(edited, InvalidInputError)
    assert "few.jsonl" in str(edited)
    assert "before it was edited" in str(edited)
    write_lines(few, lines[:1])
    assert "before it was edited" in str(batch("few.jsonl", "--out", out).exception)

    (tmp_path / "elsewhere").mkdir()
    write_lines(tmp_path / "elsewhere" / "few.jsonl", lines[:3])
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert str(few) in str(batch("few.jsonl", "--out", out).exception), "another file of the same name"


def test_an_edited_image_is_not_taken_for_done(tmp_path):
    image, out = tmp_path / "a.png", tmp_path / "out"
    write_png(image, np.zeros((40, 60, 3), np.uint8))
    batch(image, "--out", out)
    assert len(results(out)) == 1
    os.utime(image, ns=(0, 0))
    assert "before it was edited" in str(batch(image, "--out", out).exception)


@pytest.mark.parametrize("damaged", ["{", "[1]", '{"few.jsonl": 3}', '{"few.jsonl": {"place": "x"}}'])
def test_where_it_is_not_known_what_the_files_were_a_run_goes_on(damaged, cars, tmp_path):
    file, _ = cars
    few = write_lines(tmp_path / "few.jsonl", file.read_text().splitlines()[:1])
    assert batch(few, "--out", tmp_path / "out").exit_code == 0
    (inputs := tmp_path / "out" / "_inputs.json").write_text(damaged)
    with pytest.warns(DamagedFileWarning, match=r"_inputs\.json"):
        again = batch(few, "--out", tmp_path / "out")
    assert "1 of 1 row is done, 1 of them before" in again.stdout
    assert str(few) in json.loads(inputs.read_text())
