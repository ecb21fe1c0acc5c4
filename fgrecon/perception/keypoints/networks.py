"""Forward pass of the networks, written once for every runtime: run by PyTorch, or as a graph by ONNX Runtime.

image (3, S, S) -- EfficientNet-lite0 up to stride 32 --+-- mean -- azimuth, kind: logits over directions, kinds
                    | 4    | 8    | 16    | 32          |
                    +------+------+-------+--> feature pyramid, top down, to stride 4
                                               |
                         K likelihood maps (2 x 2 cells each: softmax over S/2 x S/2 cells)
                                               | likelihood-weighted mean of the features
                                               +-- K visibilities

crop at twice the resolution -- N patches of 32 x 32 around each of K estimates
    (B N, 3 K, 32, 32) -- convolutions in K groups, K networks side by side --> (B N, K, 32 x 32) log likelihoods
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fgrecon.perception.keypoints.layout import PYRAMID, Block, KNetLayout, Layer, RefineLayout

Array = NDArray[np.float32]


class Operations(Protocol):
    """What a runtime does with its values: tensors, or names of a graph's."""

    def scaled(self, image: Any) -> Any:
        """Values of bytes as the networks take them."""

    def conv(self, x: Any, layer: Layer) -> Any:
        """A layer up to its ReLU, by `folded_arrays`."""

    def relu(self, x: Any, most: float | None = None) -> Any:
        """From zero, and up to `most`."""

    def add(self, x: Any, y: Any) -> Any:
        """The sum."""

    def mean(self, x: Any) -> Any:
        """(B, C) over rows and columns."""

    def doubled(self, x: Any) -> Any:
        """Every cell twice along rows and columns."""

    def shuffled(self, x: Any) -> Any:
        """(B, K, 2 H, 2 W) from (B, 4 K, H, W)."""

    def likelihood(self, maps: Any, count: int, side: int) -> Any:
        """(B, K, side, side) softmax over each map."""

    def log_likelihood(self, maps: Any, count: int, cells: int) -> Any:
        """(B, K, cells) logarithm of the softmax over each map."""

    def gathered(self, likelihood: Any, features: Any, count: int, width: int) -> Any:
        """(B, K, C) likelihood-weighted mean of the features (B, C, H, W) under maps of twice their size."""

    def visibility(self, local: Any, pooled: Any) -> Any:
        """(B, K) logits from the features near each keypoint and of the whole crop."""

    def linear(self, x: Any, name: str) -> Any:
        """A linear layer over the last axis, by the name of its arrays."""


def knet(do: Operations, layout: KNetLayout, crops: Any) -> tuple[Any, ...]:
    """Likelihoods (B, K, S / 2, S / 2), logits of visibility (B, K) and of direction (B, 36) of crops (B, 3, S, S).

    And logits of the vehicle's kind (B, N) where the network tells N of them apart.
    """
    x = _active(do, do.scaled(crops), layout.stem)
    levels = []
    for stage in layout.stages:
        for block in stage:
            x = _block(do, x, block)
        levels.append(x)
    pooled = do.mean(x)
    top = None
    for level in reversed(range(len(PYRAMID))):
        x = do.conv(levels[PYRAMID[level]], layout.lateral[level])
        top = _block(do, x if top is None else do.add(x, do.doubled(top)), layout.smooth[level])
    features = _block(do, top, layout.last)
    settings = layout.settings
    maps = do.shuffled(do.conv(features, layout.head))
    likelihood = do.likelihood(maps, settings.keypoints, settings.crop // 2)
    local = do.gathered(likelihood, features, settings.keypoints, settings.width)
    kind = (do.linear(pooled, "kind"),) if settings.kinds else ()
    return likelihood, do.visibility(local, pooled), do.linear(pooled, "azimuth"), *kind


def refinement(do: Operations, layout: RefineLayout, patches: Any, cells: int) -> Any:
    """Log likelihoods (M, K, 32 x 32) over patches (M, 3 K, 32, 32)."""
    x = do.scaled(patches)
    for layer in layout.layers:
        x = do.relu(do.conv(x, layer))
    return do.log_likelihood(do.shuffled(do.conv(x, layout.head)), layout.head.groups, cells)


def _active(do: Operations, x: Any, layer: Layer) -> Any:
    """A layer of KNet, whose ReLU ends at six."""
    y = do.conv(x, layer)
    return do.relu(y, 6.0) if layer.active else y


def _block(do: Operations, x: Any, block: Block) -> Any:
    y = x
    for layer in block.layers:
        y = _active(do, y, layer)
    return do.add(x, y) if block.residual else y


def folded_arrays(layer: Layer, arrays: Mapping[str, Array]) -> tuple[Array, Array]:
    """Kernel and bias of a convolution that does what the layer does up to its ReLU.

    It pads its input on all sides as the layer pads on the right: zeros in the kernel make up for it.
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
