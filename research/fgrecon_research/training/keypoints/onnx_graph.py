"""A convolutional network written as ONNX: nodes, constants, and kernels in half precision.

A kernel passes a cast to single precision, which readers of ONNX do once. Height and width of input and outputs stay
open, so that the network runs on wide images as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError

_OPSET, _IR = 13, 8  # old enough for OpenCV 4.10


class OnnxGraph:
    """What is appended, in order. Tensors go by their names."""

    def __init__(self) -> None:
        """Begin with nothing.

        Raises:
            InvalidInputError: The package `onnx` is not installed.
        """
        try:
            import onnx
        except ImportError as error:
            raise InvalidInputError("onnx", "not installed", "Run pip install fgrecon-research.") from error
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
            name: Of its output.
            source: Its input.
            kernel: (outputs, inputs, height, width).
            bias: (outputs,).
            stride: In both directions.
            pads: Zeros around the input: top, left, bottom, right.
            half: Keep the kernel in half precision.
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
        """The ONNX file; the same graph gives the same bytes.

        Args:
            name: Of the network.
            entry: Name and channels of its input.
            outputs: Names and channels of its outputs.
        """
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
        content: bytes = model.SerializeToString(deterministic=True)
        return content
