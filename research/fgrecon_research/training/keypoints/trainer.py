"""Training loop of all networks: networks of files as tensors, the schedule, and resumable steps."""

from __future__ import annotations

import copy
import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from numpy.typing import NDArray
from torch import from_numpy

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import stored, write_bytes
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
    """`second` with a share, from 0 to 1, of `first` in its weights; what only `second` has is taken over.

    The mean of a network and of what further training made of it does better on other images than either
    (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR 2022).
    """
    return {
        name: share * first[name].to(value) + (1.0 - share) * value
        if name in first and value.dtype.is_floating_point
        else value
        for name, value in second.items()
    }


# Checkpoints of a training: networks, their running average and the optimizer, whole or not at all.

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


Network = TypeVar("Network", bound=torch.nn.Module)


@dataclass(frozen=True)
class Schedule:
    """How long and how fast a network is trained."""

    steps: int = 4000  # gradient steps in all; the last `decay` of them lower the rate to zero
    decay: float = 0.25  # share of the steps
    batch: int = 32  # samples per step
    rate: float = 1e-3  # learning rate
    warmup: int = 100  # steps over which the rate rises
    average: float = 0.998  # decay per step of the moving average of the weights, which is what is kept
    seed: int = 0  # of samples and first weights
    save_every: int = 100  # steps between checkpoints
    workers: int = 1  # processes that make samples; 0 makes them in this one
    device: str = "cpu"  # Torch's name of the device

    def lasting(self) -> dict[str, Any]:
        """What changes the network, as plain values: not how many processes work on which device, and when it saves."""
        return {name: value for name, value in asdict(self).items() if name not in ("workers", "save_every", "device")}

    def rate_at(self, step: int) -> float:
        """Learning rate of a step: up, level, and down to zero."""
        start = round(self.steps * (1.0 - self.decay))
        down = 1.0 if step < start else (self.steps - step) / max(self.steps - start, 1)
        return self.rate * min(1.0, (step + 1) / max(self.warmup, 1)) * max(down, 0.0)


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training has come."""

    step: int  # steps done
    steps: int  # of how many
    losses: dict[str, float]  # mean of each part of the loss since the last report
    # score of the averaged network on held-out samples (PCK at 0.1 of KNet); None where there are none
    score: float | None = None


class Display:
    """Shows how a training goes; this one shows nothing."""

    def log(self, line: str) -> None:
        """What begins."""

    def report(self, progress: TrainingProgress) -> None:
        """How far it is, and how good."""

    def progress(self, things: Sequence[Any], heading: str) -> Iterable[Any]:  # noqa: ARG002
        """Go through some things and show how far that has come."""
        return things


class Trainer(Generic[Network]):
    """A network in training, its running average and its optimizer; a checkpoint that exists is taken over.

    A damaged one is named and put aside.

    Args:
        network: On its device already.
        groups: Parameters for the optimizer, with the `share` of the learning rate that each group has.
        how: Schedule.
        checkpoint: File to go on from and to write to.
        settings: Sizes of the network: a checkpoint of others is refused.
        report: Called after every `save_every` steps.
        score: Gives the averaged network's score for the report.
    """

    def __init__(
        self,
        network: Network,
        groups: list[dict[str, Any]],
        how: Schedule,
        checkpoint: Path,
        settings: dict[str, Any],
        report: Callable[[TrainingProgress], None] | None = None,
        score: Callable[[Network], float] | None = None,
    ) -> None:
        self.network = network
        self.average: Network = copy.deepcopy(network).eval()
        self.optimizer = torch.optim.AdamW(groups, lr=how.rate)
        self.how, self.checkpoint, self.settings, self.report, self.score = how, checkpoint, settings, report, score
        self.done = 0
        found = stored(checkpoint, load_checkpoint)
        if found is not None:
            self.done = restore_checkpoint(found, network, self.average, self.optimizer, settings)
        network.train()

    def run(
        self,
        batches: Iterable[Any],
        losses: Callable[[Any], Mapping[str, Any]],
        *,
        objective: str = "total",
        clip: float = float("inf"),
        until: int | None = None,
    ) -> Network:
        """Make one step for each batch, from the step after the last one.

        Args:
            until: Step after which to end with a checkpoint; None for the last.

        Returns:
            The averaged network, in evaluation mode.
        """
        end = self.how.steps if until is None else until
        if self.done >= end:
            return self.average
        sums: dict[str, float] = {}
        begin = self.done
        for batch in batches:
            found = losses(batch)
            self._update(found[objective], clip)
            for name, value in found.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach())
            if self.done % self.how.save_every == 0 or self.done >= end:
                self._save({name: value / (self.done - begin) for name, value in sums.items()})
                sums, begin = {}, self.done
            if self.done >= end:
                break
        return self.average

    def _update(self, loss: Any, clip: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self.how.rate_at(self.done) * group.get("share", 1.0)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        if clip < float("inf"):
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), clip)
        self.optimizer.step()
        self.done += 1
        follow(self.average, self.network, min(self.how.average, self.done / (self.done + 9)))

    def _save(self, means: dict[str, float]) -> None:
        save_checkpoint(self.checkpoint, self.network, self.average, self.optimizer, self.done, self.settings)
        if self.report is not None:
            score = None if self.score is None else self.score(self.average)
            self.report(TrainingProgress(self.done, self.how.steps, means, score))
