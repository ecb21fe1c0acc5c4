"""The whole system with other sensors' evidence, on labelled boxes that it has solved by the picture alone.

| method | what it gets beside the picture |
|---|---|
| `lidar` | the scan |
| `lidar/4`, `lidar/16` | every so-many-th point of it |
| `lidar_turned` | the scan half a degree off, about an axis chosen by chance for each frame |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome
from fgrecon.calibration.labelled_frames import LookedFrame, found_outcome
from fgrecon.core.evidence import Points
from fgrecon.core.geometry import exponential
from fgrecon.perception.from_image import reconstruct_detections
from fgrecon_research.io.drive_sensors import Sensor, lidar_points

Array = NDArray[np.float64]

LIDAR, TURNED = "lidar", "lidar_turned"
"""Names of methods."""

THINNED = 4, 16
"""Every so-many-th point is taken, beside all."""

_WRONG_EXTRINSICS = np.radians(0.5)


def score_sensed(looked: LookedFrame, sensors: Collection[Sensor]) -> list[Mapping[str, BoxOutcome]]:
    """The outcomes of each labelled box of a frame with what each sensor adds, by the methods' names."""
    scored: list[dict[str, BoxOutcome]] = [{} for _ in looked.looks]
    for name, evidence in _evidence(looked, sensors).items():
        for one, outcomes in zip(_solved(looked, evidence), scored, strict=True):
            outcomes[name] = one
    return list(scored)


def _evidence(looked: LookedFrame, sensors: Collection[Sensor]) -> dict[str, Points]:
    """What each method gets."""
    found: dict[str, Points] = {}
    if Sensor.LIDAR in sensors:
        place = looked.frame.calibration.camera_T_lidar
        origin = np.zeros(3) if place is None else place[:3, 3]
        scan = Points(lidar_points(looked.frame), origin=origin)
        found = {LIDAR: scan} | {f"{LIDAR}/{every}": scan.thinned(every) for every in THINNED}
        axis = np.random.default_rng(looked.frame.number).normal(size=3)
        turn = exponential(_WRONG_EXTRINSICS * axis / np.linalg.norm(axis))
        found[TURNED] = Points(scan.points @ turn.T, scan.sigma, origin)
    return found


def _solved(looked: LookedFrame, evidence: Points) -> list[BoxOutcome]:
    setup, labels = looked.setup, looked.frame.objects
    how: dict[str, Any] = {"ground": setup.ground, "size_prior": setup.size_prior, "together": setup.together}
    detections = [look.found.detection for look in looked.looks]
    found = reconstruct_detections(
        detections, looked.camera, prior=setup.prior, options=setup.options, evidence=(evidence,), **how
    )
    offset = looked.frame.calibration.label_offset
    return [
        found_outcome(one, looked.truth(look), labels.size[look.label], offset)
        for look, one in zip(looked.looks, found, strict=True)
    ]
