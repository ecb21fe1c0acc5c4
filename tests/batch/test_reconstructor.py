"""A table in, a table of results out: the same bits as `reconstruct`, and a row for whatever is wrong."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

import fgrecon
from fgrecon.batch import Reconstructor, reconstruction_of, result_schema
from fgrecon.core.errors import AssumedCameraWarning, InvalidInputError
from fgrecon.io.images import read_image, write_png
from tests.batch.support import instances, untimed
from tests.cli.conftest import K
from tests.results import value_of


@pytest.fixture(scope="module")
def reconstructor():
    return Reconstructor(size_prior="kitti", ground=1.65)


@pytest.fixture(scope="module")
def cars():
    return instances(3)


def solved(car, **settings):
    options = fgrecon.Options(keep_history=False)
    points, confidence = np.array(car["keypoints"]), np.array(car["confidence"])
    return fgrecon.reconstruct(
        points, np.array(car["K"]), confidence=confidence, box=car["box"], options=options, **settings
    )


def table_of(rows):
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: [row.get(name) for row in rows] for name in names})


ADDED = "facing_probability", "reasons", "size_covariance", "box_excess"
"""Columns that the first version had not."""


def test_rows_are_what_reconstruct_gives_to_the_last_bit(reconstructor, cars):
    table = reconstructor(table_of([{"instance": json.dumps(car)} for car in cars]))
    assert table.schema.equals(result_schema(), check_metadata=True)
    assert table.schema.metadata[b"fgrecon.format"] == b"fgrecon.batch/2"
    category = fgrecon.load_category("car14")
    for number, (row, car) in enumerate(zip(table.to_pylist(), cars, strict=True)):
        result = solved(car, size_prior="kitti", ground=1.65)
        back = reconstruction_of(row, category)
        assert (row["row_id"], row["id"], row["vehicle"]) == (str(number), car["id"], 0)
        assert (row["x"], row["y"], row["z"]) == tuple(result.location)
        assert row["camera_matrix"] == K.ravel().tolist()
        assert row["error"] is None
        for name in ("camera_T_object", "coefficients", "offsets", "wireframe", "weights", "sigmas", "pose_covariance"):
            assert value_of(back, name).tobytes() == value_of(result, name).tobytes(), name
        np.testing.assert_array_equal(
            [a.probability for a in back.uncertainty.alternatives],
            [a.probability for a in result.uncertainty.alternatives],
        )
        assert back.facing_probability == result.facing_probability
        assert back.reasons == result.reasons
        np.testing.assert_array_equal(back.diagnostics.box_excess, result.diagnostics.box_excess)
        np.testing.assert_array_equal(back.uncertainty.size_covariance, result.uncertainty.size_covariance)
        assert [a.excess for a in back.uncertainty.alternatives] == [a.excess for a in result.uncertainty.alternatives]
        assert (back.status, back.message, back.shape.prior) == (result.status, result.message, result.shape.prior)
        first_version = {name: value for name, value in row.items() if name not in ADDED}
        before = reconstruction_of(first_version, category)
        assert (before.reasons, before.uncertainty.size_covariance) == ((), None)
        assert np.isnan(before.uncertainty.pose_probability)


def test_columns_may_be_the_fields_of_an_instance_flat_or_not(reconstructor, cars):
    wanted = [untimed(row) for row in reconstructor(table_of([{"instance": json.dumps(c)} for c in cars])).to_pylist()]
    assert [untimed(row) for row in reconstructor(table_of(cars)).to_pylist()] == wanted
    flat = [c | {"keypoints": np.ravel(c["keypoints"]).tolist(), "K": np.ravel(c["K"]).tolist()} for c in cars]
    assert [untimed(row) for row in reconstructor(table_of(flat)).to_pylist()] == wanted
    thirds = [c | {"keypoints": np.column_stack([c["keypoints"], c["confidence"]]).ravel().tolist()} for c in cars]
    for one in thirds:
        del one["confidence"]
    assert [untimed(row) for row in reconstructor(table_of(thirds)).to_pylist()] == wanted


def test_missing_keypoints_are_nan_or_null(reconstructor, cars):
    gone = [*cars[0]["keypoints"][:9], [float("nan")] * 2, *cars[0]["keypoints"][10:]]
    null = [*cars[0]["keypoints"][:9], None, *cars[0]["keypoints"][10:]]
    rows = reconstructor(table_of([cars[0] | {"keypoints": gone}, cars[0] | {"keypoints": null}])).to_pylist()
    assert rows[0]["status"] == "converged"
    assert rows[0]["camera_T_object"] == rows[1]["camera_T_object"]


def test_whatever_is_wrong_becomes_a_row(reconstructor, cars):
    tasks = [
        {"row_id": "a", "instance": "{"},
        {"row_id": "b", "instance": json.dumps(cars[0] | {"box": [5, 5, 5, 9]})},
        {"row_id": "c", "instance": json.dumps({**cars[0], "K": None})},
        {"row_id": "d", "image": "/no/such/file.png"},
        {"row_id": "e", "problem": "it is torn"},
        {"row_id": "f", "instance": json.dumps(cars[1])},
    ]
    rows = {row["row_id"]: row for row in reconstructor(table_of(tasks)).to_pylist()}
    assert list(rows) == list("abcdef")
    assert {name: row["status"] for name, row in rows.items()} == dict.fromkeys("abcde", "refused") | {"f": "converged"}
    fields = [rows[name]["error_field"] for name in "abcde"]
    assert fields == ["instance", "box", "intrinsics", "image", "source"]
    assert "it is torn" in rows["e"]["error"]
    assert rows["b"]["id"] == "car-0"
    assert reconstruction_of(rows["a"], fgrecon.load_category("car14")) is None


def test_the_unforeseen_becomes_a_row_too(reconstructor, cars, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("nobody thought of this")

    monkeypatch.setattr("fgrecon.solve.pipeline.reconstruct", fail)
    (row,) = reconstructor(table_of(cars[:1])).to_pylist()
    assert (row["status"], row["error_type"], row["id"]) == ("error", "ZeroDivisionError", "car-0")


def test_what_columns_cannot_hold_becomes_a_row_and_leaves_the_others(reconstructor, cars):
    large = cars[0] | {"image_size": [3_000_000_000, 375]}
    rows = reconstructor(table_of([{"instance": json.dumps(car)} for car in (large, cars[1])])).to_pylist()
    assert [row["status"] for row in rows] == ["error", "converged"]
    assert rows[0]["row_id"] == "0"


def test_keypoints_may_be_a_map(reconstructor, cars):
    names = fgrecon.load_category("car14").keypoints
    points = [dict(zip(names, car["keypoints"], strict=True)) for car in cars]
    kind = pa.map_(pa.string(), pa.list_(pa.float64()))
    table = table_of(cars).set_column(0, "keypoints", pa.array([list(p.items()) for p in points], type=kind))
    assert [row["x"] for row in reconstructor(table).to_pylist()] == [
        row["x"] for row in reconstructor(table_of(cars)).to_pylist()
    ]


def test_it_is_pickled_without_what_it_has_loaded(reconstructor, cars):
    first = untimed(reconstructor(table_of(cars[:1])).to_pylist()[0])
    packed = pickle.dumps(reconstructor)
    assert len(packed) < 10_000
    assert untimed(pickle.loads(packed)(table_of(cars[:1])).to_pylist()[0]) == first


def test_the_camera_of_all_goes_before_those_of_rows(cars):
    other = K * np.array([[1.1], [1.1], [1.0]])
    (row,) = Reconstructor(camera=other)(table_of(cars[:1])).to_pylist()
    assert row["camera_matrix"] == other.ravel().tolist()
    with pytest.raises(InvalidInputError, match="intrinsics"):
        Reconstructor(camera=[1, 2, 3])


def test_another_category_is_refused(reconstructor, cars):
    (row,) = reconstructor(table_of(cars[:1])).to_pylist()
    with pytest.raises(InvalidInputError, match="car14"):
        reconstruction_of(row | {"keypoints": ["nose"]}, fgrecon.load_category("car14"))


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A rendered street with two cars."""
    from typer.testing import CliRunner

    from fgrecon.cli import main

    folder = tmp_path_factory.mktemp("street")
    assert CliRunner().invoke(main.app, ["sample", "--out", str(folder)]).exit_code == 0
    return folder


def test_images_give_a_row_for_each_car(street, tmp_path):
    image = next(iter(sorted(street.glob("*.png"))))
    empty = write_png(tmp_path / "empty.png", np.full((120, 200, 3), 90, np.uint8))
    tasks = [{"row_id": "street", "image": str(image)}, {"row_id": "empty", "image": str(empty)}]
    rows = Reconstructor(camera=K, threads=1)(table_of(tasks)).to_pylist()
    found = fgrecon.reconstruct_image(image, K)
    seen = [row for row in rows if row["row_id"] == "street"]
    assert len(seen) == len(found) > 0
    for number, (row, vehicle) in enumerate(zip(seen, found, strict=True)):
        assert (row["id"], row["vehicle"]) == (f"street:{number}", number)
        assert row["camera_T_object"] == vehicle.result.camera_T_object.ravel().tolist()
        assert 0.3 <= row["score"] <= 1.0
        assert row["image_size"] == [*reversed(read_image(image).shape[:2])]
    assert [(row["status"], row["vehicle"]) for row in rows if row["row_id"] == "empty"] == [("empty", None)]


def test_without_a_camera_the_cars_tell_the_focal_length(street):
    image = next(iter(sorted(street.glob("*.png"))))
    boxes = fgrecon.perception.find_boxes(read_image(image))[:2]
    with pytest.warns(AssumedCameraWarning):
        found = fgrecon.reconstruct_image(image, boxes=boxes)
    rows = Reconstructor(threads=1)(table_of([{"image": str(image), "boxes": boxes.tolist()}])).to_pylist()
    for row, vehicle in zip(rows, found, strict=True):
        assert row["camera_matrix"] == vehicle.camera.matrix.ravel().tolist()
        assert 0.0 < row["focal_sigma"] == vehicle.camera.focal_sigma < 0.5
        assert row["status"] != "converged"
        assert "the focal length is known to" in row["reasons"][-1]
        assert row["camera_T_object"] == vehicle.result.camera_T_object.ravel().tolist()


def test_an_image_may_be_bytes_with_boxes_of_its_own(street):
    image = next(iter(sorted(street.glob("*.png"))))
    boxes = fgrecon.perception.find_boxes(read_image(image))[:1].tolist()
    task = {"image": Path(image).read_bytes(), "boxes": boxes, "camera": json.dumps({"K": K.tolist()})}
    rows = Reconstructor(threads=1)(table_of([task, task | {"boxes": [[0.0, 0.0, 3.0, 3.0]]}])).to_pylist()
    assert rows[0]["camera_matrix"] == K.ravel().tolist()
    assert (rows[0]["box"], rows[0]["score"]) == (boxes[0], None)
    assert (rows[1]["status"], rows[1]["error_field"]) == ("refused", "boxes[0]")


def test_networks_have_the_threads_that_were_asked_for(monkeypatch):
    pytest.importorskip("onnxruntime")
    torch = pytest.importorskip("torch")
    asked, before = [], (torch.get_num_threads(), cv2.getNumThreads())
    monkeypatch.setattr(
        "fgrecon.perception.keypoints.on_onnx.open_session", lambda model, threads, device: asked.append(threads)
    )
    try:
        for loaded in (True, False):
            if not loaded:
                monkeypatch.delitem(sys.modules, "torch")
            Reconstructor(weights="photographs", threads=3)._networks  # noqa: B018
            assert (torch.get_num_threads(), cv2.getNumThreads()) == (3, 3)
    finally:
        torch.set_num_threads(before[0])
        cv2.setNumThreads(before[1])
    assert asked == [3, 3] * 2
