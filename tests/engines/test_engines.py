"""The reconstructor in engines of others, which are no development dependency: `pip install fgrecon[ray] dask`."""

from __future__ import annotations

import json

import pyarrow as pa
import pytest

from fgrecon.batch import Reconstructor, result_schema, run, sources_of
from fgrecon.batch.schema import task_schema
from tests.batch.support import Deadly, instances, results, untimed, write_lines

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # theirs


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """A file of twelve cars, and what the reconstructor makes of them in this process."""
    content = instances(12)
    file = write_lines(tmp_path_factory.mktemp("cars") / "cars.jsonl", content)
    tasks = [
        {"row_id": f"{file}#{i}", "source": str(file), "instance": json.dumps(c)} for i, c in enumerate(content, 1)
    ]
    table = pa.Table.from_pylist(tasks, schema=task_schema())
    return file, table, {row["row_id"]: untimed(row) for row in Reconstructor()(table).to_pylist()}


@pytest.fixture(scope="module")
def cluster():
    """Address of a Ray cluster of two nodes on this machine, one processor each."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install fgrecon[ray]")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    made.add_node(num_cpus=1)
    yield made.address
    ray.shutdown()
    made.shutdown()


def test_ray_gives_the_same_bits(cars, cluster, tmp_path):
    file, _, expected = cars
    tally = run(sources_of([file]), tmp_path / "out", Reconstructor(), jobs=2, ray=cluster, batch_rows=3)
    assert (tally.done, tally.total) == (12, 12)
    assert {name: untimed(row) for name, row in results(tmp_path / "out").items()} == expected


def test_ray_survives_what_kills_its_actors(cars, cluster, tmp_path):
    _, _, expected = cars
    content = instances(12)
    content[1]["id"], content[7]["id"] = "poison", "unlucky"
    file = write_lines(tmp_path / "mixed.jsonl", content)
    run(sources_of([file]), tmp_path / "out", Deadly(tmp_path), jobs=2, ray=cluster, batch_rows=4)
    found = results(tmp_path / "out")
    assert len(found) == 12
    assert [name for name, row in found.items() if row["status"] == "error"] == [f"{file}#2"]
    unlucky = next(row for name, row in expected.items() if name.endswith("#8"))
    assert found[f"{file}#8"]["camera_T_object"] == unlucky["camera_T_object"]


def test_ray_data_takes_the_class_itself(cars, cluster):
    import ray

    _, table, expected = cars
    ray.init(address=cluster, ignore_reinit_error=True)
    rows = ray.data.from_arrow(table).map_batches(Reconstructor, batch_format="pyarrow", concurrency=1, batch_size=6)
    assert {row["row_id"]: row["x"] for row in rows.take_all()} == {name: row["x"] for name, row in expected.items()}


def test_dask_maps_partitions(cars):
    reason = "Dask is not installed: pip install dask[dataframe]"
    frames = pytest.importorskip("dask.dataframe", reason=reason)
    _, table, expected = cars
    reconstructor, meta = Reconstructor(), result_schema().empty_table().to_pandas()
    rows = frames.from_pandas(table.to_pandas(), npartitions=3).map_partitions(
        lambda frame: reconstructor(pa.Table.from_pandas(frame, preserve_index=False)).to_pandas(), meta=meta
    )
    found = rows.compute(scheduler="processes")
    assert dict(zip(found["row_id"], found["x"], strict=True)) == {name: row["x"] for name, row in expected.items()}
