"""Files and folders as rows: counted, streamed, each with an id; what cannot be read is a row that says so."""

from __future__ import annotations

import json
import os
import socket
from decimal import Decimal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fgrecon.batch import Reconstructor, sources_of
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_category
from fgrecon.io.images import write_png
from fgrecon.io.keypoints.any_keypoints import read_any_keypoints
from fgrecon.io.video_frames import write_video
from fgrecon.solve.pipeline import reconstruct
from tests.batch.support import instances, write_lines
from tests.cli.conftest import K


def rows_of(*inputs, **how):
    sources = sources_of(inputs, **how)
    rows = [row for source in sources for row in source.rows()]
    assert len(rows) == sum(source.count() for source in sources)
    assert len({row["row_id"] for row in rows}) == len(rows)
    return rows


@pytest.fixture
def cars():
    return instances(3)


def test_lines(cars, tmp_path):
    file = write_lines(tmp_path / "cars.jsonl", [cars[0], "", "{torn", cars[1]])
    rows = rows_of(file)
    assert [row["row_id"] for row in rows] == [f"{file}#1", f"{file}#3", f"{file}#4"]
    assert json.loads(rows[0]["instance"]) == cars[0]
    assert rows[1]["instance"] == "{torn"


def test_lines_of_windows(cars, tmp_path):
    file = write_lines(tmp_path / "cars.jsonl", ["\ufeff" + json.dumps(cars[0]), cars[1]])
    assert [json.loads(row["instance"]) for row in rows_of(file)] == cars[:2]


def test_keypoint_files_share_their_camera(cars, tmp_path):
    bare = [{name: value for name, value in car.items() if name != "K"} for car in cars]
    own = bare[2] | {"intrinsics": [500, 500, 100, 100]}
    (file := tmp_path / "cars.json").write_text(json.dumps({"K": K.tolist(), "instances": [*bare[:2], own]}))
    content = [json.loads(row["instance"]) for row in rows_of(file)]
    assert [item.get("K") for item in content] == [K.tolist(), K.tolist(), None]
    (one := tmp_path / "one.json").write_text(json.dumps(cars[0]))
    (several := tmp_path / "several.json").write_text(json.dumps(cars))
    assert [len(rows_of(one)), len(rows_of(several))] == [1, 3]


def test_keypoints_of_other_programs_give_what_ours_give(cars, tmp_path):
    """COCO's annotations, and a list of results by themselves: the same vehicles, the same numbers."""
    names = load_category("car14").keypoints
    points = [[[*pixel, 2] for pixel in car["keypoints"]] for car in cars]
    annotations = {
        "images": [{"id": 1, "file_name": "a.jpg", "width": 1242, "height": 375}],
        "categories": [{"id": 1, "name": "car", "keypoints": list(names)}],
        "annotations": [
            {"id": 7 + n, "image_id": 1, "category_id": 1, "keypoints": [x for row in rows for x in row]}
            for n, rows in enumerate(points)
        ],
    }
    (coco := tmp_path / "coco.json").write_text(json.dumps(annotations))
    flat = [{"image_id": 1, "keypoints": [x for u, v, _ in rows for x in (u, v, 0.9)]} for rows in points]
    (results := tmp_path / "results.json").write_text(json.dumps(flat))
    ours = [{"keypoints": car["keypoints"], "confidence": [0.9] * len(names)} for car in cars]
    (own := tmp_path / "own.json").write_text(json.dumps(ours))
    solve = Reconstructor(camera=K)
    found = {file: solve(pa.Table.from_pylist(rows_of(file))).to_pylist() for file in (coco, results, own)}
    assert [len(rows) for rows in found.values()] == [3, 3, 3]
    assert [row["id"] for row in found[coco]] == ["7", "8", "9"]
    for foreign, mine in zip(found[results], found[own], strict=True):
        assert foreign["camera_T_object"] == mine["camera_T_object"]
    parsed = read_any_keypoints(coco, load_category("car14")).instances
    for row, instance in zip(found[coco], parsed, strict=True):
        expected = reconstruct(instance.observation, K, options=Options(keep_history=False))
        np.testing.assert_allclose(np.reshape(row["camera_T_object"], (4, 4)), expected.camera_T_object, atol=1e-9)


def test_tracks(content, tmp_path):
    (file := tmp_path / "made-up.json").write_text(json.dumps(content))
    rows = rows_of(file)
    first = json.loads(rows[0]["instance"])
    assert len(rows) == len(content["frames"])
    assert first["id"] == f"made-up:{content['frames'][0]['frame']}"
    assert first["keypoints"][content["keypoint_names"][3]] == content["frames"][0]["keypoints_uv"][3]


def test_parquet(cars, tmp_path):
    pq.write_table(pa.Table.from_pylist(cars), tmp_path / "cars.parquet")
    assert [json.loads(row["instance"]) for row in rows_of(tmp_path / "cars.parquet")] == cars
    texts = [{"instance": json.dumps(car), "weather": "rain"} for car in cars]
    pq.write_table(pa.Table.from_pylist(texts), tmp_path / "texts.parquet")
    assert [json.loads(row["instance"]) for row in rows_of(tmp_path / "texts.parquet")] == cars


def test_keypoints_of_parquet_may_say_which_image_they_are_of(cars, tmp_path):
    seen = [cars[0] | {"image": "a.png", "frame": 3}, {"image": str(tmp_path / "b.png"), "keypoints": None}]
    pq.write_table(pa.Table.from_pylist(seen), tmp_path / "cars.parquet")
    first, second = rows_of(tmp_path / "cars.parquet")
    assert json.loads(first["instance"]) == cars[0] | {"image": "a.png"}
    assert (first["frame"], "image" in first) == (3, False)
    assert second["image"] == str(tmp_path / "b.png")


def test_results_of_an_earlier_run_are_no_inputs(cars, tmp_path):
    file = write_lines(tmp_path / "cars.jsonl", cars)
    (out := tmp_path / "results").mkdir()
    (out / "_run.json").write_text("{}")
    pq.write_table(pa.Table.from_pylist([{"row_id": "a"}]), out / "part-000000.parquet")
    assert [source.path for source in sources_of([tmp_path])] == [file]


def test_columns_of_parquet_that_are_something_else(cars, tmp_path):
    odd = [car | {"frame": "left-003", "row_id": "mine"} for car in cars[:2]]
    pq.write_table(pa.Table.from_pylist(odd), tmp_path / "odd.parquet")
    rows = rows_of(tmp_path / "odd.parquet")
    assert all("frame" not in row for row in rows)
    assert json.loads(rows[0]["instance"])["keypoints"] == cars[0]["keypoints"]
    pq.write_table(pa.table({"image": [b"bytes"], "frame": ["x"]}), tmp_path / "bytes.parquet")
    (row,) = rows_of(tmp_path / "bytes.parquet")
    assert "column image holds bytes" in row["problem"]
    pq.write_table(pa.table({"image": ["a.png"], "frame": [3]}), tmp_path / "images.parquet")
    (row,) = rows_of(tmp_path / "images.parquet")
    assert (row["image"], row["frame"]) == ("a.png", 3)


@pytest.mark.parametrize("name", ["torn.json", "torn.parquet", "torn.mp4", "empty.json"])
def test_a_torn_file_is_a_row_that_says_so(tmp_path, name):
    (file := tmp_path / name).write_bytes(b"" if "empty" in name else b"{torn")
    (row,) = rows_of(file)
    assert str(file) in row["problem"]


def test_folders(cars, tmp_path):
    image = np.zeros((20, 30, 3), np.uint8)
    for name in ("b/2.png", "a.png", ".hidden/c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_png(tmp_path / name, image)
    write_lines(tmp_path / "cars.jsonl", cars)
    assert [row["image"] for row in rows_of(tmp_path)] == [str(tmp_path / "a.png"), str(tmp_path / "b/2.png")]
    assert len(rows_of(tmp_path, tmp_path / "a.png")) == 2, "each file once"
    write_lines((tmp_path / "lines").mkdir() or tmp_path / "lines/cars.jsonl", cars)
    assert len(rows_of(tmp_path / "lines")) == 3


def test_linked_folders_once(tmp_path):
    (images := tmp_path / "elsewhere").mkdir()
    write_png(images / "1.png", np.zeros((20, 30, 3), np.uint8))
    (folder := tmp_path / "here").mkdir()
    for name in ("first", "second"):
        (folder / name).symlink_to(images)
    (images / "back").symlink_to(folder)
    assert [row["image"] for row in rows_of(folder)] == [str(folder / "first" / "1.png")]


@pytest.mark.parametrize("layout", ["object", "drive", "tracking"])
def test_folders_of_kitti_bring_their_cameras(tmp_path, layout):
    line = "P2: " + " ".join(map(str, np.hstack([K, np.ones((3, 1))]).ravel())) + "\n"
    images, calib = {
        "object": ("image_2", "calib/000001.txt"),
        "drive": ("image_02", "calib.txt"),
        "tracking": ("image_02/0007", "calib/0007.txt"),
    }[layout]
    (tmp_path / images).mkdir(parents=True)
    (tmp_path / calib).parent.mkdir(exist_ok=True)
    (tmp_path / calib).write_text(line)
    (tmp_path / "image_3").mkdir()
    for folder in (images, "image_3"):
        write_png(tmp_path / folder / "000001.png", np.zeros((20, 30, 3), np.uint8))
    (row,) = rows_of(tmp_path)
    assert row["image"] == str(tmp_path / images / "000001.png")
    assert json.loads(row["camera"])["K"] == K.tolist()


def test_videos_frame_by_frame(tmp_path):
    from fgrecon.batch.reconstructor import Pictures

    file = make_video(tmp_path / "drive.avi", 7)
    assert [row["frame"] for row in rows_of(file)] == list(range(7))
    assert [row["row_id"] for row in rows_of(file, every=3)] == [f"{file}#0", f"{file}#3", f"{file}#6"]
    pictures = Pictures()
    for frame in (0, 1, 4, 2, 6):
        assert pictures.get(str(file), frame)[0].mean() == pytest.approx(20 + 30 * frame, abs=4)
    with pytest.raises(InvalidInputError, match="frame 7"):
        pictures.get(str(file), 7)


def test_a_line_that_is_being_written_is_another_row_once_it_is_whole(tmp_path):
    lines = [json.dumps({"keypoints": [[1.0, 2.0]] * 14, "id": name}) for name in "abc"]
    file = tmp_path / "grows.jsonl"
    file.write_text("\n".join(lines[:2])[:-9])
    assert [row["row_id"] for row in rows_of(file)] == [f"{file}#1", f"{file}#2-unfinished"]
    file.write_text("\n".join(lines))
    assert [row["row_id"] for row in rows_of(file)] == [f"{file}#{n}" for n in (1, 2, 3)]


def test_frames_of_a_video_are_known_by_their_order_whatever_their_times(tmp_path):
    from fgrecon.batch.reconstructor import Pictures

    for file in (tmp_path / "uneven.mp4", tmp_path / "uneven.mkv"):
        with write_video(file, rate=30) as add:  # from 30 to 10 frames a second
            for n in range(40):
                add(np.full((48, 64, 3), 20 + 5 * n, np.uint8), n / 30 if n < 20 else 20 / 30 + (n - 20) / 10)
        assert [row["frame"] for row in rows_of(file, every=8)] == [0, 8, 16, 24, 32]
        for frame in (24, 32, 39, 3):
            assert Pictures().get(str(file), frame)[0].mean() == pytest.approx(20 + 5 * frame, abs=2)


def make_video(path, count):
    """Grey frames, each brighter than the one before."""
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for frame in range(count):
        writer.write(np.full((48, 64, 3), 20 + 30 * frame, np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize("name", ["none.json", "x.docx", "empty"])
def test_what_is_no_input_is_refused(tmp_path, name):
    (tmp_path / "x.docx").touch()
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInputError, match="input"):
        sources_of([tmp_path / name])


@pytest.mark.parametrize("name", ["pipe", "pipe.jsonl", "link.jsonl", "socket"])
def test_what_is_neither_file_nor_folder_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)  # a socket's name must be short
    for pipe in ("pipe", "pipe.jsonl"):
        os.mkfifo(pipe)
    (tmp_path / "link.jsonl").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")
        with pytest.raises(InvalidInputError, match="pipe or device"):
            sources_of([name])


@pytest.mark.parametrize(
    ("column", "kind"), [(pa.array([b"{}"]), "binary"), (pa.array([3]), "int64"), (pa.array([["{}"]]), "list")]
)
def test_an_instance_that_is_no_text_is_refused_by_its_type(tmp_path, column, kind):
    pq.write_table(pa.table({"instance": column, "weather": ["rain"]}), tmp_path / "cars.parquet")
    (row,) = rows_of(tmp_path / "cars.parquet")
    assert f"column instance: got the type {kind}" in row["problem"]


@pytest.mark.parametrize("kind", [pa.large_string(), pa.dictionary(pa.int8(), pa.string())])
def test_texts_of_other_types_are_instances(cars, tmp_path, kind):
    texts = pa.array([json.dumps(car) for car in cars]).cast(kind)
    pq.write_table(pa.table({"instance": texts}), tmp_path / "cars.parquet")
    assert [json.loads(row["instance"]) for row in rows_of(tmp_path / "cars.parquet")] == cars


def test_a_column_instance_beside_keypoints_may_be_anything(cars, tmp_path):
    pq.write_table(pa.Table.from_pylist([car | {"instance": 3} for car in cars]), tmp_path / "cars.parquet")
    assert [json.loads(row["instance"]) for row in rows_of(tmp_path / "cars.parquet")] == cars


def test_decimals_are_numbers(cars, tmp_path):
    names = ("keypoints", "confidence", "box")
    exact = {"keypoints": pa.list_(pa.list_(pa.decimal128(20, 10)))} | dict.fromkeys(
        names[1:], pa.list_(pa.decimal128(20, 10))
    )
    columns = {name: pa.array([cars[0][name]]) for name in names}
    decimals = {"id": pa.array([Decimal(5)], pa.decimal128(3, 0))}
    for name, column in columns.items():
        decimals[name] = pa.array(_decimals(column.to_pylist()), exact[name])
    pq.write_table(pa.table(decimals), tmp_path / "cars.parquet")
    (row,) = rows_of(tmp_path / "cars.parquet")
    instance = json.loads(row["instance"])
    assert instance["id"] == 5
    np.testing.assert_allclose(instance["keypoints"], cars[0]["keypoints"], atol=1e-9)
    (solved,) = Reconstructor(camera=K)(pa.Table.from_pylist([row])).to_pylist()
    assert solved["status"] == "converged"
    (direct,) = Reconstructor(camera=K)(pa.table(decimals)).to_pylist()
    assert direct["camera_T_object"] == solved["camera_T_object"]


def _decimals(value):
    return [_decimals(item) for item in value] if isinstance(value, list) else Decimal(f"{value:.10f}")


@pytest.mark.parametrize("frame", [None, 3])
def test_an_image_that_can_be_no_name_is_refused(frame):
    table = pa.table({"image": ["a\0b"], "frame": pa.array([frame], pa.int64())})
    (row,) = Reconstructor(camera=K)(table).to_pylist()
    assert (row["status"], row["error_field"]) == ("refused", "image")
