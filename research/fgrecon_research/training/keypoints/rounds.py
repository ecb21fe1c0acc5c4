"""The whole training in rounds: labels from boxes, training, labels corrected by the network, training on.

Everything lives in folders, so that an interrupted run goes on where it was. What trainings of the same photographs,
marks and silhouettes have in common is in one of their own: `photographs/` (prepared images), `labels-first.npz` (of
boxes and silhouettes), and `labels-by-HASH.npz` (corrected by the network that a training begins with). The training's
has `labels-0.npz`, `labels-1.npz`, ... (one per round) and `knet.pt` (the checkpoint).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.integrity import stored
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
from fgrecon_research.training.keypoints.posed_cars import Progress, no_progress
from fgrecon_research.training.keypoints.street_cars import StreetShare, learning
from fgrecon_research.training.keypoints.train import HeldOut, Training, train_knet
from fgrecon_research.training.keypoints.trainer import TrainingProgress, load_checkpoint, load_tensors

Array = NDArray[np.float64]


def train_in_rounds(
    source: Source,
    folder: Path,
    how: Training,
    relabel_at: Sequence[int],
    *,
    imagenet: dict[str, Any] | None = None,
    start: Path | None = None,
    silhouettes: Path | None = None,
    device: str = "cpu",
    report: Callable[[TrainingProgress], None] | None = None,
    log: Callable[[str], None] = lambda _: None,
    progress: Progress = no_progress,
    street: StreetShare | None = None,
    common: Path | None = None,
) -> tuple[Any, Labelling, Photographs]:
    """Train KNet, correcting the labels at given steps.

    Args:
        folder: Where everything is kept; goes on from what is there.
        relabel_at: Steps after which the labels are corrected, in rising order.
        start: A trained network to go on from instead, which corrects the first labels as well.
        silhouettes: Folder of silhouettes for the first labels, as `first_labelling` reads them.
        common: Where what depends on `source`, `silhouettes` and `start` alone is kept; None is `folder`.

    Returns:
        The averaged network, and the last labels with their photographs.

    Raises:
        InvalidInputError: There is no step, no photograph to learn from, or the folder's training began otherwise.
    """
    common = folder if common is None else common
    for needed in (folder, common):
        needed.mkdir(parents=True, exist_ok=True)
    prepared = common / "photographs"
    by_start = None if start is None else common / f"labels-by-{file_hash(start)}.npz"
    checkpoint, partner = folder / "knet.pt", source.prior.category.mirror
    how = replace(how, street=how.street.shaping(source.prior))
    stops = [*(step for step in relabel_at if step < how.steps), how.steps]
    begin_alike(folder / "began.json", _named(source, how, stops, imagenet, start, silhouettes, street))
    first = _first(source, common / "labels-first.npz", silhouettes, log, progress)
    begun = None if start is None else load_tensors(start)
    stored(checkpoint, load_checkpoint)  # puts a damaged one aside: all steps are made again
    network: Any = None
    labelling: Labelling | None = None
    # Prepared by the first labels, whichever come after.
    photographs = open_photographs(source, first, prepared, silhouettes, progress)
    for number, last in enumerate(stops):
        path = by_start if number == 0 and by_start is not None else folder / f"labels-{number}.npz"
        labelling = Labelling.open(path, source.cars)
        if labelling is None and number == 0 and start is None:
            labelling = first
            labelling.save(path)
        elif labelling is None:
            log(f"Labels corrected by the network, round {number}")
            if number == 0:
                detector = KeypointCascade(start, device=device)
            else:
                detector = _as_detector(load_checkpoint(checkpoint), begun, folder, device)
            labelling = corrected(source, first, detector, photographs, silhouettes, progress)
            labelling.save(path)
        photographs = open_photographs(source, labelling, prepared, silhouettes, progress)
        if checkpoint.exists() and load_checkpoint(checkpoint)["step"] >= last and number < len(stops) - 1:
            continue
        log(f"Training to step {last}")
        chosen = labelling.samples(photographs, source.learn)
        if not len(chosen):
            fix = "Start from another network, or from none: no photograph agrees with its shape."
            raise InvalidInputError("labels", str(path), fix)
        held = labelling.samples(photographs, source.validate)
        network = train_knet(
            learning(photographs, chosen, street),
            partner,
            checkpoint,
            how,
            imagenet=imagenet,
            start=None if begun is None else dict(begun.state),
            device=device,
            report=report,
            until=last,
            held=None if not len(held) else HeldOut.draw(photographs, held, how.street, partner, how.seed),
        )
    if labelling is None:
        raise InvalidInputError("steps", how.steps, "Give at least one step.")
    return network, labelling, photographs


def _named(
    source: Source,
    how: Training,
    stops: Sequence[int],
    imagenet: dict[str, Any] | None,
    start: Path | None,
    silhouettes: Path | None,
    street: StreetShare | None,
) -> dict[str, Any]:
    """What the labels and networks in the folder come from."""
    # How many processes make the samples, and when checkpoints are written, changes no network.
    schedule = {name: value for name, value in asdict(how).items() if name not in ("workers", "save_every")}
    return {
        "photographs": source_hash(source),
        "imagenet": None if imagenet is None else state_hash(imagenet),
        "start": None if start is None else file_hash(start),
        "silhouettes": None if silhouettes is None else files_hash(sorted(silhouettes.glob("*.png"))),
        "street_cars": None if street is None else street.describe(),
        "relabel_at": list(stops[:-1]),
        **schedule,
    }


def _first(
    source: Source, path: Path, silhouettes: Path | None, log: Callable[[str], None], progress: Progress
) -> Labelling:
    """The first labels: those in the file, or made anew."""
    labelling = Labelling.open(path, source.cars)
    if labelling is not None:
        return labelling
    log("Labels from the boxes" if silhouettes is None else "Labels from boxes and silhouettes")
    labelling = first_labelling(source, silhouettes, progress)
    labelling.save(path)
    if silhouettes is not None:
        log(f"{int(labelling.outlined.sum())} silhouettes agree with their cars")
    return labelling


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
