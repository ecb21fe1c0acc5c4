"""Checkpoints of a training: networks, their running average and the optimizer, whole or not at all."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import write_bytes

__all__ = ["follow", "load_checkpoint", "restore_checkpoint", "save_checkpoint"]


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


def restore_checkpoint(path: Path, network: Any, average: Any, optimizer: Any, settings: dict[str, Any]) -> int:
    """Take over the state of a checkpoint; the number of steps behind it.

    Raises:
        InvalidInputError: The file is no checkpoint, or one of networks with other settings.
    """
    content = load_checkpoint(path)
    if content["settings"] != settings:
        raise InvalidInputError("checkpoint", content["settings"], "Give a checkpoint of a network of the same sizes.")
    network.load_state_dict(content["network"])
    average.load_state_dict(content["average"])
    optimizer.load_state_dict(content["optimizer"])
    return int(content["step"])


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The content of a checkpoint.

    Raises:
        InvalidInputError: The file is no checkpoint.
    """
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise InvalidInputError("checkpoint", str(path), "Give a checkpoint that the training wrote.") from error
    return content
