"""The whole training in rounds: labels from boxes, training, labels corrected by the network, training on.

Everything lives in folders, so that an interrupted run goes on where it was. What trainings of the same photographs,
marks and silhouettes have in common is in one of their own: `photographs/` (prepared images), `labels-first.npz` (of
boxes and silhouettes), and `labels-by-HASH.npz` (corrected by the network that a training begins with). The training's
has `labels-0.npz`, `labels-1.npz`, ... (one per round) and `knet.pt` (the checkpoint).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import stored
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.network_file import Stored, save_weights
from fgrecon_research.training.keypoints.began import begin_alike, file_hash, files_hash, source_hash, state_hash
from fgrecon_research.training.keypoints.dataset import Photographs
from fgrecon_research.training.keypoints.labelling import (
    Labelling,
    Source,
    corrected,
    first_labelling,
    open_photographs,
)
from fgrecon_research.training.keypoints.street_cars import StreetShare, learning
from fgrecon_research.training.keypoints.train import HeldOut, Training, first_network, train_knet
from fgrecon_research.training.keypoints.trainer import Display, load_checkpoint, load_tensors


@dataclass(frozen=True)
class Beginning:
    """What a training begins with."""

    imagenet: Path | None = None  # weights of the encoder (torch), or None for random ones
    start: Path | None = None  # a trained network to go on from instead, which corrects the first labels as well
    start_share: float = 0.5  # share of that network in the resulting weights, 0 to 1
    silhouettes: Path | None = None  # folder of silhouettes for the first labels, or None
    marks: Path | None = None  # keypoints marked by hand in photographs that are learnt from (JSON), or None
    # street cars that are learnt from beside the photographs (COCO, of `fgrecon keypoints label`), or None
    street: Path | None = None
    street_share: float = 0.5  # their share of the samples, 0 to 1
    without: tuple[str, ...] = ()  # drives of theirs that are left out


def train_in_rounds(
    source: Source,
    folder: Path,
    how: Training,
    relabel_at: Sequence[int],
    beginning: Beginning | None = None,
    *,
    street: StreetShare | None = None,
    display: Display | None = None,
    common: Path | None = None,
) -> tuple[Any, Labelling, Photographs]:
    """Train KNet, correcting the labels at given steps.

    Args:
        folder: Where everything is kept; goes on from what is there.
        relabel_at: Steps after which the labels are corrected, in rising order.
        beginning: Of it count `imagenet`, `start` and `silhouettes`; the others are in `source` and `street`.
        common: Where what depends on `source` and `beginning` alone is kept; None is `folder`.

    Returns:
        The averaged network, and the last labels with their photographs.

    Raises:
        InvalidInputError: There is no photograph to learn from, or the folder's training began otherwise.
    """
    beginning, display = beginning or Beginning(), display or Display()
    common = folder if common is None else common
    for needed in (folder, common):
        needed.mkdir(parents=True, exist_ok=True)
    checkpoint, partner = folder / "knet.pt", source.prior.category.mirror
    how = replace(how, street=how.street.shaping(source.prior))
    stops = [*(step for step in relabel_at if step < how.steps), how.steps]
    imagenet = None
    if beginning.imagenet is not None:
        imagenet = torch.load(beginning.imagenet, map_location="cpu", weights_only=True)
    begin_alike(folder / "began.json", _named(source, how, stops, imagenet, beginning, street))
    begun = None if beginning.start is None else load_tensors(beginning.start)
    rounds = _Rounds(source, folder, common, how.device, beginning, begun, display)
    first = rounds.first()
    stored(checkpoint, load_checkpoint)  # puts a damaged one aside: all steps are made again
    # Prepared by the first labels, whichever come after.
    photographs = rounds.photographs(first)
    for number, last in enumerate(stops):
        labelling = rounds.labelling(number, first, photographs)
        photographs = rounds.photographs(labelling)
        if checkpoint.exists() and load_checkpoint(checkpoint)["step"] >= last and number < len(stops) - 1:
            continue
        display.log(f"Training to step {last}")
        chosen = labelling.samples(photographs, source.learn)
        if not len(chosen):
            fix = "Start from another network, or from none: no photograph agrees with its shape."
            raise InvalidInputError("labels", str(rounds.path(number)), fix)
        held = labelling.samples(photographs, source.validate)
        network = train_knet(
            first_network(how, imagenet, None if begun is None else begun.state),
            *(learning(photographs, chosen, street), partner, checkpoint, how),
            report=display.report,
            until=last,
            held=None if not len(held) else HeldOut.draw(photographs, held, how.street, partner, how.seed),
        )
    return network, labelling, photographs


def _named(
    source: Source,
    how: Training,
    stops: Sequence[int],
    imagenet: dict[str, Any] | None,
    beginning: Beginning,
    street: StreetShare | None,
) -> dict[str, Any]:
    """What the labels and networks in the folder come from."""
    start, silhouettes = beginning.start, beginning.silhouettes
    return {
        "photographs": source_hash(source),
        "imagenet": None if imagenet is None else state_hash(imagenet),
        "start": None if start is None else file_hash(start),
        "silhouettes": None if silhouettes is None else files_hash(sorted(silhouettes.glob("*.png"))),
        "street_cars": None if street is None else street.describe(),
        "relabel_at": list(stops[:-1]),
        **how.lasting(),
    }


@dataclass(frozen=True, eq=False)
class _Rounds:
    """The labels of a training's rounds, from their files or made anew."""

    source: Source
    folder: Path  # of the training
    common: Path  # of what several trainings share
    device: str
    beginning: Beginning
    begun: Stored | None  # the network that it begins with
    display: Display

    def first(self) -> Labelling:
        """The labels of boxes and silhouettes."""
        path, silhouettes = self.common / "labels-first.npz", self.beginning.silhouettes
        labelling = Labelling.open(path, self.source.cars)
        if labelling is not None:
            return labelling
        self.display.log("Labels from the boxes" if silhouettes is None else "Labels from boxes and silhouettes")
        labelling = first_labelling(self.source, silhouettes, self.display.progress)
        labelling.save(path)
        if silhouettes is not None:
            self.display.log(f"{int(labelling.outlined.sum())} silhouettes agree with their cars")
        return labelling

    def path(self, number: int) -> Path:
        """The file of a round's labels."""
        start = self.beginning.start
        if number == 0 and start is not None:
            return self.common / f"labels-by-{file_hash(start)}.npz"
        return self.folder / f"labels-{number}.npz"

    def labelling(self, number: int, first: Labelling, photographs: Photographs) -> Labelling:
        """A round's labels: the first ones, or those corrected by the network of that time."""
        labelling = Labelling.open(self.path(number), self.source.cars)
        if labelling is not None:
            return labelling
        if number == 0 and self.beginning.start is None:
            labelling = first
        else:
            self.display.log(f"Labels corrected by the network, round {number}")
            labelling = corrected(
                *(self.source, first, self._detector(number), photographs),
                *(self.beginning.silhouettes, self.display.progress),
            )
        labelling.save(self.path(number))
        return labelling

    def photographs(self, labelling: Labelling) -> Photographs:
        """The photographs with some labels."""
        prepared = self.common / "photographs"
        return open_photographs(self.source, labelling, prepared, self.beginning.silhouettes, self.display.progress)

    def _detector(self, number: int) -> KeypointCascade:
        if number == 0:
            return KeypointCascade(self.beginning.start, device=self.device)
        return _as_detector(load_checkpoint(self.folder / "knet.pt"), self.begun, self.folder, self.device)


def _as_detector(content: dict[str, Any], begun: Stored | None, folder: Path, device: str) -> KeypointCascade:
    """The checkpoint's averaged network at work.

    Refinement networks and calibration are those that the training began with: patches around an estimate look the same
    whichever KNet made it. Without, there is no refinement, and confidences are as an untrained calibration has them.
    """
    path = folder / "round.safetensors"
    if begun is None:
        save_weights(path, Stored(content["average"], content["settings"], ConfidenceCalibration(), {}))
    else:
        save_weights(path, replace(begun, state=content["average"], settings=content["settings"]))
    return KeypointCascade(path, device=device)
