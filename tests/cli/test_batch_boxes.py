"""`fgrecon batch` on images with boxes of one's own: one table that names image, box, class, score and track."""

import csv
import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from fgrecon.batch import Reconstructor
from tests.command_line import run

SIZE = np.array([1242, 375, 1242, 375])
BOXES = np.array([[500.0, 150, 700, 260], [200.0, 160, 330, 240]])
"""Made up, in the sample's street: what is in them does not matter here."""


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    root = tmp_path_factory.mktemp("photographs")
    assert run("sample", "--out", root / "sample", "-q").exit_code == 0
    (root / "images").mkdir()
    for name in ("a", "b", "c"):
        shutil.copy(root / "sample/street.png", root / f"images/{name}.png")
    return root / "images"


def yolo(folder):
    """A folder with a file for two of the images: two cars with score and track, and a truck."""
    centres = np.concatenate([(BOXES[:, :2] + BOXES[:, 2:]) / 2, BOXES[:, 2:] - BOXES[:, :2]], axis=1) / SIZE
    lines = [f"2 {' '.join(f'{x:.9f}' for x in box)} 0.{9 - n} {n + 5}\n" for n, box in enumerate(centres)]
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.txt").write_text("".join([*lines, "7 0.5 0.5 0.1 0.1 0.9 11\n"]))
    return folder


def coco(folder):
    entries = [
        {"image_id": n, "category_id": 1, "bbox": [*box[:2], *(box[2:] - box[:2])]}
        | {"score": 0.9 - 0.1 * i, "track_id": i + 5}
        for n in (1, 2)
        for i, box in enumerate(BOXES)
    ]
    entries += [{"image_id": n, "category_id": 2, "bbox": [1, 2, 30, 40]} for n in (1, 2)]
    pictures = [{"id": n, "file_name": f"{name}.png", "width": 1242, "height": 375} for n, name in enumerate("abc", 1)]
    kinds = [{"id": 1, "name": "car"}, {"id": 2, "name": "truck"}]
    path = folder.with_suffix(".json")
    path.write_text(json.dumps({"images": pictures, "categories": kinds, "annotations": entries}, default=float))
    return path


def table(folder):
    rows = [(name, "car", 0.9 - 0.1 * n, *box, n + 5) for name in "ab" for n, box in enumerate(BOXES)]
    rows += [(name, "truck", 0.9, 1, 2, 31, 42, 11) for name in "ab"]
    path = folder.with_suffix(".csv")
    lines = ["image,class,score,x1,y1,x2,y2,track", *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("make", [yolo, coco, table])
def test_images_with_boxes_become_one_table(images, tmp_path, make):
    boxes, out = make(tmp_path / "boxes"), tmp_path / "out"
    given = ("--calib", images.parent / "sample/calib.txt", "--camera-height", 1.65, "--boxes", boxes)
    done = run("batch", images, *given, "--out", out, "--table", tmp_path / "cars.csv")
    assert done.exit_code == 0, done.output
    assert "left out 1 truck, which car14 does not cover" in done.stderr
    rows = pq.read_table(out).to_pylist()
    cars = [row for row in rows if row["vehicle"] is not None]
    assert [row["image"] for row in cars] == [str(images / f"{name}.png") for name in "aabb"]
    assert [(row["kind"], row["track"]) for row in cars] == [("car", 5), ("car", 6)] * 2
    np.testing.assert_allclose([row["score"] for row in cars], [0.9, 0.8] * 2)
    np.testing.assert_allclose([row["box"] for row in cars], [*BOXES, *BOXES], atol=1e-3)
    others = {row["status"]: row["left_out"] for row in rows if row["vehicle"] is None}
    assert others.keys() == {"left_out", "empty"}
    assert ("has no file for it" if make is yolo else "of other images (a") in others["empty"][0]
    with (tmp_path / "cars.csv").open(newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["vehicle"]]
    assert [(line["image"], line["kind"], line["track"]) for line in lines] == [
        (row["image"], row["kind"], str(row["track"])) for row in cars
    ]
    np.testing.assert_allclose([float(line["x1"]) for line in lines], [row["box"][0] for row in cars])
    same = run("reconstruct", images / "a.png", *given, "--json", tmp_path / "a.json", "--picture", tmp_path / "a.png")
    assert same.exit_code == 0, same.output
    data = json.loads((tmp_path / "a.json").read_text())
    np.testing.assert_allclose([e["box"] for e in data["instances"]], BOXES, atol=1e-3)
    assert [(e["kind"], e["track"]) for e in data["instances"]] == [("car", 5), ("car", 6)]
    assert data["left_out"] == [{"reason": "of other classes (truck)", "count": 1}]


def test_a_table_of_results_names_image_class_score_and_track(images, tmp_path):
    given = ("--calib", images.parent / "sample/calib.txt", "--boxes", yolo(tmp_path / "boxes"))
    assert run("reconstruct", images / "a.png", images / "b.png", *given, "--out", tmp_path / "out").exit_code == 0
    assert run("batch", images, *given, "--out", tmp_path / "rows").exit_code == 0
    for results in ("out", "rows"):
        assert run("export", tmp_path / results, tmp_path / f"{results}.csv").exit_code == 0
        with (tmp_path / f"{results}.csv").open(newline="") as file:
            lines = list(csv.DictReader(file))
        assert [line["image"].rpartition("/")[2] for line in lines] == ["a.png", "a.png", "b.png", "b.png"]
        known = [(line["kind"], line["score"], line["track"]) for line in lines]
        assert known == [("car", "0.9", "5"), ("car", "0.8", "6")] * 2
        np.testing.assert_allclose([float(line["x2"]) for line in lines], [*BOXES[:, 2]] * 2, atol=1e-3)


def test_python_takes_boxes_as_the_command_does(images, tmp_path):
    import pyarrow as pa

    reconstructor = Reconstructor(camera=(721.5, 721.5, 609.6, 172.9), boxes=yolo(tmp_path / "boxes"))
    rows = reconstructor(pa.table({"image": [str(images / "a.png")], "row_id": ["a"]})).to_pylist()
    assert [(row["status"], row["track"]) for row in rows[2:]] == [("left_out", None)]
    assert [row["track"] for row in rows[:2]] == [5, 6]


def test_what_boxes_cannot_be_of(images, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("2 0.5 0.5 0.1 0.1\n")
    for input_, words in ((images, "of one image, for 3 images"), (images.parent / "sample/cars.json", "Give images")):
        done = run("batch", input_, "--boxes", path, "--out", tmp_path / "out")
        assert words in str(done.exception)
        assert not (tmp_path / "out").exists()


def test_where_nothing_is_in_the_file_the_command_says_what_is(images, tmp_path):
    path = tmp_path / "boxes.csv"
    path.write_text("image,class,x1,y1,x2,y2\nstreet9.png,car,1,2,300,200\n")
    done = run("batch", images, "--boxes", path, "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "1 of other images (street9.png)" in done.stderr


def test_a_folder_of_calibrations_has_one_for_each_image(images, tmp_path):
    (tmp_path / "calib").mkdir()
    for name in ("a", "b"):
        shutil.copy(images.parent / "sample/calib.txt", tmp_path / f"calib/{name}.txt")
    done = run(
        "batch", images, "--calib", tmp_path / "calib", "--boxes", yolo(tmp_path / "boxes"), "--out", tmp_path / "out"
    )
    assert done.exit_code == 0, done.output
    rows = pq.read_table(tmp_path / "out").to_pylist()
    assert {row["camera_matrix"][0] for row in rows if row["vehicle"] is not None} == {721.5377}
    (refused,) = [row for row in rows if row["status"] == "refused"]
    assert "c.txt" in refused["error"]
