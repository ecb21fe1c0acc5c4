"""2,000 cars by a local pool, by a Ray cluster of two nodes and by Dask; one worker of each is killed in the middle.

Every row is there once, and the rows are the same bit for bit. A job of its own, on Linux:

    pip install -e '.[dev,ray]' 'dask[dataframe]' distributed
    pytest -m cluster tests/engines
"""

from __future__ import annotations

import json
import subprocess
import sys
import time

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.bench_batch import SETTINGS, make_cars
from fgrecon.batch import Reconstructor, result_schema
from fgrecon.batch.schema import task_schema
from tests.batch.support import results, untimed
from tests.conftest import REPOSITORY
from tests.engines.cluster import RayCluster, kill, workers_of

pytestmark = [pytest.mark.cluster, pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # theirs

CARS = 2000
SOLVED = {"size_prior": "kitti", "ground": 1.65}
"""The same as `SETTINGS`."""


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """A file with a car a line."""
    (file,) = make_cars(tmp_path_factory.mktemp("cars"), CARS)
    return file


@pytest.fixture
def say(capsys):
    """Prints what is to be read in a run that passes."""

    def line(text):
        with capsys.disabled():
            sys.stdout.write(f"\n{text}\n")

    return line


def rows_in(folder):
    return sum(pq.ParquetFile(path).metadata.num_rows for path in folder.glob("part-*.parquet"))


def killed_run(file, out, victims, *options):
    """`fgrecon batch` with one of its workers killed at a quarter; seconds, and rows by then."""
    command = [sys.executable, "-m", "fgrecon", "batch", str(file), "--out", str(out), *SETTINGS, *options]
    began, before = time.monotonic(), None
    with subprocess.Popen([*command, "--jobs", "2", "-q"], cwd=REPOSITORY) as run:
        while run.poll() is None:
            time.sleep(0.2)
            if before is None and rows_in(out) >= CARS // 4 and (found := victims(run.pid)):
                before = rows_in(out)
                kill(found[0])
    assert run.returncode == 0
    assert before is not None, "nothing was killed"
    assert before < CARS, "it was killed too late"
    return time.monotonic() - began, before


def measured(name, seconds, before):
    return f"{name}: {CARS} rows in {seconds:.0f} s, a worker killed when {before} were written; every row once"


@pytest.fixture(scope="module")
def pool(cars, tmp_path_factory):
    """What a pool of two processes makes of them, one of which is killed."""
    out = tmp_path_factory.mktemp("pool") / "out"
    seconds, before = killed_run(cars, out, workers_of)
    return seconds, before, {name: untimed(row) for name, row in results(out).items()}


def test_a_local_pool(cars, pool, say):
    seconds, before, rows = pool
    say(measured("local pool", seconds, before))
    assert rows.keys() == {f"{cars}#{line}" for line in range(1, CARS + 1)}
    tasks = [{"row_id": f"{cars}#{n}", "source": str(cars), "instance": text} for n, text in lines_of(cars, 20)]
    here = Reconstructor(**SOLVED)(pa.Table.from_pylist(tasks, schema=task_schema())).to_pylist()
    assert [rows[row["row_id"]] for row in here] == [untimed(row) for row in here]


def test_a_ray_cluster_of_two_nodes(cars, pool, say, tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install fgrecon[ray]")
    cluster = RayCluster()
    try:
        options = ("--ray", cluster.address)
        seconds, before = killed_run(cars, tmp_path / "out", lambda _: cluster.actors(), *options)
    finally:
        cluster.stop()
    say(measured("Ray, two nodes", seconds, before))
    assert {name: untimed(row) for name, row in results(tmp_path / "out").items()} == pool[2]


def test_dask(cars, pool, say):
    """The example of the guide, on workers of `distributed`, which makes one that was killed again."""
    reason = "Dask is not installed: pip install dask[dataframe] distributed"
    frames = pytest.importorskip("dask.dataframe", reason=reason)
    distributed = pytest.importorskip("distributed", reason=reason)
    tasks = [
        {"row_id": f"{cars}#{n}", "source": str(cars), "id": json.loads(text)["id"], "instance": text}
        for n, text in lines_of(cars, CARS)
    ]
    reconstructor, meta = Reconstructor(**SOLVED), result_schema().empty_table().to_pandas()
    frame = frames.from_pandas(pa.Table.from_pylist(tasks).to_pandas(), npartitions=40)
    began = time.monotonic()
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as workers,
        distributed.Client(workers) as client,
    ):
        done = frame.map_partitions(
            lambda part: reconstructor(pa.Table.from_pandas(part)).to_pandas(), meta=meta
        ).to_delayed()
        futures = client.compute(done)
        while sum(future.done() for future in futures) < 10:
            time.sleep(0.2)
        before = sum(future.done() for future in futures) * CARS // 40
        kill(next(iter(workers.workers.values())).pid)
        parts = client.gather(futures)
    say(measured("Dask", time.monotonic() - began, before))
    rows = [row for part in parts for row in pa.Table.from_pandas(part, schema=result_schema()).to_pylist()]
    assert len(rows) == CARS
    found = {row["row_id"]: untimed(row) for row in rows}
    assert found.keys() == pool[2].keys()
    for name, row in found.items():
        assert row == pool[2][name], name


def lines_of(file, count):
    """The first lines, with their numbers."""
    with file.open(encoding="utf-8") as content:
        for number, (line, _) in enumerate(zip(content, range(count), strict=False), start=1):
            yield number, line.strip()
