"""The networks on ONNX Runtime, as ONNX files in memory: PyTorch is not needed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.perception.keypoints.layout import MEAN, PATCH, SPREAD, KNetLayout, Layer, RefineLayout
from fgrecon.perception.keypoints.networks import folded_arrays, knet, refinement
from fgrecon.perception.keypoints.sessions import Network, open_session

Array = NDArray[np.float32]

_OPSET, _FORMAT = 17, 8  # read by onnxruntime since 1.13


class _Graph:
    """`Operations` that make a graph: values are names, every operation adds a node and names its result."""

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self.arrays = arrays
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def node(self, operation: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, list(inputs), [name], **attributes))
        return name

    def constant(self, value: Any, kind: type = np.float32) -> str:
        from onnx import numpy_helper

        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.array(value, kind, order="C"), name))
        return name

    def reshaped(self, x: str, *shape: int) -> str:
        """Zero keeps an axis."""
        return self.node("Reshape", x, self.constant(shape, np.int64))

    def scaled(self, image: str) -> str:
        values = self.node("Cast", image, to=1)  # float
        return self.node("Div", self.node("Sub", values, self.constant(MEAN)), self.constant(SPREAD))

    def conv(self, x: str, layer: Layer) -> str:
        return self.node(
            "Conv",
            *(x, *(self.constant(array) for array in folded_arrays(layer, self.arrays))),
            group=layer.groups,
            strides=[layer.stride] * 2,
            dilations=[layer.dilation] * 2,
            pads=[layer.padding[1]] * 4,
        )

    def relu(self, x: str, most: float | None = None) -> str:
        return self.node("Relu", x) if most is None else self.node("Clip", x, self.constant(0.0), self.constant(most))

    def add(self, x: str, y: str) -> str:
        return self.node("Add", x, y)

    def mean(self, x: str) -> str:
        return self.node("ReduceMean", x, axes=[2, 3], keepdims=0)

    def doubled(self, x: str) -> str:
        how = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
        return self.node("Resize", x, "", self.constant([1, 1, 2, 2]), **how)

    def shuffled(self, x: str) -> str:
        return self.node("DepthToSpace", x, blocksize=2, mode="CRD")

    def likelihood(self, maps: str, count: int, side: int) -> str:
        flat = self.node("Softmax", self.reshaped(maps, 0, count, side * side), axis=-1)
        return self.reshaped(flat, 0, count, side, side)

    def log_likelihood(self, maps: str, count: int, cells: int) -> str:
        return self.node("LogSoftmax", self.reshaped(maps, 0, count, cells), axis=-1)

    def gathered(self, likelihood: str, features: str, count: int, width: int) -> str:
        mean = self.node("AveragePool", likelihood, kernel_shape=[2, 2], strides=[2, 2])
        coarse = self.reshaped(self.node("Mul", mean, self.constant(4.0)), 0, count, -1)
        cells = self.node("Transpose", self.reshaped(features, 0, width, -1), perm=[0, 2, 1])
        return self.node("MatMul", coarse, cells)

    def visibility(self, local: str, pooled: str) -> str:
        arrays = self.arrays
        context = self.reshaped(self.linear(pooled, "context"), 0, 1, len(arrays["context.bias"]))
        near, far = np.split(arrays["see.weight"], 2, axis=1)  # one layer on both, side by side
        mixed = self.add(self._product(local, near, arrays["see.bias"]), self._product(context, far, arrays["name"]))
        active = self.node("Mul", self.relu(mixed), self.constant(arrays["visible"]))
        total = self.node("ReduceSum", active, self.constant([2], np.int64), keepdims=0)
        return self.add(total, self.constant(arrays["bias"]))

    def linear(self, x: str, name: str) -> str:
        return self._product(x, self.arrays[f"{name}.weight"], self.arrays[f"{name}.bias"])

    def _product(self, x: str, weight: Array, bias: Array) -> str:
        return self.add(self.node("MatMul", x, self.constant(weight.T)), self.constant(bias))

    def model(self, entry: str, shape: tuple[str | int, ...], results: dict[str, str]) -> bytes:
        """The file, with an input of bytes and results by the names of their values."""
        from onnx import TensorProto, helper

        nodes = [*self.nodes, *(helper.make_node("Identity", [value], [name]) for name, value in results.items())]
        inputs = [helper.make_tensor_value_info(entry, TensorProto.UINT8, shape)]
        outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in results]
        graph = helper.make_graph(nodes, "network", inputs, outputs, self.weights)
        opset = helper.make_opsetid("", _OPSET)
        return bytes(helper.make_model(graph, opset_imports=[opset], ir_version=_FORMAT).SerializeToString())


def knet_on_onnx(layout: KNetLayout, arrays: Mapping[str, Array], threads: int, device: str) -> Network:
    """KNet on crops (B, S, S, 3) of bytes, by its arrays as `KNetLayout` names them: see `networks.knet`."""
    graph, side = _Graph(arrays), layout.settings.crop
    outputs = knet(graph, layout, graph.node("Transpose", "crops", perm=[0, 3, 1, 2]))
    results = dict(zip(("likelihood", "visible", "azimuth", "kind"), outputs, strict=False))
    return open_session(graph.model("crops", ("count", side, side, 3), results), threads, device)


def refinement_on_onnx(layout: RefineLayout, arrays: Mapping[str, Array], threads: int, device: str) -> Network:
    """The refinement networks on patches (M, 3 K, 32, 32) of bytes, likewise: see `networks.refinement`."""
    graph = _Graph(arrays)
    logs = refinement(graph, layout, "patches", PATCH * PATCH)
    shape = ("count", 3 * layout.head.groups, PATCH, PATCH)
    return open_session(graph.model("patches", shape, {"logs": logs}), threads, device)
