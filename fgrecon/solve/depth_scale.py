"""Initial scale and shift of a depth map that is given up to scale, or up to scale and shift.

The ground says so where it is given, and else the vehicles of the image, each at the pose that the picture alone leads
to. Both are crude: a vehicle's depth by a picture is off by some percent, and so is a plane by its pitch, as which what
rises from it passes as well. So scale and shift are those that most samples agree on, and how unsure they are by pitch,
roll and height of the plane goes on into the graph (`fgrecon.solve.graph.sensed_part`), whose vehicles, with all that
is known of them, decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from factors.surface_points import PointRows
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.choices import DepthScale
from fgrecon.core.depth_map import DepthCalibration, DepthMap, pixel_rays
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.proposals.point_term import patches_of
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search_settings import SETTINGS
from fgrecon.solve.solve_settings import DEPTH_SCALE

_STEP = 1e-6  # of numeric derivatives


@dataclass(frozen=True)
class _Samples:
    """Numbers of a map where something else says the depth."""

    number: Array  # (M,) of the map
    metres: Array  # (M,) depth
    sigma: Array  # (M,) standard deviation of its logarithm

    @classmethod
    def joined(cls, parts: Sequence[_Samples]) -> _Samples:
        """Those of all parts."""
        empty = np.zeros(0)
        return cls(*(np.concatenate([empty, *(getattr(p, n) for p in parts)]) for n in ("number", "metres", "sigma")))


def with_scales(observations: Sequence[Observation], camera: Camera, setup: SolveSetup) -> list[Observation]:
    """Observations of one image whose depth maps are about known in metres, without those of which nothing says so."""
    maps = {id(e): e for one in observations for e in one.evidence if isinstance(e, DepthMap) and e.known is None}
    if not maps:
        return list(observations)
    posed = [found for one in observations if (found := _pictured(one, camera, setup)) is not None]
    known = {key: _calibrated(one, posed, camera, setup) for key, one in maps.items()}
    each = [[known.get(id(e), e) for e in one.evidence] for one in observations]
    return [
        replace(one, evidence=tuple(e for e in some if e is not None))
        for one, some in zip(observations, each, strict=True)
    ]


def _pictured(observation: Observation, camera: Camera, setup: SolveSetup) -> tuple[Problem, PoseEstimate] | None:
    """Where a vehicle is by all but depth maps of unknown scale; None where that says nothing."""
    others = tuple(e for e in observation.evidence if not (isinstance(e, DepthMap) and e.known is None))
    try:
        model = setup.model_of([observation], [camera])
        problem = Problem.of(replace(observation, evidence=others), camera, model, setup.ground, setup.options)
        return problem, search_pose(problem)
    except FgreconError:  # its own solve says so
        return None


def _calibrated(
    depth: DepthMap, posed: Sequence[tuple[Problem, PoseEstimate]], camera: Camera, setup: SolveSetup
) -> DepthMap | None:
    """A map with the scale and shift that vehicles and ground speak for; None where nothing does."""
    vehicles = _Samples.joined([_on_vehicle(depth, *one, camera) for one in posed])
    ground = setup.ground
    usable = None if ground is None or ground.is_vague or "ground" in setup.options.disabled_terms else ground
    plane = None if usable is None else _on_ground(depth, usable, camera)
    samples = vehicles if plane is None else _Samples.joined([vehicles, plane[0]])
    start = _start(depth, samples) if len(samples.number) >= DEPTH_SCALE.least_samples else None
    if start is None:
        return None
    typical = float(np.median(1.0 / samples.metres if depth.inverse else samples.metres))
    return replace(depth, calibration=_Fit(depth, plane, usable, start, typical).calibration())


def _on_vehicle(depth: DepthMap, problem: Problem, estimate: PoseEstimate, camera: Camera) -> _Samples:
    """Numbers on the surface of a vehicle at a pose: medians of some parts of it, nearest first."""
    none = _Samples(np.zeros(0), np.zeros(0), np.zeros(0))
    box, model = problem.observation.box, problem.model
    if box is None or model.prior.surface is None:
        return none
    row, column = _grid(box, DEPTH_SCALE.vehicle_pixels, depth.depth.shape)
    kept = np.isfinite(depth.depth[row, column])
    row, column = row[kept], column[kept]
    pose = estimate.camera_T_object
    rays = pixel_rays(row, column, camera)
    points = rays * pose[2, 3]
    patches, odds = patches_of(model.prior), SETTINGS.points.odds
    ones, size = np.ones(len(points)), (model.dimension_mean, model.dimension_basis)
    rows = PointRows(points, 0.05 * ones, np.zeros(3), patches, *size, odds, 1.0, ones)
    state = pose[:3, :3], pose[:3, 3], estimate.coefficients
    match = rows.match(*state)
    off = rows.distances(match, *state, want=False)[0] * match.sigma
    slope = ((rays @ pose[:3, :3]) * patches.normal[match.patch]).sum(axis=1)
    on = (match.right > 0.5 * odds.vehicle) & (slope < 0.0)
    if on.sum() < DEPTH_SCALE.parts:
        return none
    metres, number = pose[2, 3] - off[on] / slope[on], depth.depth[row[on], column[on]]
    parts = np.array_split(np.argsort(metres), DEPTH_SCALE.parts)
    medians = np.array([(np.median(number[part]), np.median(metres[part])) for part in parts])
    sigma = np.full(len(parts), DEPTH_SCALE.vehicle_sigma * np.sqrt(len(parts)))
    return _Samples(medians[:, 0], medians[:, 1], sigma)


def _on_ground(depth: DepthMap, ground: Ground, camera: Camera) -> tuple[_Samples, Array] | None:
    """Numbers where the ground is seen unless something stands there, and their rays (M, 3); None where there are few.

    What stands on the ground is nearer than the ground behind it: an outlier of the fit.
    """
    height, width = depth.depth.shape
    row, column = _grid(np.array([0.0, 0.0, width - 1.0, height - 1.0]), DEPTH_SCALE.ground_pixels, (height, width))
    rays = pixel_rays(row, column, camera)
    down = rays @ ground.normal
    metres = ground.distance / np.maximum(down, 1e-6)
    near, far = DEPTH_SCALE.ground_m
    kept = (metres > near) & (metres < far) & np.isfinite(depth.depth[row, column])
    if kept.sum() < DEPTH_SCALE.least_samples:
        return None
    count = int(kept.sum())
    sigma = np.full(count, DEPTH_SCALE.ground_sigma * np.sqrt(count / DEPTH_SCALE.independent_ground))
    return _Samples(depth.depth[row, column][kept], metres[kept], sigma), rays[kept]


def _grid(box: Array, count: int, shape: tuple[int, ...]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of about so many pixels in a box (4,) of an image."""
    low, high = np.maximum(np.ceil(box[:2]), 0.0), np.minimum(np.floor(box[2:]), [shape[1] - 1.0, shape[0] - 1.0])
    step = max(1, int(np.sqrt(max(np.prod(np.maximum(high - low, 0.0)), 1.0) / count)))
    row, column = np.meshgrid(np.arange(low[1], high[1] + 1, step), np.arange(low[0], high[0] + 1, step), indexing="ij")
    return row.ravel().astype(np.intp), column.ravel().astype(np.intp)


def _start(depth: DepthMap, samples: _Samples) -> tuple[float, float] | None:
    """Scale and shift by which most samples are where they should be: those of the best of many pairs, or None."""
    target = 1.0 / samples.metres if depth.inverse else samples.metres
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, len(target), (DEPTH_SCALE.pairs, 2))
    if depth.scale is DepthScale.SCALE:
        scale, shift = target / np.where(samples.number > 0.0, samples.number, np.nan), np.zeros(len(target))
    else:
        numbers, targets = samples.number[pairs], target[pairs]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (targets[:, 1] - targets[:, 0]) / (numbers[:, 1] - numbers[:, 0])
            shift = targets[:, 0] - scale * numbers[:, 0]
    right = np.isfinite(scale) & (scale > 0.0)
    if not right.any():
        return None
    scale, shift = scale[right], shift[right]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.log(scale[:, None] * samples.number + shift[:, None]) - np.log(target)
    cost = np.minimum(np.nan_to_num(np.square(off / samples.sigma), nan=np.inf), DEPTH_SCALE.outlier_sigmas**2)
    best = int(cost.sum(axis=1).argmin())
    return float(scale[best]), float(shift[best])


@dataclass(frozen=True)
class _Fit:
    """A first scale and shift; five numbers change it: log scale, shift, and the plane's log height and slopes."""

    depth: DepthMap
    plane: tuple[_Samples, Array] | None  # samples of the ground and their rays, or None
    ground: Ground | None  # the ground, or None
    start: tuple[float, float]  # scale and shift that the numbers change,
    typical: float  # and the (inverse) depth in which the shift is measured

    @property
    def known(self) -> Array:
        """(5,) how sure the numbers are before samples say anything."""
        shift = DEPTH_SCALE.wide_shift if self.depth.scale is DepthScale.SCALE_AND_SHIFT else DEPTH_SCALE.no_shift
        slope = 1.0 if self.ground is None else self.ground.slope_sigma
        return np.array([DEPTH_SCALE.wide_log_scale, shift, DEPTH_SCALE.height_share, slope, slope])

    def residuals(self, x: Array) -> Array:
        """(M,) of the samples of the ground."""
        if self.plane is None or self.ground is None:
            return np.zeros(0)
        samples, rays = self.plane
        calibration = self.start[0] * float(np.exp(x[0])), self.start[1] + self.typical * float(x[1])
        down = rays @ self.ground.normal + rays[:, 2] * x[3] + rays[:, 0] * x[4]
        metres = self.ground.distance * np.exp(x[2]) / np.maximum(down, 1e-4)
        return _off(self.depth, samples, calibration, metres)

    def calibration(self) -> DepthCalibration:
        """The first scale and shift, as sure as by the ground: what the vehicles say is said by their graph."""
        off = self.residuals(np.zeros(5))
        by = np.stack([(self.residuals(step) - off) / _STEP for step in _STEP * np.eye(5)], axis=1)
        weighted = by / np.square(1.0 + np.square(off / DEPTH_SCALE.loss_sigmas))[:, None]  # Geman and McClure's
        units = np.diag([self.start[0], self.typical]) * (1.0 if self.plane is None else DEPTH_SCALE.inflation)
        found = units @ np.linalg.inv(weighted.T @ by + np.diag(1.0 / self.known**2))[:2, :2] @ units
        return DepthCalibration(*self.start, 0.5 * (found + found.T))


def _off(depth: DepthMap, samples: _Samples, calibration: tuple[float, float], metres: Array) -> Array:
    """By how many standard deviations the logarithms of depths are off."""
    found = np.maximum(calibration[0] * samples.number + calibration[1], 1e-6)
    return np.asarray((np.log(found) * (-1.0 if depth.inverse else 1.0) - np.log(metres)) / samples.sigma)
