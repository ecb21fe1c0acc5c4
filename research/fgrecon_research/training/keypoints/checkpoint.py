"""Checkpoints of a training: networks, their running average and the optimizer, whole or not at all."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes

_STATES = "network", "average", "optimizer"
_KINDS: Mapping[str, type] = {**dict.fromkeys(_STATES, dict), "step": int, "settings": dict}
_FIX = "Give a checkpoint that the training wrote."


def follow(average: Any, network: Any, decay: float) -> None:
    """Move the running average of a network's weights towards the network; counters are taken over."""
    with torch.no_grad():
        for kept, value in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
            if kept.dtype.is_floating_point:
                kept.lerp_(value, 1.0 - decay)
            else:
                kept.copy_(value)


def save_checkpoint(
    path: Path, network: Any, average: Any, optimizer: Any, step: int, settings: dict[str, Any]
) -> None:
    """Write the state after `step` steps of networks with the given settings."""
    content = io.BytesIO()
    states = {"network": network.state_dict(), "average": average.state_dict(), "optimizer": optimizer.state_dict()}
    torch.save({**states, "step": step, "settings": settings}, content)
    write_bytes(path, content.getvalue())


def restore_checkpoint(
    content: Mapping[str, Any], network: Any, average: Any, optimizer: Any, settings: dict[str, Any]
) -> int:
    """Take over the state of a checkpoint that `load_checkpoint` read; the number of steps behind it.

    Raises:
        InvalidInputError: It is one of networks with other settings, or of other networks.
    """
    if content["settings"] != settings:
        raise InvalidInputError("checkpoint", content["settings"], "Give a checkpoint of a network of the same sizes.")
    try:
        for name, one in zip(_STATES, (network, average, optimizer), strict=True):
            one.load_state_dict(content[name])
    except Exception as error:  # torch promises no kind of error for states of other networks
        raise InvalidInputError("checkpoint", f"another network: {error}", _FIX) from error
    return int(content["step"])


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The content of a checkpoint.

    Raises:
        InvalidInputError: The file is no checkpoint, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()  # torch takes changed numbers as they are
        content = None if damaged else torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch promises no kind of error for damaged content
        raise InvalidInputError("checkpoint", str(path), _FIX) from error
    found: dict[str, Any] = content if isinstance(content, dict) else {}
    if not all(isinstance(found.get(name), kind) for name, kind in _KINDS.items()):
        raise InvalidInputError("checkpoint", str(path), _FIX)
    return found
