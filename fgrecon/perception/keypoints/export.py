"""The keypoint networks as ONNX files in memory, layer by layer from the modules: nothing is traced.

They take bytes and give what the cascade needs: likelihoods, not logits. `tests/perception/test_runtimes.py` holds them
to what the modules say.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from fgrecon.perception.keypoints.knet import PYRAMID, KNet
from fgrecon.perception.keypoints.refine import PATCH, RefineNet

__all__ = ["knet_model", "refinement_model"]

_OPSET, _FORMAT = 17, 8  # read by onnxruntime since 1.13


class _Graph:
    """A graph in the making: values are names, every method adds a node and names its result."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def add(self, operation: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, list(inputs), [name], **attributes))
        return name

    def constant(self, value: Tensor | NDArray[Any]) -> str:
        from onnx import numpy_helper

        array = value.detach().cpu().numpy() if isinstance(value, Tensor) else value
        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def number(self, value: float) -> str:
        return self.constant(np.array(value, np.float32))

    def scaled(self, image: str) -> str:
        """Values of bytes as the networks take them."""
        values = self.add("Cast", image, to=1)  # float
        shifted = self.add("Sub", values, self.number(127.0))
        return self.add("Div", shifted, self.number(128.0))

    def conv(self, x: str, conv: nn.Conv2d) -> str:
        return self.add(
            "Conv",
            *(x, self.constant(conv.weight), self.constant(conv.bias)),
            group=conv.groups,
            strides=conv.stride,
            dilations=conv.dilation,
            pads=conv.padding * 2,
        )

    def linear(self, x: str, weight: Tensor, bias: Tensor) -> str:
        """Over the last axis."""
        return self.add("Add", self.add("MatMul", x, self.constant(weight.T)), self.constant(bias))

    def reshape(self, x: str, *shape: int) -> str:
        """Zero keeps an axis."""
        return self.add("Reshape", x, self.constant(np.array(shape, np.int64)))

    def same(self, x: str, part: Any) -> str:
        """Of `knet`, folded: convolution and ReLU6."""
        y = self.conv(x, part.conv)
        return self.add("Clip", y, self.number(0.0), self.number(6.0)) if part.active else y

    def separable(self, x: str, part: Any) -> str:
        return self.add("Add", x, self.same(self.same(x, part.depthwise), part.pointwise))

    def block(self, x: str, part: Any) -> str:
        y = x
        for layer in part.layers:
            y = self.same(y, layer)
        return self.add("Add", x, y) if part.residual else y

    def model(self, entry: str, shape: tuple[str | int, ...], results: dict[str, str]) -> bytes:
        """The file, with an input of bytes and results by the names of their values."""
        from onnx import TensorProto, helper

        nodes = [*self.nodes, *(helper.make_node("Identity", [value], [name]) for name, value in results.items())]
        inputs = [helper.make_tensor_value_info(entry, TensorProto.UINT8, shape)]
        outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in results]
        graph = helper.make_graph(nodes, "network", inputs, outputs, self.weights)
        opset = helper.make_opsetid("", _OPSET)
        return bytes(helper.make_model(graph, opset_imports=[opset], ir_version=_FORMAT).SerializeToString())


def knet_model(network: KNet) -> bytes:
    """KNet, folded, on crops (B, S, S, 3) of bytes.

    It gives the likelihoods (B, K, S / 2, S / 2), each map's sum one, and the logits of visibility (B, K) and
    direction (B, 36).
    """
    graph, settings = _Graph(), network.settings
    count, width, side = settings.keypoints, settings.width, settings.crop // 2
    x = graph.same(graph.scaled(graph.add("Transpose", "crops", perm=[0, 3, 1, 2])), network.stem)
    levels = []
    for stage in network.stages:
        for block in stage:
            x = graph.block(x, block)
        levels.append(x)
    pooled = graph.add("ReduceMean", x, axes=[2, 3], keepdims=0)
    top = ""
    for level in reversed(range(len(PYRAMID))):
        x = graph.conv(levels[PYRAMID[level]], network.lateral[level])
        if top:
            twice = graph.constant(np.array([1, 1, 2, 2], np.float32))
            how = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
            x = graph.add("Add", x, graph.add("Resize", top, "", twice, **how))
        top = graph.separable(x, network.smooth[level])
    features = graph.separable(top, network.last)
    maps = graph.add("DepthToSpace", graph.conv(features, network.head), blocksize=2, mode="CRD")
    likelihood = graph.add("Softmax", graph.reshape(maps, 0, count, side * side), axis=-1)
    likelihood = graph.reshape(likelihood, 0, count, side, side)
    mean = graph.add("AveragePool", likelihood, kernel_shape=[2, 2], strides=[2, 2])
    coarse = graph.reshape(graph.add("Mul", mean, graph.number(4.0)), 0, count, -1)
    cells = graph.add("Transpose", graph.reshape(features, 0, width, -1), perm=[0, 2, 1])
    local = graph.add("MatMul", coarse, cells)  # (B, K, width)
    context = graph.reshape(graph.linear(pooled, network.context.weight, network.context.bias), 0, 1, width)
    near, far = network.see.weight.split(width, dim=1)  # one layer on both, side by side
    mixed = graph.add("Add", graph.linear(local, near, network.see.bias), graph.linear(context, far, network.name))
    seen = graph.add("Mul", graph.add("Relu", mixed), graph.constant(network.visible))
    total = graph.add("ReduceSum", seen, graph.constant(np.array([2], np.int64)), keepdims=0)
    visible = graph.add("Add", total, graph.constant(network.bias))
    azimuth = graph.linear(pooled, network.azimuth.weight, network.azimuth.bias)
    results = {"likelihood": likelihood, "visible": visible, "azimuth": azimuth}
    return graph.model("crops", ("count", settings.crop, settings.crop, 3), results)


def refinement_model(network: RefineNet) -> bytes:
    """The refinement networks, folded, on patches (M, 3 K, 32, 32) of bytes: log likelihoods (M, K, 32 * 32)."""
    graph, count = _Graph(), network.settings.keypoints
    x = graph.scaled("patches")
    for layer in network.layers:
        x = graph.add("Relu", graph.conv(x, layer.conv))
    maps = graph.add("DepthToSpace", graph.conv(x, network.head), blocksize=2, mode="CRD")
    logs = graph.add("LogSoftmax", graph.reshape(maps, 0, count, PATCH * PATCH), axis=-1)
    return graph.model("patches", ("count", 3 * count, PATCH, PATCH), {"logs": logs})
