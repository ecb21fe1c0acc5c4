"""How a camera has moved between two images: points off the vehicles, tracked; the scale from the ground below it.

    point i of the image before: ray x_i, inverse depth rho_i ----- reprojection in the image after ----- motion R, t
                                        |
                  on the road?   n . x_i / d ------------------------------------ ground n, d (slopes, height)

The motion, every inverse depth and small changes of the ground are estimated together by re-weighted Gauss-Newton;
inverse depths are eliminated point by point. It begins at the motion of the essential matrix, scaled so that the road's
points lie on the ground, at standing still, and at a guess; the best end counts, unless standing still explains the
points nearly as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import exponential

__all__ = ["SCALE_SIGMA", "CameraMotion", "camera_motion", "motion_of_points", "tracked_points"]

Array = NDArray[np.float64]

_PIXEL = 0.5  # standard deviation of a tracked point
_INLIER = 3.0  # standard deviations from which on a point counts for less
_ROAD_FAR, _ROAD_WIDE = 25.0, 4.0  # metres: where points are taken for the road's if they move like it
_UNEVEN = 0.03  # standard deviation of the road's inverse depth, relative
_BOUNCE = 0.015  # of the camera's height, relative
_ANYWHERE = (0.05, 0.2)  # mean and standard deviation of other points' inverse depth, 1 / metres
_STILL = 1e12  # inverse variance of a standing camera's place, 1 / square metres
_GAIN = 0.05  # by so much a point, nats, must a motion explain the points better than standing still does
_CREEP = 0.02  # metres that a camera may have moved which seems to stand
SCALE_SIGMA = 0.04
"""Standard deviation of the length of motions, relative: the road is no plane, and what stands on it hides among its
points. It errs alike in all motions of a camera, and so is in none of their covariances."""
_UNEQUAL = 0.02  # what is left of it that differs from one motion to the next
_LEAST_POINTS, _LEAST_ROAD = 20, 8
_ITERATIONS = 25
_ALIKE = 3.0  # errors of tracked points are alike: the covariance is that much larger
_FEATURES, _ROAD_FEATURES = 300, 300
_BACK = 0.7  # pixels by which a point may miss itself when tracked back
_MARGIN = 6  # pixels around vehicles' boxes


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """The motion of a camera from one image to the next.

    Attributes:
        previous_T_current: (4, 4) pose of the camera in its frame of the image before, metres.
        covariance: (6, 6) of its rotation and translation, in this order, in the current camera's frame; but for
            what all motions of the camera have wrong alike (`SCALE_SIGMA`).
        points: How many points agree with it.
    """

    previous_T_current: Array
    covariance: Array
    points: int

    def then(self, later: CameraMotion) -> CameraMotion:
        """This motion and the one that follows it, as one."""
        rotation, way = later.previous_T_current[:3, :3].T, later.previous_T_current[:3, 3]
        seen = np.zeros((6, 6))  # from the axes in between to those at the end
        seen[:3, :3] = seen[3:, 3:] = rotation
        seen[3:, :3] = rotation @ np.cross(way, np.eye(3))
        covariance = seen @ self.covariance @ seen.T + later.covariance
        motion = self.previous_T_current @ later.previous_T_current
        return CameraMotion(motion, covariance, min(self.points, later.points))


def camera_motion(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    camera: Camera,
    ground: Ground,
    boxes_before: Sequence[Array] = (),
    boxes_after: Sequence[Array] = (),
    guess: Array | None = None,
) -> CameraMotion | None:
    """The motion of a camera between two images.

    Args:
        before: (H, W) grey image.
        after: (H, W) the next one.
        camera: The camera that took both.
        ground: The ground in the camera's frame, which gives the scale.
        boxes_before: (4,) boxes of vehicles in the image before; points on them do not count.
        boxes_after: The same in the next image.
        guess: (4, 4) previous_T_current as far as known, such as the motion before; or None.

    Returns:
        The motion; None where there are too few points, or too few of the road.
    """
    if before.shape != after.shape:
        return None
    first, second = tracked_points(before, after, camera, ground, boxes_before, boxes_after, guess)
    return motion_of_points(camera.undistort(first), camera.undistort(second), camera, ground, guess)


def tracked_points(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    camera: Camera,
    ground: Ground,
    boxes_before: Sequence[Array] = (),
    boxes_after: Sequence[Array] = (),
    guess: Array | None = None,
) -> tuple[Array, Array]:
    """Pixels (P, 2) of points in the image before, and (P, 2) where they are in the next; see `camera_motion`."""
    import cv2

    mask = np.full(before.shape, 255, dtype=np.uint8)
    for x1, y1, x2, y2 in boxes_before:
        low_x, low_y = (max(int(low) - _MARGIN, 0) for low in (x1, y1))
        mask[low_y : max(int(y2) + _MARGIN, 0), low_x : max(int(x2) + _MARGIN, 0)] = 0
    rows, columns = (np.arange(0, size, 8) for size in before.shape)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).astype(np.float64)
    road = _is_road(camera.rays(camera.undistort(grid.reshape(-1, 2))), ground).reshape(grid.shape[:2])
    on_road = np.repeat(np.repeat(road, 8, axis=0), 8, axis=1)[: before.shape[0], : before.shape[1]]
    found = [
        cv2.goodFeaturesToTrack(before, most, quality, distance, mask=np.where(part, mask, 0).astype(np.uint8))
        for part, most, quality, distance in (
            (~on_road, _FEATURES, 0.01, 12.0),
            (on_road, _ROAD_FEATURES, 0.005, 8.0),
        )
    ]
    points = [p for p in found if p is not None]
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 2))
    first = np.concatenate(points).astype(np.float32)
    start = first.copy()
    if guess is not None:
        start = _flowed(first[:, 0].astype(np.float64), camera, ground, guess)[:, None].astype(np.float32)
    settings: dict[str, Any] = {"winSize": (21, 21), "maxLevel": 4, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    second, good, _ = cv2.calcOpticalFlowPyrLK(before, after, first, start, **settings)
    back, good_back, _ = cv2.calcOpticalFlowPyrLK(after, before, second, first.copy(), **settings)
    kept = (good[:, 0] > 0) & (good_back[:, 0] > 0)
    kept &= np.abs(back - first).max(axis=(1, 2)) < _BACK
    there = second[:, 0]
    kept &= (there >= 0).all(axis=1) & (there < np.array(before.shape[::-1]) - 1).all(axis=1)
    for x1, y1, x2, y2 in boxes_after:
        kept &= ~((there > (x1 - _MARGIN, y1 - _MARGIN)) & (there < (x2 + _MARGIN, y2 + _MARGIN))).all(axis=1)
    return first[kept, 0].astype(np.float64), there[kept].astype(np.float64)


def motion_of_points(
    before: Array, after: Array, camera: Camera, ground: Ground, guess: Array | None = None
) -> CameraMotion | None:
    """The motion of a camera by points that stand still, most of them.

    Args:
        before: (P, 2) pixels in the image before, without lens distortion.
        after: (P, 2) pixels of the same points in the next image.
        camera: The camera.
        ground: The ground in its frame, which gives the scale.
        guess: (4, 4) previous_T_current as far as known, or None.

    Returns:
        The motion; None where there are too few points, or too few of the road.
    """
    problem = _Problem.of(before, after, camera, ground)
    if len(before) < _LEAST_POINTS or problem.road.sum() < _LEAST_ROAD:
        return None
    starts = [np.eye(4), _essential(before, after, camera, problem)]
    starts += [] if guess is None else [np.linalg.inv(guess).astype(np.float64)]
    solved = [problem.solve(start) for start in starts if start is not None]
    best = min((end for end in solved if end is not None), key=lambda end: end.cost, default=None)
    still = problem.solve(np.eye(4), still=True)
    if still is not None and (best is None or still.cost < best.cost + _GAIN * len(before)):
        best = still
    if best is None or best.points < _LEAST_POINTS or best.road_points < _LEAST_ROAD:
        return None
    previous_T_current: Array = np.linalg.inv(best.current_T_previous).astype(np.float64)
    return CameraMotion(previous_T_current, best.covariance, best.points)


@dataclass(frozen=True, eq=False)
class _End:
    """Where the iterations ended."""

    current_T_previous: Array
    covariance: Array
    cost: float
    points: int
    road_points: int


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points as rays, and which may be the road's.

    Attributes:
        before: (P, 3) rays with z = 1.
        after: (P, 2) the next image's, x / z and y / z.
        road: (P,) whether a point may be the road's.
        depth: (P,) inverse depth on the road, or the mean of others.
        spread: (P,) its standard deviation.
        slopes: (P, 3) derivative of the road's inverse depth by the ground's two slopes and relative height.
        prior: (3,) inverse variances of these.
        sigma: Of a point, in the unit of rays.
    """

    before: Array
    after: Array
    road: NDArray[np.bool_]
    depth: Array
    spread: Array
    slopes: Array
    prior: Array
    sigma: float

    @classmethod
    def of(cls, before: Array, after: Array, camera: Camera, ground: Ground) -> _Problem:
        rays = camera.rays(before)
        road = _is_road(rays, ground)
        depth = np.where(road, rays @ ground.normal / ground.distance, _ANYWHERE[0])
        slopes = np.stack([rays[:, 0] / ground.distance, rays[:, 2] / ground.distance, -depth], axis=1) * road[:, None]
        return cls(
            before=rays,
            after=camera.rays(after)[:, :2],
            road=road,
            depth=depth,
            spread=np.where(road, _UNEVEN * depth, _ANYWHERE[1]),
            slopes=slopes,
            prior=np.array([ground.slope_sigma, ground.slope_sigma, _BOUNCE]) ** -2.0,
            sigma=_PIXEL / float(camera.matrix[0, 0]),
        )

    def solve(self, current_T_previous: Array, *, still: bool = False) -> _End | None:
        """Iterate from a motion; None where it leads nowhere. A camera that stands still may turn alone."""
        turn, shift = current_T_previous[:3, :3].copy(), current_T_previous[:3, 3].copy()
        plane, depth = np.zeros(3), self.depth.copy()
        trust = self.road.astype(np.float64)  # that a point is the road's
        for iteration in range(_ITERATIONS):
            there = self.before @ turn.T + depth[:, None] * shift
            if (there[:, 2] < 0.05).mean() > 0.2:
                return None
            there[:, 2] = np.maximum(there[:, 2], 0.05)
            off = (self.after - there[:, :2] / there[:, 2:]) / self.sigma
            weight = 1.0 / (1.0 + (off**2).sum(axis=1) / _INLIER**2)
            project = np.zeros((len(there), 2, 3))
            project[:, 0, 0] = project[:, 1, 1] = 1.0 / there[:, 2]
            project[:, :, 2] = -there[:, :2] / there[:, 2:] ** 2
            project /= self.sigma
            by_pose = np.concatenate([-project @ _cross(there), depth[:, None, None] * project], axis=2)  # (P, 2, 6)
            by_depth = project @ shift  # (P, 2)
            wanted = self.depth + self.slopes @ plane
            spread = np.where(trust > 0, self.spread, _ANYWHERE[1])
            short = wanted - depth
            rows = np.zeros((len(there), 3, 9))
            rows[:, :2, :6], rows[:, 2, 6:] = by_pose, -self.slopes
            root = np.sqrt(weight)[:, None]
            tight = np.sqrt(np.where(self.road, np.maximum(trust, (self.spread / _ANYWHERE[1]) ** 2), 1.0))
            rows[:, :2] *= root[..., None]
            rows[:, 2] *= (tight / spread)[:, None]
            own = np.concatenate([by_depth * root, (tight / spread)[:, None]], axis=1)  # (P, 3) by its inverse depth
            missing = np.concatenate([off * root, (tight * short / spread)[:, None]], axis=1)
            square = (own**2).sum(axis=1)
            hessian = np.einsum("pij,pik->jk", rows, rows)
            gradient = np.einsum("pij,pi->j", rows, missing)
            crossed = np.einsum("pij,pi->pj", rows, own)
            along = (own * missing).sum(axis=1)
            hessian -= np.einsum("pj,pk->jk", crossed / square[:, None], crossed)
            gradient -= crossed.T @ (along / square)
            hessian[6:, 6:] += np.diag(self.prior)
            gradient[6:] -= self.prior * plane
            if still:
                hessian[[3, 4, 5], [3, 4, 5]] += _STILL
            try:
                step = np.linalg.solve(hessian + 1e-9 * np.eye(9), gradient)
            except np.linalg.LinAlgError:
                return None
            depth = depth + (along - crossed @ step) / square
            plane = plane + step[6:]
            rotation = exponential(step[:3])
            turn, shift = rotation @ turn, rotation @ shift + step[3:6]
            trust = self._trust(depth, plane)
            if iteration > 5 and np.abs(step[:6]).max() < 1e-6:
                break
        return self._end(turn, shift, depth, plane, weight, trust, hessian)

    def _trust(self, depth: Array, plane: Array) -> Array:
        """(P,) weights of the road's points as such: less for those whose own parallax says otherwise."""
        wanted = self.depth + self.slopes @ plane
        return np.asarray(self.road / (1.0 + ((depth - wanted) / self.spread / _INLIER) ** 2) ** 2)

    def _end(
        self, turn: Array, shift: Array, depth: Array, plane: Array, weight: Array, trust: Array, hessian: Array
    ) -> _End | None:
        if not np.isfinite(hessian).all() or not np.isfinite(shift).all():
            return None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, shift
        try:
            covariance: Array = np.linalg.inv(hessian)[:6, :6].astype(np.float64) * _ALIKE**2
            covariance[3:, 3:] += (
                _CREEP**2 * np.eye(3) if np.abs(shift).max() < 1e-6 else _UNEQUAL**2 * np.outer(shift, shift)
            )
        except np.linalg.LinAlgError:
            return None
        share = trust[self.road]
        cost = -np.log(np.maximum(weight, 1e-9)).sum() - 0.5 * np.log(np.maximum(share, 1e-2)).sum()
        cost += 0.5 * np.minimum(((depth - self.depth) / self.spread) ** 2, 9.0)[~self.road].sum()
        cost += 0.5 * float(self.prior @ plane**2)
        good = weight > 0.5
        return _End(pose, covariance, float(cost), int(good.sum()), int((good & (trust > 0.25)).sum()))


def _is_road(rays: Array, ground: Ground) -> NDArray[np.bool_]:
    """(P,) whether rays (P, 3) meet the ground near enough, and not far aside."""
    falls = rays @ ground.normal
    distance = ground.distance / np.maximum(falls, 1e-9)
    road: NDArray[np.bool_] = (distance < _ROAD_FAR) & (np.abs(distance * rays[:, 0]) < _ROAD_WIDE)
    return road


def _flowed(pixels: Array, camera: Camera, ground: Ground, previous_T_current: Array) -> Array:
    """(P, 2) where pixels will be after a motion: those below the horizon on the ground, others far away."""
    rays = camera.rays(camera.undistort(pixels))
    depth = np.where(_is_road(rays, ground), np.maximum(rays @ ground.normal, 0.0) / ground.distance, 0.02)
    current_T_previous = np.linalg.inv(previous_T_current)
    there = rays @ current_T_previous[:3, :3].T + depth[:, None] * current_T_previous[:3, 3]
    usable = there[:, 2] > 0.1
    there[~usable] = rays[~usable]
    return camera.distort(camera.project(there))


def _essential(before: Array, after: Array, camera: Camera, problem: _Problem) -> Array | None:
    """(4, 4) current_T_previous by the essential matrix, scaled by the road; None where it is not determined."""
    import cv2

    if len(before) < _LEAST_POINTS or np.median(np.abs(after - before)) < 0.3:
        return None
    matrix, inside = cv2.findEssentialMat(before, after, camera.matrix, cv2.RANSAC, 0.999, 1.0)
    if matrix is None or matrix.shape != (3, 3):
        return None
    _, turn, direction, _ = cv2.recoverPose(matrix, before, after, camera.matrix, mask=inside.copy())
    shift = direction[:, 0]
    # For x' z' = R x / rho + s t: the inverse depth of unit motion, by least squares along the parallax.
    turned = problem.before @ turn.T
    seen = np.concatenate([problem.after, np.ones((len(before), 1))], axis=1)
    parallax, off = np.cross(seen, shift), np.cross(seen, turned)
    square = (parallax**2).sum(axis=1)
    unit_depth = -(parallax * off).sum(axis=1) / np.maximum(square, 1e-12)  # rho times the length of the motion
    noise = problem.sigma / np.sqrt(np.maximum(square, 1e-12))
    usable = problem.road & (inside[:, 0] > 0) & (unit_depth > 5.0 * noise)
    if usable.sum() < _LEAST_ROAD:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift * _road_length(problem, unit_depth, noise, usable)
    return pose


def _road_length(problem: _Problem, unit_depth: Array, noise: Array, usable: NDArray[np.bool_]) -> float:
    """How long the motion is, metres, by the plane of the most points: the lowest of those that have many.

    What is no road stands on it, and would make the motion longer.

    Args:
        problem: The points.
        unit_depth: (P,) their inverse depths, were the motion of unit length.
        noise: (P,) standard deviations of these.
        usable: (P,) which may be the road's, and have a parallax.
    """
    seen, spread = unit_depth[usable], np.hypot(noise[usable], _UNEVEN * unit_depth[usable])
    # Linear in length, and in length times the ground's slopes, whose priors hold the latter two.
    design = np.column_stack([problem.depth[usable], problem.slopes[usable, :2]])
    ends = []
    for length in np.quantile(seen / design[:, 0], (0.1, 0.25, 0.5, 0.75)):
        plane = np.array([length, 0.0, 0.0])
        for _ in range(10):
            weight = (1.0 / (1.0 + ((seen - design @ plane) / spread / _INLIER) ** 2) / spread) ** 2
            normal = design.T @ (weight[:, None] * design)
            normal[[1, 2], [1, 2]] += problem.prior[:2] / plane[0] ** 2
            plane = np.linalg.solve(normal, design.T @ (weight * seen))
        agree = float((1.0 / (1.0 + ((seen - design @ plane) / spread / _INLIER) ** 2)).sum())
        ends.append((agree, float(plane[0])))
    most = max(agree for agree, _ in ends)
    return min(length for agree, length in ends if agree > 0.8 * most)


def _cross(vectors: Array) -> Array:
    """(P, 3, 3) matrices of the cross products with vectors (P, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
