"""Networks made ready to be used on PyTorch: the same numbers from less work.

What is fixed once training is over goes into the convolutions: a batch normalisation is a factor and an offset per
channel, and a row and column of padding on one side only is a kernel that is zero there.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from fgrecon.perception.keypoints.sessions import Network

__all__ = ["folded", "knet_on_torch", "refinement_on_torch"]


def folded(network: nn.Module) -> Any:
    """A copy for inference, with weights in channels-last order.

    Its outputs are those of the network in evaluation mode to rounding (1e-5 of a logit). It cannot be trained, and its
    weights have other names and shapes than the file's.

    Args:
        network: Made of parts with a convolution `conv`, a batch normalisation `norm` that follows it, and maybe `pad`:
            zeros around the input (left, right, top, bottom), at most one more on the right than on the left.
    """
    copy = deepcopy(network).eval()
    for part in copy.modules():
        if isinstance(getattr(part, "norm", None), nn.BatchNorm2d):
            part.conv = fuse_conv_bn_eval(part.conv, part.norm)
            part.norm = nn.Identity()
        if getattr(part, "pad", None) is not None:
            part.conv = _padding(part.conv, part.pad)
            part.pad = None
    return copy.to(memory_format=torch.channels_last)


def _padding(conv: nn.Conv2d, pad: tuple[int, int, int, int]) -> nn.Conv2d:
    """A convolution that pads its input itself, on all sides as on the right; zeros in the kernel make up for it."""
    left, right, top, bottom = pad
    weight = functional.pad(conv.weight.detach(), (right - left, 0, bottom - top, 0))
    padded = nn.Conv2d(
        conv.in_channels, conv.out_channels, weight.shape[2:], conv.stride, (bottom, right), groups=conv.groups
    )
    padded.weight, padded.bias = nn.Parameter(weight), conv.bias
    return padded


def knet_on_torch(network: Any, device: str) -> Network:
    """KNet on crops (B, S, S, 3) of bytes: likelihoods (B, K, S / 2, S / 2), logits of visibility and direction."""

    def run(crops: NDArray[Any]) -> Sequence[NDArray[np.float32]]:
        with torch.inference_mode():
            tensor = torch.from_numpy(np.ascontiguousarray(crops)).to(device).permute(0, 3, 1, 2).float()
            output = network(tensor)
            shape = output.maps.shape
            likelihood = torch.softmax(output.maps.float().flatten(2), dim=2).view(shape)
            return [value.float().cpu().numpy() for value in (likelihood, output.visible, output.azimuth)]

    return run


def refinement_on_torch(network: Any, device: str) -> Network:
    """The refinement networks on patches (M, 3 K, 32, 32) of bytes: log likelihoods (M, K, 32 * 32)."""
    keypoints = network.settings.keypoints

    def run(patches: NDArray[Any]) -> Sequence[NDArray[np.float32]]:
        with torch.inference_mode():
            flat = torch.from_numpy(np.ascontiguousarray(patches)).to(device)
            flat = flat.contiguous(memory_format=torch.channels_last)  # while they are bytes
            logits = network(flat.unflatten(1, (keypoints, 3)).float()).float()
            return [torch.log_softmax(logits.flatten(2), dim=2).cpu().numpy()]

    return run
