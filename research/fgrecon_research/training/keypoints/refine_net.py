"""The refinement networks as they are trained, on PyTorch: one small network for each keypoint, side by side."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from fgrecon.perception.keypoints.layout import MEAN, SPREAD, Layer, RefineLayout, RefineSettings


class _Grouped(nn.Module):  # type: ignore[misc]
    """Convolution in K groups, batch normalisation, ReLU."""

    def __init__(self, layer: Layer) -> None:
        super().__init__()
        self.conv = nn.Conv2d(
            *(layer.inputs, layer.outputs, layer.kernel, layer.stride, layer.padding[0]),
            dilation=layer.dilation,
            groups=layer.groups,
            bias=False,
        )
        self.norm = nn.BatchNorm2d(layer.outputs, eps=layer.epsilon)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)), inplace=True)


class RefineNet(nn.Module):  # type: ignore[misc]
    """K small networks side by side: a convolution with K groups."""

    def __init__(self, settings: RefineSettings | None = None) -> None:
        """Build with random weights."""
        super().__init__()
        self.settings = settings = RefineSettings() if settings is None else settings
        layout = RefineLayout.of(settings)
        self.layers = nn.Sequential(*(_Grouped(layer) for layer in layout.layers))
        self.head = nn.Conv2d(layout.head.inputs, layout.head.outputs, 1, groups=layout.head.groups)

    def forward(self, patches: Tensor) -> Tensor:
        """Logits (M, K, 32, 32) over patches (M, K, 3, 32, 32) of RGB values from 0 to 255."""
        x = ((patches - MEAN) / SPREAD).flatten(1, 2)
        return functional.pixel_shuffle(self.head(self.layers(x)), 2)
