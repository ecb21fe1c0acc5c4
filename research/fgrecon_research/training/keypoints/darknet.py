"""YOLOv4-tiny from Darknet's two files, layers (cfg) and numbers (weights), to one ONNX file.

Batch normalisation is folded into the convolutions. Outputs are the raw maps before each `[yolo]` layer;
`fgrecon.perception.vehicles.yolo` makes boxes of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes
from fgrecon.perception.vehicles.detect import INPUT
from fgrecon.perception.vehicles.yolo import HEADS
from fgrecon_research.training.keypoints.onnx_graph import OnnxGraph

__all__ = ["convert", "read_layers"]

_CHANNELS = 3
_LEAK = 0.1  # of Darknet's leaky ReLU
_EPSILON = 1e-5  # Darknet adds it to the variance
_FIX = "Give the yolov4-tiny.cfg and yolov4-tiny.weights of Darknet's authors."

Layer = tuple[str, dict[str, str]]


def read_layers(cfg: Path) -> list[Layer]:
    """The sections of a cfg file in order: name and settings.

    Raises:
        InvalidInputError: The file cannot be read, or a line is neither a section nor a setting; names the line.
    """
    try:
        lines = cfg.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("cfg", str(cfg), _FIX) from error
    layers: list[Layer] = []
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        key, equals, value = text.partition("=")
        if text.startswith("[") and text.endswith("]"):
            layers.append((text[1:-1], {}))
        elif equals and layers:
            settings = layers[-1][1]
            settings[key.strip()] = value.strip()
        elif text:
            raise InvalidInputError(f"{cfg}:{number}", line, _FIX)
    return layers


def convert(cfg: Path, weights: Path, out: Path) -> Path:
    """Write the network of a cfg and a weights file as ONNX.

    Args:
        cfg: Darknet's description of the layers.
        weights: Their numbers.
        out: ONNX file to write.

    Raises:
        InvalidInputError: A file cannot be read, they do not belong together, a layer is not one of YOLOv4-tiny's, its
            anchors are others, or the package `onnx` is not installed.
    """
    layers = read_layers(cfg)
    if not layers or layers[0][0] not in ("net", "network"):
        raise InvalidInputError("cfg", str(cfg), _FIX)
    graph = _Graph(_Numbers(weights))
    try:
        for name, settings in layers[1:]:
            graph.add(name, settings)
    except (KeyError, ValueError, IndexError) as error:
        fix = f"{_FIX} The reason: layer {len(graph.layers)}: {error}"
        raise InvalidInputError("cfg", str(cfg), fix) from error
    graph.numbers.finish()
    if len(graph.outputs) != len(HEADS):
        raise InvalidInputError("cfg", str(cfg), f"{_FIX} This one has {len(graph.outputs)} yolo layers.")
    return write_bytes(out, graph.onnx.model("yolov4-tiny", (INPUT, _CHANNELS), graph.outputs))


class _Numbers:
    """The weights file, read from the beginning to the end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InvalidInputError("weights", str(path), _FIX) from error
        major, minor = np.frombuffer(content, "<i4", 2) if len(content) >= 20 else (0, 0)
        header = 20 if 10 * major + minor >= 2 else 16  # version (3 integers), images seen (8 bytes; 4 in old files)
        self.left = np.frombuffer(content[header : header + (len(content) - header) // 4 * 4], "<f4")

    def take(self, *shape: int) -> NDArray[np.float32]:
        """The next ones, in an array of that shape."""
        count = int(np.prod(shape))
        if count > len(self.left):
            raise InvalidInputError("weights", str(self.path), f"{_FIX} This one ends too early.")
        taken, self.left = self.left[:count], self.left[count:]
        return taken.reshape(shape)

    def finish(self) -> None:
        """Refuse a file with numbers that no layer took."""
        if len(self.left):
            raise InvalidInputError(
                "weights", str(self.path), f"{_FIX} This one has {len(self.left)} numbers too many."
            )


class _Graph:
    """The network, layer after layer, with every layer's tensor and its number of channels."""

    def __init__(self, numbers: _Numbers) -> None:
        self.numbers = numbers
        self.onnx = OnnxGraph()
        self.outputs: list[tuple[str, int]] = []
        self.layers: list[tuple[str, int]] = []

    def add(self, kind: str, settings: Mapping[str, str]) -> None:
        """Append a layer of the cfg file."""
        before, width = self.layers[-1] if self.layers else (INPUT, _CHANNELS)
        name = f"layer{len(self.layers)}"
        if kind == "convolutional":
            made = self._convolution(name, before, width, settings)
        elif kind == "maxpool":
            size, stride = int(settings["size"]), int(settings["stride"])
            made = self.onnx.node("MaxPool", [before], name, kernel_shape=[size] * 2, strides=[stride] * 2), width
        elif kind == "upsample":
            factor = float(settings["stride"])
            nearest = {"mode": "nearest", "nearest_mode": "floor", "coordinate_transformation_mode": "asymmetric"}
            made = self.onnx.enlarged(name, before, factor, **nearest), width
        elif kind == "route":
            made = self._route(name, settings)
        elif kind == "yolo":
            self._check_head(settings)
            self.outputs.append((before, width))
            made = before, width
        else:
            raise ValueError(f"[{kind}]")
        self.layers.append(made)

    def _convolution(self, name: str, before: str, width: int, settings: Mapping[str, str]) -> tuple[str, int]:
        filters, size = int(settings["filters"]), int(settings["size"])
        bias = self.numbers.take(filters).astype(np.float64)
        factor = np.ones(filters)
        if settings.get("batch_normalize", "0") == "1":
            scale, mean, variance = self.numbers.take(3, filters).astype(np.float64)
            if not (variance >= 0.0).all():
                fix = f"{_FIX} This one has negative variances in {name}."
                raise InvalidInputError("weights", str(self.numbers.path), fix)
            factor = scale / np.sqrt(variance + _EPSILON)
            bias -= factor * mean
        kernel = self.numbers.take(filters, width, size, size) * factor[:, None, None, None]
        margin = size // 2 if settings.get("pad", "0") == "1" else 0
        sizes: dict[str, Any] = {"stride": int(settings["stride"]), "pads": [margin] * 4}
        activation = settings["activation"]
        if activation == "linear":
            return self.onnx.convolution(name, before, kernel, bias, **sizes), filters
        if activation != "leaky":
            raise ValueError(f"activation {activation}")
        linear = self.onnx.convolution(f"{name}.linear", before, kernel, bias, **sizes)
        return self.onnx.node("LeakyRelu", [linear], name, alpha=_LEAK), filters

    def _route(self, name: str, settings: Mapping[str, str]) -> tuple[str, int]:
        chosen = [self.layers[int(text)] for text in settings["layers"].split(",")]  # negative: counted from here
        tensors, widths = [tensor for tensor, _ in chosen], [width for _, width in chosen]
        groups = int(settings.get("groups", "1"))
        if groups == 1:
            made = tensors[0] if len(tensors) == 1 else self.onnx.node("Concat", tensors, name, axis=1)
            return made, sum(widths)
        if len(tensors) > 1:
            raise ValueError("groups of several layers")
        width = widths[0] // groups
        start = width * int(settings["group_id"])
        limits = [
            self.onnx.constant(f"{name}.{what}", np.array([value]))
            for what, value in (("from", start), ("to", start + width), ("axis", 1))
        ]
        return self.onnx.node("Slice", [tensors[0], *limits], name), width

    def _check_head(self, settings: Mapping[str, str]) -> None:
        """Refuse a head that the decoding does not know."""
        head = HEADS[len(self.outputs)]
        numbers = [float(text) for text in settings["anchors"].split(",")]
        mask = [int(text) for text in settings["mask"].split(",")]
        anchors = np.array(numbers).reshape(-1, 2)[mask]
        if not np.array_equal(anchors, head.anchors) or float(settings.get("scale_x_y", "1")) != head.stretch:
            raise ValueError("anchors or scale_x_y are not YOLOv4-tiny's")
