"""What `fgrecon keypoints` prints. Imported when it runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from fgrecon.cli.terminal import Advance, Screen, stepwise
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.perception.from_image import reconstruct_detection
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon_research.paper.network import adjust_marked
from fgrecon_research.training.keypoints.evaluate import (
    GROUPS,
    Localisation,
    Scored,
    adjusted,
    azimuth_errors,
    localisation,
    marks_reliability,
)
from fgrecon_research.training.keypoints.posed_cars import read_posed_cars, read_validation_ids
from fgrecon_research.training.keypoints.trainer import TrainingProgress

_SIZES = (0.0, 60.0, 120.0)  # pixels of the box's longer side from which street cars are counted


def print_marks(screen: Screen, scored: Sequence[Scored], names: Sequence[str]) -> None:
    """Tables of the shares of visible keypoints that are found, by group, by size, by keypoint, and by confidence."""
    table = _table("group", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    for name, groups in GROUPS.items():
        _row(table, name, localisation(scored, groups))
    _row(table, "hard alone", localisation(scored, ("hard",)))
    for least in _SIZES[1:]:
        _row(table, f"street, from {least:.0f} px", localisation(scored, GROUPS["hard"], least=least))
    screen.print(table)
    for name, groups in (("photographs", GROUPS["photographs"]), ("street", GROUPS["hard"])):
        result = localisation(scored, groups)
        by_keypoint = _table(f"{name}, by keypoint", "points", "PCK 0.1", "PCK 0.05", "APK 0.1", "APK 0.05")
        for keypoint, point in enumerate(names):
            shares = [*result.keypoints[keypoint], *result.precisions[keypoint]]
            by_keypoint.add_row(point, *_shares(int(result.counts[keypoint]), shares))
        mean = result.precisions[result.counts > 0].mean(axis=0)
        by_keypoint.add_row(
            "all, mean APK", *_shares(result.points, [result.within_tenth, result.within_twentieth, *mean])
        )
        screen.print(by_keypoint)
    found = marks_reliability(scored)
    by_confidence = _table("confidence", "right", "points")
    for sure, right, count in zip(found.confidence, found.right, found.count, strict=True):
        by_confidence.add_row(f"{sure:.2f}", f"{right:.2f}", str(count))
    screen.print(by_confidence)
    screen.print(f"Expected calibration error: {found.error:.3f}")


def marks_document(scored: Sequence[Scored], names: Sequence[str]) -> dict[str, Any]:
    """The same numbers as plain values."""

    def by_name(rows: NDArray[np.float64]) -> dict[str, list[float | None]]:
        plain_rows = [[None if np.isnan(share) else float(share) for share in row] for row in rows]
        return dict(zip(names, plain_rows, strict=False))

    def plain(result: Localisation) -> dict[str, Any]:
        return {
            "cars": result.cars,
            "points": result.points,
            "pck_0.1": result.within_tenth,
            "pck_0.05": result.within_twentieth,
            "median": result.median,
            "keypoints": by_name(result.keypoints),
            "keypoints_apk": by_name(result.precisions),
            "keypoints_points": dict(zip(names, result.counts.tolist(), strict=False)),
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


def after_adjustment(screen: Screen, scored: Sequence[Scored], data: Path) -> dict[str, Any]:
    """Marks again after pose and shape adjustment; street cars with KITTI's ground, fleet and boxes."""
    found = adjust_marked(scored, data, progress=screen.watch)
    after = adjusted(scored, [None if result is None else result.pose.wireframe_uv for result in found])
    table = _table("after adjustment", "cars", "points", "PCK 0.1", "PCK 0.05", "median %")
    results = {name: localisation(after, groups) for name, groups in GROUPS.items()}
    for name, result in results.items():
        _row(table, name, result)
    screen.print(table)
    return {
        name: {"pck_0.1": result.within_tenth, "pck_0.05": result.within_twentieth} for name, result in results.items()
    }


def end_to_end(screen: Screen, detector: KeypointCascade, data: Path, count: int, seed: int) -> dict[str, Any]:
    """Directions of validation photographs after pose and shape adjustment, intrinsics given."""
    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    cars = [car for car in read_posed_cars(data / "posed_cars") if car.cad_id in apart]
    chosen = np.sort(np.random.default_rng(seed).choice(len(cars), min(count, len(cars)), replace=False))
    prior, options = load_prior("car14"), Options(keep_history=False)
    score = azimuth_errors(
        detector,
        [cars[i] for i in chosen],
        lambda detection, camera: reconstruct_detection(detection, camera, options=options, prior=prior),
        screen.watch,
    )
    numbers = {"photographs": len(chosen), "median_degrees": score.median}
    numbers |= {f"within_{degrees}": score.within(degrees) for degrees in (5, 15, 30)}
    screen.print(
        f"End to end on {len(chosen)} validation photographs: median {score.median:.1f}°, "
        f"within 5/15/30°: {100 * score.within(5):.1f}/{100 * score.within(15):.1f}/{100 * score.within(30):.1f} %"
    )
    return numbers


class TrainingDisplay:
    """Shows a training: a bar, or a line for each report."""

    def __init__(self, screen: Screen, advance: Advance) -> None:
        """Nothing is shown yet.

        Args:
            screen: Where lines go.
        """
        self._screen, self._advance, self._heading = screen, advance, "Training"

    def log(self, line: str) -> None:
        """What begins."""
        self._heading = line
        self._screen.note(line)

    def report(self, progress: TrainingProgress) -> None:
        """How far it is, and how good."""
        text = ", ".join(f"{name} {value:.3f}" for name, value in progress.losses.items())
        if progress.score is not None:
            text += f"; held out PCK 0.1 {100 * progress.score:.1f} %"
        self._advance(self._heading, progress.step, progress.steps, text)
        if self._screen.verbose or not self._screen.bars:
            self._screen.note(f"step {progress.step} of {progress.steps}: {text}")

    def progress(self, things: Sequence[Any], heading: str) -> Iterable[Any]:
        """Go through some things and show how far that has come."""
        return stepwise(things, heading, self._advance)


def _table(*headings: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="right" if number else "left")
    return table


def _shares(count: int, shares: Sequence[float]) -> list[str]:
    return [str(count), *("" if np.isnan(share) else f"{100 * share:.0f}" for share in shares)]


def _row(table: Table, name: str, result: Localisation) -> None:
    shares = (result.within_tenth, result.within_twentieth, result.median)
    cells = ["" if np.isnan(share) else f"{100 * share:.1f}" for share in shares]
    table.add_row(name, str(result.cars), str(result.points), *cells)
