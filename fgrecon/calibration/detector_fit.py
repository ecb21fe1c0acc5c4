"""A detector's calibration by fit: correlation of its keypoints' errors, and the weight of its directions.

Both from vehicles whose boxes are labelled, found by the detector and reconstructed. Drives are left out in turn to
tell how well what was fitted holds elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import FLIPPED_DEGREES, SYSTEM, VideoBox, box_coverage, wanted
from fgrecon.calibration.labelled_frames import SETTINGS
from fgrecon.core.arrays import Array
from fgrecon.core.coverage import SIGMAS, reliability
from fgrecon.core.detection import calibrated_facing
from fgrecon.core.detector_calibration import DetectorCalibration
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import KeypointOptions
from fgrecon.io.kitti_files import Drive

FACTORS = SETTINGS.common_factors
"""The common factors that vehicles are reconstructed with; what is fitted lies between them."""

_QUANTITIES = "position", "yaw"


def as_stated(factor: float) -> KeypointOptions:
    """Settings to reconstruct with for a fit: a facing is as probable as directions and neighbours say."""
    return KeypointOptions(common_factor=factor, facing_bias=0.0, facing_slope=1.0)


@dataclass(frozen=True)
class FittedDetector:
    """What was fitted, and how well it holds on drives that were left out."""

    calibration: DetectorCalibration  # what was fitted to all drives
    # share of the errors of position and yaw within their regions, by level (`SIGMAS`): fitted without the drive. NaN
    # with a single drive.
    inside: Mapping[str, Mapping[float, float]]
    facing_error: float  # expected calibration error of the facing, likewise
    # sentences that say what could not be fitted, lies at an end of what was tried, or does not hold, or is not known
    # to hold, on drives that were left out; in the calibration's provenance as well
    warnings: tuple[str, ...]
    flipped: int  # number of vehicles whose heading is flipped; too few leave the facing's numbers at the default ones


def check_labels(drives: Sequence[Drive]) -> None:
    """Refuse drives that cannot do before anything is looked at."""
    _check_count(sum(len(wanted(frame)) for drive in drives for frame in drive.frames), "labelled vehicles")


def check_solved(boxes: Sequence[VideoBox]) -> None:
    """Refuse what cannot do as soon as it was reconstructed with one factor."""
    _check_count(_solved(boxes), "vehicles")


def _check_count(count: int, what: str) -> None:
    if count < SETTINGS.fewest_vehicles:
        fix = f"Give drives with at least {SETTINGS.fewest_vehicles} labelled vehicles that can be reconstructed."
        raise InvalidInputError("drives", f"{count} {what}", fix)


def fit_detector(scored: Mapping[float, Sequence[VideoBox]], provenance: Mapping[str, Any]) -> FittedDetector:
    """Fit a detector's calibration.

    Args:
        scored: The same boxes reconstructed with each of `FACTORS`, and with directions as they are (`as_stated`).
        provenance: What is known of the data; plain values.

    Raises:
        InvalidInputError: Too few vehicles were reconstructed.
    """
    boxes = scored[FACTORS[0]]
    check_solved(boxes)
    curves = _curves(scored)
    if not curves:
        fix = "Give drives whose vehicles are seldom flipped: those are not judged."
        raise InvalidInputError("drives", f"{_solved(boxes)} vehicles without regions", fix)
    factor, facing, flipped = _factor(curves), _facing(boxes), sum(_is_flipped(box) for box in boxes)
    inside, error = _holding_elsewhere(scored)
    warnings = (*_end_of_factors(factor, curves), *_facing_warnings(facing, flipped), *_not_holding(inside))
    shares = {name: {f"{p:g}": share for p, share in some.items() if share >= 0.0} for name, some in inside.items()}
    about = {"vehicles": _solved(boxes), "flipped": flipped, "inside": shares, "warnings": list(warnings)}
    calibration = DetectorCalibration(factor, *facing, {**provenance, **about})
    return FittedDetector(calibration, inside, error, warnings, flipped)


def _holding_elsewhere(
    scored: Mapping[float, Sequence[VideoBox]],
) -> tuple[dict[str, dict[float, float]], float]:
    """Each drive by what is fitted without it: `inside` and `facing_error` of `FittedDetector`."""
    inside: dict[str, dict[float, float]] = {name: dict.fromkeys(SIGMAS, float("nan")) for name in _QUANTITIES}
    drives = sorted({box.drive for box in scored[FACTORS[0]]})
    if len(drives) < 2:
        return inside, float("nan")
    judged, stated, right = [], [], []
    for drive in drives:
        others = {f: [box for box in some if box.drive != drive] for f, some in scored.items()}
        own = {f: [box for box in some if box.drive == drive] for f, some in scored.items()}
        curves, without = _curves(own), _curves(others)
        if curves and without:  # a drive that alone has vehicles, or has none, cannot be judged
            judged.append((_solved(own[FACTORS[0]]), curves, _factor(without)))
        probability, hit = _chosen(own[FACTORS[0]])
        facing = _facing(others[FACTORS[0]])
        stated += [calibrated_facing(p, *facing) for p in probability.tolist()]
        right += hit.tolist()
    if judged:
        counts = [count for count, _, _ in judged]
        for name in _QUANTITIES:
            for level in SIGMAS:
                held = [_at(curves[name, level], best) for _, curves, best in judged]
                inside[name][level] = float(np.average(held, weights=counts))
    return inside, reliability(stated, right).error if stated else float("nan")


def _solved(boxes: Sequence[VideoBox]) -> int:
    return sum(bool(box.outcomes[SYSTEM].squared) for box in boxes)


def _end_of_factors(factor: float, curves: Mapping[tuple[str, float], Array]) -> list[str]:
    """That the factor is the first or last one that was tried, and how well regions hold with it."""
    ends = {FACTORS[0]: "smallest", FACTORS[-1]: "largest"}
    found = []
    for end, word in ends.items():
        if math.isclose(factor, end):
            there = _shares({name: {p: _at(curves[name, p], end) for p in SIGMAS} for name in _QUANTITIES})
            found.append(f"common_factor {end:g} is the {word} that was tried; with it {there} of the same drives.")
    return found


def _facing_warnings(facing: tuple[float, float], flipped: int) -> list[str]:
    default = DetectorCalibration()
    if facing == (default.facing_bias, default.facing_slope):
        few = "too few vehicles are" if flipped else "no vehicle is"
        return [f"The facing's numbers are the default ones: {few} flipped."]
    return [
        f"{name} {value:.3g} is at an end of what was tried ({low:g} to {high:g})."
        for name, (low, high), value in zip(
            ("facing_bias", "facing_slope"), SETTINGS.facing_bounds, facing, strict=True
        )
        if math.isclose(value, low, abs_tol=1e-6) or math.isclose(value, high)
    ]


def _not_holding(inside: Mapping[str, Mapping[float, float]]) -> list[str]:
    short = np.array([level - share for some in inside.values() for level, share in some.items()])
    if np.isnan(short).all():
        return ["How well common_factor holds elsewhere is not known: no drive can be left out of the fit."]
    if not (short > SETTINGS.tolerated_shortfall).any():
        return []
    return [f"common_factor does not hold on drives left out of the fit: {_shares(inside)} there."]


def _shares(inside: Mapping[str, Mapping[float, float]]) -> str:
    """Percent of the errors within their regions, in words."""
    levels = " and ".join(f"{100 * level:.0f}" for level in SIGMAS)
    held = (f"{' and '.join(f'{100 * some[p]:.0f}' for p in SIGMAS)} % of the {name}s" for name, some in inside.items())
    return f"regions of {levels} % hold {', '.join(held)}"


def _is_flipped(box: VideoBox) -> bool:
    found = box.outcomes[SYSTEM]
    return found.status is not None and found.degrees > FLIPPED_DEGREES


def _curves(scored: Mapping[float, Sequence[VideoBox]]) -> dict[tuple[str, float], Array]:
    """(F,) share inside each region at each of `FACTORS`; none where not every factor has a vehicle to judge."""
    curves: dict[tuple[str, float], list[float]] = {(name, level): [] for name in _QUANTITIES for level in SIGMAS}
    for factor in FACTORS:
        for one in box_coverage(scored[factor]):
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
    """Probability of the facing of each result that has one, and whether it is right."""
    faced = [box for box in boxes if box.outcomes[SYSTEM].facing is not None]
    stated = np.array([box.outcomes[SYSTEM].facing for box in faced], dtype=np.float64)
    return stated, np.array([not _is_flipped(box) for box in faced], dtype=bool)


def _facing(boxes: Sequence[VideoBox]) -> tuple[float, float]:
    """Bias and slope of the log odds by maximum likelihood; the default ones where too few tell."""
    from scipy.optimize import minimize

    probability, right = _chosen(boxes)
    default = DetectorCalibration()
    start = np.array([default.facing_bias, default.facing_slope])
    if np.count_nonzero(~right) < SETTINGS.fewest_flipped or not right.any():
        return default.facing_bias, default.facing_slope
    p = np.clip(probability, 1e-6, 1.0 - 1e-6)
    odds, sign = np.log(p / (1.0 - p)), np.where(right, 1.0, -1.0)

    def surprise(numbers: Array) -> float:
        return float(np.mean(np.logaddexp(0.0, -sign * (numbers[0] + numbers[1] * odds))))

    found = minimize(surprise, start, method="L-BFGS-B", bounds=SETTINGS.facing_bounds)
    return float(found.x[0]), float(found.x[1])
