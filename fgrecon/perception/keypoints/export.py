"""The keypoint networks as ONNX files in memory, layer by layer from the arrays of a file: PyTorch is not needed.

They take bytes and give what the cascade needs: likelihoods, not logits. `tests/perception/test_runtimes.py` holds them
to what the modules say. Normalisations and padding on one side go into the convolutions, as `fold` has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.perception.keypoints.layout import (
    MEAN,
    PATCH,
    PYRAMID,
    SPREAD,
    Block,
    KNetLayout,
    KNetSettings,
    Layer,
    RefineLayout,
    RefineSettings,
)

__all__ = ["folded_arrays", "knet_model", "refinement_model"]

Array = NDArray[np.float32]

_OPSET, _FORMAT = 17, 8  # read by onnxruntime since 1.13


def folded_arrays(layer: Layer, arrays: Mapping[str, Array]) -> tuple[Array, Array]:
    """Kernel and bias of a convolution that does what the layer does up to its ReLU.

    It pads its input on all sides as the layer pads on the right: zeros in the kernel make up for it.

    Args:
        layer: Of a network.
        arrays: Those of the network, by name.
    """
    name = layer.name
    if layer.epsilon is None:
        return arrays[f"{name}.weight"], arrays[f"{name}.bias"]
    gamma, beta, mean, variance = (
        arrays[f"{name}.norm.{field}"] for field in ("weight", "bias", "running_mean", "running_var")
    )
    with np.errstate(all="ignore"):  # a file may have any variance
        scale = np.float32(1.0) / np.sqrt(variance + np.float32(layer.epsilon))
        kernel = arrays[f"{name}.conv.weight"] * (gamma * scale)[:, None, None, None]
        bias = beta - mean * scale * gamma
    more = layer.padding[1] - layer.padding[0]
    return np.pad(kernel, ((0, 0), (0, 0), (more, 0), (more, 0))) if more else kernel, bias


class _Graph:
    """A graph in the making: values are names, every method adds a node and names its result."""

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self.arrays = arrays
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def add(self, operation: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, list(inputs), [name], **attributes))
        return name

    def constant(self, value: NDArray[Any]) -> str:
        from onnx import numpy_helper

        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def number(self, value: float) -> str:
        return self.constant(np.array(value, np.float32))

    def scaled(self, image: str) -> str:
        """Values of bytes as the networks take them."""
        values = self.add("Cast", image, to=1)  # float
        shifted = self.add("Sub", values, self.number(MEAN))
        return self.add("Div", shifted, self.number(SPREAD))

    def conv(self, x: str, layer: Layer) -> str:
        return self.add(
            "Conv",
            *(x, *(self.constant(array) for array in folded_arrays(layer, self.arrays))),
            group=layer.groups,
            strides=[layer.stride] * 2,
            dilations=[layer.dilation] * 2,
            pads=[layer.padding[1]] * 4,
        )

    def linear(self, x: str, weight: Array, bias: Array) -> str:
        """Over the last axis."""
        return self.add("Add", self.add("MatMul", x, self.constant(weight.T)), self.constant(bias))

    def reshape(self, x: str, *shape: int) -> str:
        """Zero keeps an axis."""
        return self.add("Reshape", x, self.constant(np.array(shape, np.int64)))

    def same(self, x: str, layer: Layer) -> str:
        """Of KNet: its ReLU ends at six."""
        y = self.conv(x, layer)
        return self.add("Clip", y, self.number(0.0), self.number(6.0)) if layer.active else y

    def block(self, x: str, block: Block) -> str:
        y = x
        for layer in block.layers:
            y = self.same(y, layer)
        return self.add("Add", x, y) if block.residual else y

    def model(self, entry: str, shape: tuple[str | int, ...], results: dict[str, str]) -> bytes:
        """The file, with an input of bytes and results by the names of their values."""
        from onnx import TensorProto, helper

        nodes = [*self.nodes, *(helper.make_node("Identity", [value], [name]) for name, value in results.items())]
        inputs = [helper.make_tensor_value_info(entry, TensorProto.UINT8, shape)]
        outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in results]
        graph = helper.make_graph(nodes, "network", inputs, outputs, self.weights)
        opset = helper.make_opsetid("", _OPSET)
        return bytes(helper.make_model(graph, opset_imports=[opset], ir_version=_FORMAT).SerializeToString())


def knet_model(settings: KNetSettings, arrays: Mapping[str, Array]) -> bytes:
    """KNet on crops (B, S, S, 3) of bytes.

    It gives the likelihoods (B, K, S / 2, S / 2), each map's sum one, and the logits of visibility (B, K) and
    direction (B, 36).

    Args:
        settings: Its sizes.
        arrays: Its arrays by name, all that `KNetLayout` has and of the same shapes.
    """
    graph, layout = _Graph(arrays), KNetLayout.of(settings)
    count, width, side = settings.keypoints, settings.width, settings.crop // 2
    x = graph.same(graph.scaled(graph.add("Transpose", "crops", perm=[0, 3, 1, 2])), layout.stem)
    levels = []
    for stage in layout.stages:
        for block in stage:
            x = graph.block(x, block)
        levels.append(x)
    pooled = graph.add("ReduceMean", x, axes=[2, 3], keepdims=0)
    top = ""
    for level in reversed(range(len(PYRAMID))):
        x = graph.conv(levels[PYRAMID[level]], layout.lateral[level])
        if top:
            twice = graph.constant(np.array([1, 1, 2, 2], np.float32))
            how = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
            x = graph.add("Add", x, graph.add("Resize", top, "", twice, **how))
        top = graph.block(x, layout.smooth[level])
    features = graph.block(top, layout.last)
    maps = graph.add("DepthToSpace", graph.conv(features, layout.head), blocksize=2, mode="CRD")
    likelihood = graph.add("Softmax", graph.reshape(maps, 0, count, side * side), axis=-1)
    likelihood = graph.reshape(likelihood, 0, count, side, side)
    mean = graph.add("AveragePool", likelihood, kernel_shape=[2, 2], strides=[2, 2])
    coarse = graph.reshape(graph.add("Mul", mean, graph.number(4.0)), 0, count, -1)
    cells = graph.add("Transpose", graph.reshape(features, 0, width, -1), perm=[0, 2, 1])
    local = graph.add("MatMul", coarse, cells)  # (B, K, width)
    context = graph.reshape(graph.linear(pooled, arrays["context.weight"], arrays["context.bias"]), 0, 1, width)
    near, far = np.split(arrays["see.weight"], 2, axis=1)  # one layer on both, side by side
    mixed = graph.add("Add", graph.linear(local, near, arrays["see.bias"]), graph.linear(context, far, arrays["name"]))
    seen = graph.add("Mul", graph.add("Relu", mixed), graph.constant(arrays["visible"]))
    total = graph.add("ReduceSum", seen, graph.constant(np.array([2], np.int64)), keepdims=0)
    visible = graph.add("Add", total, graph.constant(arrays["bias"]))
    azimuth = graph.linear(pooled, arrays["azimuth.weight"], arrays["azimuth.bias"])
    results = {"likelihood": likelihood, "visible": visible, "azimuth": azimuth}
    return graph.model("crops", ("count", settings.crop, settings.crop, 3), results)


def refinement_model(settings: RefineSettings, arrays: Mapping[str, Array]) -> bytes:
    """The refinement networks on patches (M, 3 K, 32, 32) of bytes: log likelihoods (M, K, 32 * 32).

    Args:
        settings: Their sizes.
        arrays: Their arrays by name, all that `RefineLayout` has and of the same shapes.
    """
    graph, layout, count = _Graph(arrays), RefineLayout.of(settings), settings.keypoints
    x = graph.scaled("patches")
    for layer in layout.layers:
        x = graph.add("Relu", graph.conv(x, layer))
    maps = graph.add("DepthToSpace", graph.conv(x, layout.head), blocksize=2, mode="CRD")
    logs = graph.add("LogSoftmax", graph.reshape(maps, 0, count, PATCH * PATCH), axis=-1)
    return graph.model("patches", ("count", 3 * count, PATCH, PATCH), {"logs": logs})
