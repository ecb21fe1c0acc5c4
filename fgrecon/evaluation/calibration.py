"""How far what results say of themselves can be trusted, from scored boxes: regions, facing, status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fgrecon.core.coverage import LEVELS, Coverage, Region, coverage
from fgrecon.core.plain import finite
from fgrecon.core.reliability import Reliability, reliability
from fgrecon.evaluation.video_images import DIMENSIONS, TURNED_ROUND, VideoBox

__all__ = ["WRONG", "Calibration", "StatusCount", "calibrate_boxes", "calibration_document"]

FORMAT = "fgrecon.calibration/1"
WRONG = (15.0, 0.2)
"""A result is wrong beyond so many degrees of yaw, or parts of the distance."""


@dataclass(frozen=True)
class StatusCount:
    """Results of one status.

    Attributes:
        status: The status.
        count: Number of results.
        turned: Of these turned round, by more than 90 degrees.
        wrong: Of these wrong (`WRONG`), turned ones included.
    """

    status: str
    count: int
    turned: int
    wrong: int


@dataclass(frozen=True)
class Calibration:
    """What results of one method say, beside what is so.

    Attributes:
        regions: Of each quantity; vehicles turned round are left out, which the facing's probability is about.
        facing: Of the facing's probability; without a bin where there is none.
        statuses: In the order in which they come.
    """

    regions: tuple[Coverage, ...]
    facing: Reliability
    statuses: tuple[StatusCount, ...]


def calibrate_boxes(boxes: Sequence[VideoBox], method: str) -> Calibration:
    """Compare what a method says of its results with the labels; drives are left out of their own baselines."""
    regions: list[Region] = []
    sure: list[float] = []
    right: list[bool] = []
    counts: dict[str, list[tuple[bool, bool]]] = {}
    for box in boxes:
        found = box.outcomes[method]
        if found.status is None:
            continue
        turned = found.degrees > TURNED_ROUND
        off = found.degrees > WRONG[0] or found.metres > WRONG[1] * box.distance
        counts.setdefault(found.status, []).append((turned, off))
        if found.facing is not None:
            sure.append(found.facing)
            right.append(not turned)
        errors = {"position": found.metres, "yaw": found.degrees}
        for name, error in errors.items():
            if name in found.squared:
                squared, spread = found.squared[name], found.spread[name]
                regions.append(Region(box.drive, name, squared, DIMENSIONS[name], spread, error))
    statuses = [
        StatusCount(status, len(some), sum(turned for turned, _ in some), sum(off for _, off in some))
        for status, some in sorted(counts.items())
    ]
    return Calibration(tuple(coverage(regions)), reliability(sure, right), tuple(statuses))


def calibration_document(found: Calibration, given: dict[str, Any]) -> dict[str, Any]:
    """Plain values for JSON; what is not known is None."""
    return {
        "format": FORMAT,
        **given,
        "regions": [
            {
                "quantity": one.quantity,
                "count": one.count,
                "levels": LEVELS.tolist(),
                "claimed": one.claimed.tolist(),
                "inside": {f"{level:g}": finite(some) for level, some in one.inside.items()},
                "width": {f"{level:g}": finite(some) for level, some in one.width.items()},
            }
            for one in found.regions
        ],
        "facing": {
            "error": found.facing.error,
            "confidence": found.facing.confidence.tolist(),
            "right": found.facing.right.tolist(),
            "count": found.facing.count.tolist(),
        },
        "statuses": [
            {"status": one.status, "count": one.count, "turned_round": one.turned, "wrong": one.wrong}
            for one in found.statuses
        ],
    }
