"""The second half of the cascade: one small network per keypoint looks at patches around KNet's estimate.

    crop at twice KNet's resolution -- N patches of 32 x 32 around each of K estimates
        (B N, 3 K, 32, 32) -- grouped convolutions, K groups --> (B N, K, 32, 32) likelihoods over the patches
            -- averaged where patches overlap, times KNet's own likelihood --> position, covariance

All K x N patches of all vehicles run in one batch: a convolution with K groups is K networks side by side.
"""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from fgrecon.perception.keypoints.layout import MEAN, PATCH, SPREAD, Layer, RefineLayout, RefineSettings
from fgrecon.perception.keypoints.patches import cut_patches, fuse, patch_offsets, run_networks, window_of

__all__ = ["PATCH", "RefineNet", "RefineSettings", "cut_patches", "fuse", "patch_offsets", "run_networks", "window_of"]


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
    """K small networks side by side; see the module's docstring."""

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
