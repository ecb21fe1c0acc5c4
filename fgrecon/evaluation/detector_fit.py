"""Fit to a detector what results say of themselves: how far its errors go together, and what its directions count.

Both from vehicles whose boxes are labelled, found by the detector and reconstructed. Drives are left out in turn to
tell how well what was fitted holds elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.coverage import SIGMAS
from fgrecon.core.detection import calibrated_facing
from fgrecon.core.detector_calibration import DetectorCalibration
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import KeypointOptions
from fgrecon.core.reliability import reliability
from fgrecon.evaluation.calibration import calibrate_boxes
from fgrecon.evaluation.video_images import SYSTEM, TURNED_ROUND, VideoBox

__all__ = ["FACTORS", "FittedDetector", "as_said", "fit_detector", "holding"]

FACTORS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""The common factors that vehicles are reconstructed with; what is fitted lies between them."""

_FEWEST = 30  # vehicles that regions are judged by
_FEWEST_TURNED = 5  # turned round, without which nothing tells what a direction counts
_QUANTITIES = "position", "yaw"

Array = NDArray[np.float64]


def as_said(factor: float) -> KeypointOptions:
    """Settings to reconstruct with for a fit: a facing is as probable as directions and neighbours say."""
    return KeypointOptions(common_factor=factor, facing_bias=0.0, facing_slope=1.0)


@dataclass(frozen=True)
class FittedDetector:
    """What was fitted, and how well it holds on drives that were left out.

    Attributes:
        calibration: What was fitted to all drives.
        inside: Share of the errors of position and yaw within their regions, by level (`SIGMAS`): fitted without the
            drive. NaN with a single drive.
        facing_error: Expected calibration error of the facing, likewise.
        turned: Number of vehicles turned round; where they are too few the facing's numbers are the default ones.
    """

    calibration: DetectorCalibration
    inside: Mapping[str, Mapping[float, float]]
    facing_error: float
    turned: int

    @property
    def facing_is_default(self) -> bool:
        """Whether too few vehicles were turned round to fit the facing's numbers."""
        found, default = self.calibration, DetectorCalibration()
        return (found.facing_bias, found.facing_slope) == (default.facing_bias, default.facing_slope)


def fit_detector(scored: Mapping[float, Sequence[VideoBox]], provenance: Mapping[str, Any]) -> FittedDetector:
    """Fit a detector's calibration.

    Args:
        scored: The same boxes reconstructed with each of `FACTORS`, and with directions as they are (`as_said`).
        provenance: What is told of the data; plain values.

    Raises:
        InvalidInputError: Too few vehicles were reconstructed.
    """
    boxes = scored[FACTORS[0]]
    drives = sorted({box.drive for box in boxes})
    solved = [box for box in boxes if box.outcomes[SYSTEM].squared]
    if len(solved) < _FEWEST:
        fix = f"Give drives with at least {_FEWEST} labelled vehicles that can be reconstructed."
        raise InvalidInputError("drives", f"{len(solved)} vehicles", fix)
    curves_of_all = _curves(scored)
    if not curves_of_all:
        fix = "Give drives whose vehicles are seldom turned round: those are not judged."
        raise InvalidInputError("drives", f"{len(solved)} vehicles without regions", fix)
    factor, facing, turned = _factor(curves_of_all), _facing(boxes), sum(_is_turned(box) for box in boxes)
    inside: dict[str, dict[float, float]] = {name: dict.fromkeys(SIGMAS, float("nan")) for name in _QUANTITIES}
    said: list[float] = []
    right: list[bool] = []
    if len(drives) > 1:
        parts = []
        for drive in drives:
            others = {f: [box for box in some if box.drive != drive] for f, some in scored.items()}
            own = {f: [box for box in some if box.drive == drive] for f, some in scored.items()}
            curves, without = _curves(own), _curves(others)
            if curves and without:  # of a drive that alone has vehicles, or has none, nothing is told
                count = sum(bool(box.outcomes[SYSTEM].squared) for box in own[FACTORS[0]])
                parts.append((count, curves, _factor(without)))
            probability, hit = _chosen(own[FACTORS[0]])
            said += [calibrated_facing(p, *_facing(others[FACTORS[0]])) for p in probability.tolist()]
            right += hit.tolist()
        for name in _QUANTITIES:
            for level in SIGMAS:
                held = [(count, _at(curves[name, level], best)) for count, curves, best in parts]
                if held:
                    inside[name][level] = float(np.average([share for _, share in held], weights=[n for n, _ in held]))
    error = reliability(said, right).error if said else float("nan")
    told = {**provenance, "vehicles": len(solved), "turned_round": turned}
    calibration = DetectorCalibration(factor, *facing, told)
    return FittedDetector(calibration, inside, error, turned)


def _is_turned(box: VideoBox) -> bool:
    found = box.outcomes[SYSTEM]
    return found.status is not None and found.degrees > TURNED_ROUND


def _curves(scored: Mapping[float, Sequence[VideoBox]]) -> dict[tuple[str, float], Array]:
    """(F,) share inside each region at each of `FACTORS`; none where not every factor has a vehicle to judge."""
    curves: dict[tuple[str, float], list[float]] = {(name, level): [] for name in _QUANTITIES for level in SIGMAS}
    for factor in FACTORS:
        for one in calibrate_boxes(scored[factor], SYSTEM).regions:
            if one.quantity in _QUANTITIES:
                for level in SIGMAS:
                    curves[one.quantity, level].append(one.inside[level]["claimed"])
    whole = all(len(shares) == len(FACTORS) for shares in curves.values())
    return {key: np.array(shares) for key, shares in curves.items()} if whole else {}


def _at(curve: Array, factor: float) -> float:
    return float(np.interp(np.log(factor), np.log(FACTORS), curve))


def _factor(curves: Mapping[tuple[str, float], Array]) -> float:
    """Where the regions hold as much as they claim, on the mean over quantities and levels."""
    return holding(FACTORS, list(curves.values()))


def holding(settings: Sequence[float], inside: Sequence[Array]) -> float:
    """The setting at which regions hold as much as they claim, on the mean over what is judged.

    Args:
        settings: F settings above zero, rising, with which regions grow.
        inside: Shares (F,) inside the regions at each of them; of each of `SIGMAS` as many.
    """
    mean = np.mean(inside, axis=0)
    rising = np.maximum.accumulate(mean) + 1e-9 * np.arange(len(mean))
    return float(np.exp(np.interp(np.mean(SIGMAS), rising, np.log(settings))))


def _chosen(boxes: Sequence[VideoBox]) -> tuple[Array, NDArray[np.bool_]]:
    """What the directions give the facing of each result that has one, and whether it is right."""
    faced = [box for box in boxes if box.outcomes[SYSTEM].facing is not None]
    said = np.array([box.outcomes[SYSTEM].facing for box in faced], dtype=np.float64)
    return said, np.array([not _is_turned(box) for box in faced], dtype=bool)


def _facing(boxes: Sequence[VideoBox]) -> tuple[float, float]:
    """Bias and slope of the log odds by maximum likelihood; the default ones where too few tell."""
    from scipy.optimize import minimize

    probability, right = _chosen(boxes)
    default = DetectorCalibration()
    start = np.array([default.facing_bias, default.facing_slope])
    if np.count_nonzero(~right) < _FEWEST_TURNED or not right.any():
        return default.facing_bias, default.facing_slope
    p = np.clip(probability, 1e-6, 1.0 - 1e-6)
    odds, sign = np.log(p / (1.0 - p)), np.where(right, 1.0, -1.0)

    def surprise(numbers: Array) -> float:
        return float(np.mean(np.logaddexp(0.0, -sign * (numbers[0] + numbers[1] * odds))))

    found = minimize(surprise, start, method="L-BFGS-B", bounds=[(-10.0, 10.0), (0.0, 10.0)])
    return float(found.x[0]), float(found.x[1])
