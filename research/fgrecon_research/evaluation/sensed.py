"""The whole system with other sensors' evidence, on labelled boxes that it has solved by the picture alone.

| method | what it gets beside the picture |
|---|---|
| `lidar` | the scan |
| `lidar/4`, `lidar/16` | every so-many-th point of it |
| `lidar_turned` | the scan half a degree off, about an axis chosen by chance for each frame |
| `stereo` | the right image |
| `depth` | a depth map of the scan's points, and of the right image's disparities elsewhere where there is one |
| `depth_affine` | the same map times a number, and plus one, which are chosen by chance for each frame |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import BoxOutcome
from fgrecon.calibration.labelled_frames import LookedFrame, found_outcome
from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.evidence import Evidence, Points
from fgrecon.core.geometry import exponential
from fgrecon.core.point_frames import in_image
from fgrecon.perception.from_image import reconstruct_detections
from fgrecon.perception.stereo import stereo_depth
from fgrecon_research.io.drive_sensors import Sensor, file_of, lidar_points, right_image

Array = NDArray[np.float64]

LIDAR, TURNED, STEREO, DEPTH, AFFINE = "lidar", "lidar_turned", "stereo", "depth", "depth_affine"
"""Names of methods."""

THINNED = 4, 16
"""Every so-many-th point is taken, beside all."""

_WRONG_EXTRINSICS = np.radians(0.5)
_SCALES, _SHIFTS = (0.3, 3.0), (-3.0, 3.0)  # of maps in other units: metres for one of theirs, and metres
_LIDAR_SIGMA = 0.05  # metres, of a pixel of a scan


def score_sensed(looked: LookedFrame, sensors: Collection[Sensor]) -> list[Mapping[str, BoxOutcome]]:
    """The outcomes of each labelled box of a frame with what each sensor adds, by the methods' names."""
    scored: list[dict[str, BoxOutcome]] = [{} for _ in looked.looks]
    for name, evidence in _evidence(looked, sensors).items():
        for one, outcomes in zip(_solved(looked, evidence), scored, strict=True):
            outcomes[name] = one
    return list(scored)


def _evidence(looked: LookedFrame, sensors: Collection[Sensor]) -> dict[str, Evidence]:
    """What each method gets."""
    found: dict[str, Evidence] = {}
    if Sensor.RIGHT in sensors:
        found[STEREO] = stereo_depth(looked.image, looked.camera, right_image(looked.frame))
    if Sensor.DEPTH in sensors:
        found |= _depths(looked)
    if Sensor.LIDAR in sensors:
        place = looked.frame.calibration.camera_T_lidar
        origin = np.zeros(3) if place is None else place[:3, 3]
        scan = Points(lidar_points(looked.frame), origin=origin)
        found |= {LIDAR: scan} | {f"{LIDAR}/{every}": scan.thinned(every) for every in THINNED}
        axis = np.random.default_rng(looked.frame.number).normal(size=3)
        turn = exponential(_WRONG_EXTRINSICS * axis / np.linalg.norm(axis))
        found[TURNED] = Points(scan.points @ turn.T, scan.sigma, origin)
    return found


def _depths(looked: LookedFrame) -> dict[str, DepthMap]:
    """A depth map in metres, and up to scale and shift."""
    height, width = looked.image.shape[:2]
    depth, sigma = np.full((height, width), np.nan), np.full((height, width), _LIDAR_SIGMA)
    if file_of(looked.frame, Sensor.RIGHT) is not None:
        matched = stereo_depth(looked.image, looked.camera, right_image(looked.frame))
        depth, sigma = matched.depth.copy(), np.nan_to_num(np.asarray(matched.sigma), nan=_LIDAR_SIGMA)
    points = lidar_points(looked.frame)
    points = points[in_image(points, looked.camera)]
    points = points[np.argsort(-points[:, 2])]  # what is nearer hides what is behind it
    column, row = np.clip(np.rint(looked.camera.project(points)), 0, [width - 1, height - 1]).astype(int).T
    depth[row, column], sigma[row, column] = points[:, 2], _LIDAR_SIGMA
    chance = np.random.default_rng(looked.frame.number)
    scale, shift = np.exp(chance.uniform(*np.log(_SCALES))), chance.uniform(*_SHIFTS)
    kind = DepthScale.SCALE_AND_SHIFT
    return {
        DEPTH: DepthMap(depth, sigma, relative_sigma=0.0),
        AFFINE: DepthMap((depth - shift) / scale, sigma / scale, relative_sigma=0.0, scale=kind),
    }


def _solved(looked: LookedFrame, evidence: Evidence) -> list[BoxOutcome]:
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
