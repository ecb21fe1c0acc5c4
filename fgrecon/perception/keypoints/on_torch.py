"""The networks on PyTorch, for inference: convolutions of channels-last arrays, and nothing that is trained."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.layout import MEAN, PATCH, SPREAD, KNetLayout, Layer, RefineLayout
from fgrecon.perception.keypoints.networks import folded_arrays, knet, refinement
from fgrecon.perception.keypoints.sessions import Network

Array = NDArray[np.float32]


class _Eager:
    """`Operations` that compute."""

    def __init__(self, layers: Iterable[Layer], arrays: Mapping[str, Array], device: str) -> None:
        self.arrays = {name: torch.from_numpy(array).to(device) for name, array in arrays.items()}
        self.layers: dict[str, tuple[Tensor, Tensor]] = {}
        for layer in layers:
            kernel, bias = (torch.from_numpy(array).to(device) for array in folded_arrays(layer, arrays))
            self.layers[layer.name] = kernel.to(memory_format=torch.channels_last), bias

    def scaled(self, image: Tensor) -> Tensor:
        return (image.float() - MEAN) / SPREAD

    def conv(self, x: Tensor, layer: Layer) -> Tensor:
        kernel, bias = self.layers[layer.name]
        return functional.conv2d(x, kernel, bias, layer.stride, layer.padding[1], layer.dilation, layer.groups)

    def relu(self, x: Tensor, most: float | None = None) -> Tensor:
        return functional.relu(x, inplace=True) if most is None else functional.hardtanh(x, 0.0, most, inplace=True)

    def add(self, x: Tensor, y: Tensor) -> Tensor:
        return x + y

    def mean(self, x: Tensor) -> Tensor:
        return x.mean(dim=(2, 3))

    def doubled(self, x: Tensor) -> Tensor:
        return functional.interpolate(x, scale_factor=2.0, mode="nearest")

    def shuffled(self, x: Tensor) -> Tensor:
        return functional.pixel_shuffle(x, 2)

    def likelihood(self, maps: Tensor, count: int, side: int) -> Tensor:
        return torch.softmax(maps.flatten(2), dim=2).view(-1, count, side, side)

    def log_likelihood(self, maps: Tensor, count: int, cells: int) -> Tensor:
        return torch.log_softmax(maps.reshape(-1, count, cells), dim=2)

    def gathered(self, likelihood: Tensor, features: Tensor, count: int, width: int) -> Tensor:
        coarse = (functional.avg_pool2d(likelihood, 2) * 4.0).reshape(-1, count, features[0, 0].numel())
        return torch.einsum("bkp,bcp->bkc", coarse, features.reshape(-1, width, coarse.shape[2]))

    def visibility(self, local: Tensor, pooled: Tensor) -> Tensor:
        context = self.linear(pooled, "context")[:, None].expand_as(local)
        active = functional.relu(self.linear(torch.cat([local, context], dim=2), "see") + self.arrays["name"])
        return (active * self.arrays["visible"]).sum(dim=2) + self.arrays["bias"]

    def linear(self, x: Tensor, name: str) -> Tensor:
        return functional.linear(x, self.arrays[f"{name}.weight"], self.arrays[f"{name}.bias"])


def check_device(device: str) -> None:
    """Refuse a device that PyTorch has not."""
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:  # how torch says so depends on how it was built
        raise InvalidInputError("device", device, f"Give `cpu`: nothing here runs networks on it ({error}).") from error


@contextmanager
def _with_threads(number: int) -> Iterator[None]:
    """So many threads for this thread's arithmetic, and as many as before afterwards.

    OpenMP's wait for work with all that their cores have: beside other work a second one makes networks ten times as
    slow.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def knet_on_torch(layout: KNetLayout, arrays: Mapping[str, Array], device: str, threads: int) -> Network:
    """KNet on crops (B, S, S, 3) of bytes, by its arrays as `KNetLayout` names them: see `networks.knet`."""
    do = _Eager(layout.layers, arrays, device)

    def run(crops: NDArray[Any]) -> Sequence[Array]:
        with _with_threads(threads), torch.inference_mode():
            tensor = torch.from_numpy(np.ascontiguousarray(crops)).to(device).permute(0, 3, 1, 2)
            return [value.cpu().numpy() for value in knet(do, layout, tensor)]

    return run


def refinement_on_torch(layout: RefineLayout, arrays: Mapping[str, Array], device: str, threads: int) -> Network:
    """The refinement networks on patches (M, 3 K, 32, 32) of bytes, likewise: see `networks.refinement`."""
    do = _Eager((*layout.layers, layout.head), arrays, device)

    def run(patches: NDArray[Any]) -> Sequence[Array]:
        with _with_threads(threads), torch.inference_mode():
            tensor = torch.from_numpy(np.ascontiguousarray(patches)).to(device)
            tensor = tensor.contiguous(memory_format=torch.channels_last)  # while they are bytes
            return [refinement(do, layout, tensor, PATCH * PATCH).cpu().numpy()]

    return run
