"""Silhouettes by a network in pieces, here one that finds what is bright."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import write_png
from fgrecon_research.training.keypoints.segment import assemble, draw_silhouettes, in_order, resized
from research.tests.training.keypoints.support import made_up_cars, unit_car_prior

SIDE = 1024


def made_up_network():
    """Mean of the channels, halved and enlarged again as the real network does it, brighter than grey."""
    onnx = pytest.importorskip("onnx")
    from onnx import helper, numpy_helper

    def constant(name, values):
        value = numpy_helper.from_array(np.array(values, dtype=np.int64))
        return helper.make_node("Constant", [], [name], name=name, value=value)

    nodes = [
        helper.make_node("ReduceMean", ["input"], ["grey"], axes=[1], keepdims=1),
        helper.make_node("AveragePool", ["grey"], ["small"], kernel_shape=[2, 2], strides=[2, 2]),
        helper.make_node("Shape", ["small"], ["shape"]),
        *(constant(name, [value]) for name, value in (("begin", 0), ("end", 2), ("axis", 0))),
        helper.make_node("Slice", ["shape", "begin", "end", "axis"], ["front"]),
        constant("size", [SIDE, SIDE]),
        helper.make_node("Concat", ["front", "size"], ["whole"], axis=0),
        helper.make_node("Resize", ["small", "", "", "whole"], ["large"], mode="nearest"),
        helper.make_node("Sigmoid", ["large"], ["output"]),
    ]
    tensor = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "bright",
        [tensor("input", onnx.TensorProto.FLOAT, [1, 3, SIDE, SIDE])],
        [
            tensor("output", onnx.TensorProto.FLOAT, [1, 1, SIDE, SIDE]),
            tensor("small", onnx.TensorProto.FLOAT, [1, 1, SIDE // 2, SIDE // 2]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 8
    return model.SerializeToString()


@pytest.fixture
def package(tmp_path):
    model = made_up_network()
    folder = tmp_path / "package" / "dist"
    folder.mkdir(parents=True)
    half = len(model) // 2
    for name, piece in (("a", model[:half]), ("b", model[half:])):
        (folder / name).write_bytes(piece)
    entry = {"size": len(model), "chunks": [{"hash": "a"}, {"hash": "b"}]}
    (folder / "resources.json").write_text(json.dumps({"/models/medium": entry}))
    return folder.parent


def test_pieces_are_put_together(package):
    assert assemble(package) == made_up_network()
    (package / "dist" / "b").write_bytes(b"cut")
    with pytest.raises(InvalidInputError, match="bytes"):
        assemble(package)
    (package / "dist" / "b").unlink()
    with pytest.raises(InvalidInputError, match="package"):
        assemble(package)


def test_the_network_takes_smaller_images(package):
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(resized(assemble(package), 64), providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"input": np.zeros((1, 3, 64, 64), dtype=np.float32)})
    assert found.shape == (1, 1, 64, 64)
    with pytest.raises(InvalidInputError, match="side"):
        resized(assemble(package), 65)


def test_silhouettes_are_drawn_once(package, tmp_path):
    pytest.importorskip("onnxruntime")
    rng = np.random.default_rng(0)
    cars = made_up_cars(unit_car_prior(), np.zeros(5), 2, rng, tmp_path)
    for car in cars:
        image = np.zeros((car.size[1], car.size[0], 3), dtype=np.uint8)
        image[:, : car.size[0] // 2] = 255
        write_png(car.image, image)
    out = tmp_path / "silhouettes"
    assert draw_silhouettes(cars, package, out, side=64) == [car.silhouette(out) for car in cars]
    drawn = cv2.imread(str(out / f"{cars[0].image.stem}.png"), cv2.IMREAD_GRAYSCALE)
    assert drawn.shape == (cars[0].size[1], cars[0].size[0])
    assert drawn[:, 5].min() > 127 > drawn[:, -5].max()
    assert draw_silhouettes(cars, package, out, side=64) == []


def test_photographs_are_spread_over_shapes_and_directions():
    cars = made_up_cars(unit_car_prior(), np.zeros(5), 30, np.random.default_rng(1))
    cars = [replace(car, cad_id="ab"[i % 2]) for i, car in enumerate(cars)]
    chosen = in_order(cars, 4)
    assert [car.cad_id for car in chosen] == list("ab" * 4)
    azimuth = np.sort([car.azimuth for car in chosen if car.cad_id == "a"])
    assert np.diff(azimuth).min() > np.radians(25)
    assert len(in_order(cars, 100)) == 30
