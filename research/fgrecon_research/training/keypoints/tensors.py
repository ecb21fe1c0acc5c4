"""Networks of files as PyTorch's tensors, to train on from and to mix."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from torch import from_numpy

from fgrecon.perception.keypoints.network_file import Stored, load_weights


def load_tensors(path: Path) -> Stored:
    """`fgrecon.perception.keypoints.network_file.load_weights`, in tensors.

    Raises:
        InvalidInputError: The file cannot be read or is no network of ours, or has been changed.
    """
    stored = load_weights(path)
    refinement = None if stored.refinement is None else _tensors(stored.refinement)
    return replace(stored, state=_tensors(stored.state), refinement=refinement)


def _tensors(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    return {name: from_numpy(array) for name, array in arrays.items()}


def mean_state(first: Mapping[str, Any], second: Mapping[str, Any], share: float) -> dict[str, Any]:
    """`second` with `share` of `first` in its weights; what only `second` has is taken over.

    The mean of a network and of what further training made of it does better on other images than either
    (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).

    Args:
        share: From 0 to 1.
    """
    return {
        name: share * first[name].to(value) + (1.0 - share) * value
        if name in first and value.dtype.is_floating_point
        else value
        for name, value in second.items()
    }
