"""What `fgrecon keypoints` prints, and the work of its `train`. Imported when it runs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from fgrecon.cli.common import console
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.weights import Stored, load_weights, mean_state, save_weights
from fgrecon.training.keypoints.evaluate import (
    GROUPS,
    Localisation,
    Scored,
    adjusted,
    azimuth_errors,
    localisation,
    marks_reliability,
)

__all__ = ["after_adjustment", "end_to_end", "marks_document", "print_marks", "run_training"]

_SIZES = (0.0, 60.0, 120.0)  # pixels of the box's longer side from which street cars are counted


def print_marks(out: Console, scored: Sequence[Scored], names: Sequence[str]) -> None:
    """Tables of the shares of visible keypoints that are found, by group, by size, by keypoint, and by confidence."""
    table = _table("group", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    for name, groups in GROUPS.items():
        _row(table, name, localisation(scored, groups))
    _row(table, "hard alone", localisation(scored, ("hard",)))
    for least in _SIZES[1:]:
        _row(table, f"street, from {least:.0f} px", localisation(scored, GROUPS["hard"], least=least))
    out.print(table)
    by_keypoint = _table("keypoint", "photographs 0.1", "0.05", "street 0.1", "0.05")
    photographs, street = localisation(scored, GROUPS["photographs"]), localisation(scored, GROUPS["hard"])
    for keypoint, name in enumerate(names):
        shares = [*photographs.keypoints[keypoint], *street.keypoints[keypoint]]
        by_keypoint.add_row(name, *("" if np.isnan(share) else f"{100 * share:.0f}" for share in shares))
    out.print(by_keypoint)
    found = marks_reliability(scored)
    by_confidence = _table("confidence", "right", "points")
    for sure, right, count in zip(found.confidence, found.right, found.count, strict=True):
        by_confidence.add_row(f"{sure:.2f}", f"{right:.2f}", str(count))
    out.print(by_confidence)
    out.print(f"Expected calibration error: {found.error:.3f}")


def marks_document(scored: Sequence[Scored], names: Sequence[str]) -> dict[str, Any]:
    """The same numbers as plain values."""

    def plain(result: Localisation) -> dict[str, Any]:
        shares = {
            name: [None if np.isnan(share) else float(share) for share in row]
            for name, row in zip(names, result.keypoints, strict=False)
        }
        return {
            "cars": result.cars,
            "points": result.points,
            "pck_0.1": result.within_tenth,
            "pck_0.05": result.within_twentieth,
            "median": result.median,
            "keypoints": shares,
        }

    found = marks_reliability(scored)
    return {
        "marks": {name: plain(localisation(scored, groups)) for name, groups in GROUPS.items()},
        "reliability": {
            "confidence": found.confidence.tolist(),
            "right": found.right.tolist(),
            "count": found.count.tolist(),
            "expected_calibration_error": found.error,
        },
    }


def after_adjustment(out: Console, scored: Sequence[Scored], data: Path) -> dict[str, Any]:
    """Marks again after pose and shape adjustment; street cars with KITTI's ground, fleet and boxes."""
    from fgrecon.paper.network import adjust_marked

    found = adjust_marked(scored, data)
    after = adjusted(scored, [None if result is None else result.wireframe_uv for result in found])
    table = _table("after adjustment", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    results = {name: localisation(after, groups) for name, groups in GROUPS.items()}
    for name, result in results.items():
        _row(table, name, result)
    out.print(table)
    return {
        name: {"pck_0.1": result.within_tenth, "pck_0.05": result.within_twentieth} for name, result in results.items()
    }


def end_to_end(out: Console, detector: KeypointCascade, data: Path, count: int, seed: int) -> dict[str, Any]:
    """Directions of validation photographs after pose and shape adjustment, intrinsics given."""
    from fgrecon.core.options import Options
    from fgrecon.io.catalogue import load_prior
    from fgrecon.perception.from_image import reconstruct_detection
    from fgrecon.training.keypoints.posed_cars import read_posed_cars, read_validation_ids

    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    cars = [car for car in read_posed_cars(data / "posed_cars") if car.cad_id in apart]
    chosen = np.sort(np.random.default_rng(seed).choice(len(cars), min(count, len(cars)), replace=False))
    prior, options = load_prior("car14"), Options(keep_history=False)
    score = azimuth_errors(
        detector,
        [cars[i] for i in chosen],
        lambda detection, camera: reconstruct_detection(detection, camera, options=options, prior=prior),
    )
    numbers = {"photographs": len(chosen), "median_degrees": score.median}
    numbers |= {f"within_{degrees}": score.within(degrees) for degrees in (5, 15, 30)}
    out.print(
        f"End to end on {len(chosen)} validation photographs: median {score.median:.1f}°, "
        f"within 5/15/30°: {100 * score.within(5):.1f}/{100 * score.within(15):.1f}/{100 * score.within(30):.1f} %"
    )
    return numbers


def run_training(
    data: Path,
    work: Path,
    out: Path,
    *,
    imagenet: Path | None,
    start: Path | None,
    start_share: float,
    silhouettes: Path | None,
    marks: Path | None,
    steps: int,
    batch: int,
    relabel_at: Sequence[int],
    refine_steps: int,
    seed: int,
    device: str,
    workers: int,
) -> None:
    """The work of `fgrecon keypoints train`."""
    import torch
    from rich.progress import track

    from fgrecon.perception.keypoints.decode import ConfidenceCalibration
    from fgrecon.training.keypoints.calibrate import calibrate
    from fgrecon.training.keypoints.dataset import azimuth_weights
    from fgrecon.training.keypoints.labelling import read_source
    from fgrecon.training.keypoints.rounds import train_in_rounds
    from fgrecon.training.keypoints.train import Training
    from fgrecon.training.keypoints.train_refine import RefineTraining, train_refinement
    from fgrecon.training.keypoints.trainer import TrainingProgress

    shown = console(error=True)
    reported: list[tuple[int, float]] = []  # step and time of the last report

    def report(progress: TrainingProgress) -> None:
        text = ", ".join(f"{name} {value:.3f}" for name, value in progress.losses.items())
        if progress.score is not None:
            text += f"; held out PCK 0.1 {100 * progress.score:.1f} %"
        step, now = progress.step, time.monotonic()
        if reported:
            rate = (step - reported[0][0]) / (now - reported[0][1])
            text += f"; {rate:.2f} steps/s, {(progress.steps - step) / rate / 60:.0f} min left"
        reported[:] = [(step, now)]
        shown.print(f"step {step} of {progress.steps}: {text}", markup=False, soft_wrap=True)

    def log(line: str) -> None:
        reported.clear()  # what comes between is not the training's rate
        shown.print(line)

    def progress(things: Sequence[Any], heading: str) -> Iterable[Any]:
        return track(things, heading, console=shown)

    source = read_source(data, marks)
    pretrained = None if imagenet is None else torch.load(imagenet, map_location="cpu", weights_only=True)
    how = Training(steps=steps, batch=batch, seed=seed, workers=workers)
    network, labelling, photographs = train_in_rounds(
        source,
        work,
        how,
        relabel_at,
        imagenet=pretrained,
        start=start,
        silhouettes=silhouettes,
        device=device,
        report=report,
        log=log,
        progress=progress,
    )
    partner = source.prior.category.mirror
    begun = None if start is None else load_weights(start)
    provenance = {
        "data": f"{len(source.learn)} photographs of posed cars; shapes from 79 car models"
        + (f"; {int(labelling.outlined.sum())} silhouettes" if silhouettes else "")
        + (f"; {source.marked} keypoints marked by hand" if marks else ""),
        "start": _began(imagenet, start, begun, start_share),
        "training": f"{steps} steps of {batch}, labels corrected at {list(relabel_at)}, seed {seed}",
    }
    state = network.state_dict() if begun is None else mean_state(begun.state, network.state_dict(), start_share)
    stored = Stored(state, how.network.to_dict(), ConfidenceCalibration(), provenance)
    if refine_steps:
        log("Refinement networks")
        chosen = labelling.samples(photographs, source.learn)
        refining = RefineTraining(steps=refine_steps, seed=seed)
        refining = replace(refining, street=refining.street.moving(source.prior.category))
        weights = azimuth_weights(photographs.azimuth, chosen)
        refinement = train_refinement(
            photographs,
            chosen,
            weights,
            partner,
            work / "refine.pt",
            refining,
            start=None if begun is None else begun.refinement,
            device=device,
            report=report,
        )
        refined = refinement.state_dict()
        if begun is not None and begun.refinement is not None:
            refined = mean_state(begun.refinement, refined, start_share)
        stored = replace(stored, refinement=refined, refine_settings=refining.network.to_dict())
    save_weights(out, stored)
    log("Calibration")
    held = labelling.samples(photographs, source.validate)
    fitted = calibrate(KeypointCascade(out, device=device), photographs, held, partner, seed=seed + 1)
    save_weights(out, replace(stored, calibration=fitted))


def _began(imagenet: Path | None, start: Path | None, begun: Stored | None, share: float) -> str:
    """What a training began with, in words."""
    if start is not None and begun is not None:
        origin = begun.provenance.get("start", "unknown")
        return f"{start.name} (of which {share:g} is left in the weights), itself from: {origin}"
    return "random weights" if imagenet is None else "EfficientNet-lite0, ImageNet"


def _table(*headings: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    return table


def _row(table: Table, name: str, result: Localisation) -> None:
    shares = (result.within_tenth, result.within_twentieth, result.median)
    cells = ["" if np.isnan(share) else f"{100 * share:.1f}" for share in shares]
    table.add_row(name, str(result.cars), str(result.points), *cells)
