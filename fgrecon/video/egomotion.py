"""Visual odometry between two images: tracked points off the vehicles; the scale from the ground below the camera.

    point i of the image before: ray x_i, inverse depth rho_i ----- reprojection in the image after ----- motion R, t
                                        |
                  on the road?   n . x_i / d ------------------------------------ ground n, d (slopes, height)

The motion, every inverse depth and small changes of the ground are estimated together by re-weighted Gauss-Newton;
inverse depths are eliminated point by point. It begins at the motion of the essential matrix, scaled so that the road's
points lie on the ground, and at a guess, the motion before, or at standing still where there is none; the best end
counts, unless standing still explains the points nearly as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factors.native import native
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import exponential, rigid


@dataclass(frozen=True)
class EgomotionSettings:
    """What is assumed of points and road, and how the motion is sought.

    Set by hand and seen to do on KITTI's parked cars (drive 0095); none is tuned.
    """

    point_sigma_px: float = 0.5  # of a tracked point
    inlier_sigmas: float = 3.0  # from which on a point or a place on the road counts for less
    correlation_inflation: float = 3.0  # of standard deviations: errors of tracked points are alike
    road_depth_m: float = 25.0  # points up to here, and so far aside, are the road's if they move like it
    road_half_width_m: float = 4.0
    road_relief_sigma: float = 0.03  # of the road's inverse depth, relative: it is no plane
    height_sigma: float = 0.015  # of the camera's height, relative: it bounces
    other_inverse_depth_per_m: float = 0.05  # mean of points off the road
    other_inverse_depth_sigma_per_m: float = 0.2
    far_inverse_depth_per_m: float = 0.02  # where such points are sought at first
    standing_information_per_m2: float = 1e12  # inverse variance of a standing camera's place
    min_gain_nats_per_point: float = 0.05  # by which a motion must explain the points better than standing still does
    standing_sigma_m: float = 0.02  # that a camera may have moved which seems to stand
    length_sigma: float = 0.02  # relative: what is unknown of a length and differs from one motion to the next
    min_points: int = 20
    min_road_points: int = 8
    max_iterations: int = 25
    least_iterations: int = 5
    smallest_step: float = 1e-6  # radians and metres, after which no other follows
    max_features: int = 300  # off the road, and as many on it
    least_quality: float = 0.01  # of a point off the road, of the best one's: how much of a corner it is
    least_road_quality: float = 0.005
    least_distance_px: float = 12.0  # from point to point, off the road
    least_road_distance_px: float = 8.0
    levels: int = 4  # of halved images over which a point is followed
    back_levels: int = 1  # and followed back, from where it was
    max_backtrack_px: float = 0.7  # by which a point may miss itself when tracked back
    box_margin_px: int = 6  # around vehicles' boxes


SETTINGS = EgomotionSettings()


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """The motion of a camera from one image to the next.

    Attributes:
        previous_T_current: (4, 4) pose of the camera in its frame of the image before, metres.
        covariance: (6, 6) of its rotation and translation, in this order, in the current camera's frame. It
            leaves out what all motions of a camera have wrong alike: about 4 % of their length, since the road is no
            plane and what stands on it hides among its points.
        points: How many points agree with it.
    """

    previous_T_current: Array
    covariance: Array
    points: int

    def then(self, later: CameraMotion) -> CameraMotion:
        """This motion and the one that follows it, as one."""
        rotation, way = later.previous_T_current[:3, :3].T, later.previous_T_current[:3, 3]
        adjoint = np.zeros((6, 6))  # from the axes in between to those at the end
        adjoint[:3, :3] = adjoint[3:, 3:] = rotation
        adjoint[3:, :3] = rotation @ np.cross(way, np.eye(3))
        covariance = adjoint @ self.covariance @ adjoint.T + later.covariance
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

    first = _corners(before, camera, ground, boxes_before)
    if not len(first):
        return np.zeros((0, 2)), np.zeros((0, 2))
    start = first.copy()
    if guess is not None:
        start = _flowed(first[:, 0].astype(np.float64), camera, ground, guess)[:, None].astype(np.float32)
    how: dict[str, Any] = {"winSize": (21, 21), "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    second, good, _ = cv2.calcOpticalFlowPyrLK(before, after, first, start, **how, maxLevel=SETTINGS.levels)
    back, good_back, _ = cv2.calcOpticalFlowPyrLK(
        after, before, second, first.copy(), **how, maxLevel=SETTINGS.back_levels
    )
    kept = (good[:, 0] > 0) & (good_back[:, 0] > 0)
    kept &= np.abs(back - first).max(axis=(1, 2)) < SETTINGS.max_backtrack_px
    there = second[:, 0]
    kept &= (there >= 0).all(axis=1) & (there < np.array(before.shape[::-1]) - 1).all(axis=1)
    for x1, y1, x2, y2 in boxes_after:
        kept &= ~(
            (there > (x1 - SETTINGS.box_margin_px, y1 - SETTINGS.box_margin_px))
            & (there < (x2 + SETTINGS.box_margin_px, y2 + SETTINGS.box_margin_px))
        ).all(axis=1)
    return first[kept, 0].astype(np.float64), there[kept].astype(np.float64)


def _corners(image: NDArray[np.uint8], camera: Camera, ground: Ground, boxes: Sequence[Array]) -> NDArray[np.float32]:
    """(P, 1, 2) pixels of points to follow, off the boxes: those off the road, and those on it.

    Off the road they are sought in the image at half its size, in a quarter of the time. The road's texture is too fine
    for that: motions become too long.
    """
    import cv2

    free = np.full(image.shape, 255, dtype=np.uint8)
    margin = SETTINGS.box_margin_px
    for x1, y1, x2, y2 in boxes:
        low_x, low_y = (max(int(low) - margin, 0) for low in (x1, y1))
        free[low_y : max(int(y2) + margin, 0), low_x : max(int(x2) + margin, 0)] = 0
    rows, columns = (np.arange(0, size, 8) for size in image.shape)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).astype(np.float64)
    road = _is_road(camera.rays(camera.undistort(grid.reshape(-1, 2))), ground).reshape(grid.shape[:2])
    on_road = np.repeat(np.repeat(road, 8, axis=0), 8, axis=1)[: image.shape[0], : image.shape[1]]
    height, width = (size // 2 * 2 for size in image.shape)
    half = cv2.resize(image[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    elsewhere = np.where(on_road, 0, free)[:height:2, :width:2]
    found = [
        2.0 * corners + 0.5  # pixel centres are integers
        for corners in _best(half, elsewhere, SETTINGS.least_quality, 0.5 * SETTINGS.least_distance_px)
    ]
    if road.any():
        (top, bottom), (left, right) = (np.flatnonzero(on_road.any(axis=axis))[[0, -1]] for axis in (1, 0))
        part = slice(top, bottom + 1), slice(left, right + 1)
        how = SETTINGS.least_road_quality, SETTINGS.least_road_distance_px
        found += [
            corners + np.array([left, top]) for corners in _best(image[part], np.where(on_road, free, 0)[part], *how)
        ]
    return np.concatenate(found).astype(np.float32)[:, None] if found else np.zeros((0, 1, 2), np.float32)


def _best(image: NDArray[np.uint8], mask: NDArray[np.uint8], quality: float, distance: float) -> list[Array]:
    """The best corners (P, 2) of an image where the mask is not 0; none is an empty list."""
    import cv2

    corners = cv2.goodFeaturesToTrack(image, SETTINGS.max_features, quality, distance, mask=mask)
    return [] if corners is None else [np.asarray(corners[:, 0], dtype=np.float64)]


def motion_of_points(
    before: Array, after: Array, camera: Camera, ground: Ground, guess: Array | None = None
) -> CameraMotion | None:
    """The motion of a camera by points that stand still, most of them.

    Args:
        before: (P, 2) pixels in the image before, without lens distortion.
        after: (P, 2) pixels of the same points in the next image.
        ground: The ground in its frame, which gives the scale.
        guess: (4, 4) previous_T_current as far as known, or None.

    Returns:
        The motion; None where there are too few points, or too few of the road.
    """
    problem = _Problem.of(before, after, camera, ground)
    if len(before) < SETTINGS.min_points or problem.road.sum() < SETTINGS.min_road_points:
        return None
    # From standing still the way is the longest, and ends where a guess does.
    starts = [np.eye(4) if guess is None else np.linalg.inv(guess), _essential(before, after, camera, problem)]
    solved = [problem.solve(start.astype(np.float64)) for start in starts if start is not None]
    best = min((end for end in solved if end is not None), key=lambda end: end.cost, default=None)
    still = problem.solve(np.eye(4), still=True)
    if still is not None and (best is None or still.cost < best.cost + SETTINGS.min_gain_nats_per_point * len(before)):
        best = still
    if best is None or best.points < SETTINGS.min_points or best.road_points < SETTINGS.min_road_points:
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
class _Rows:
    """Whitened derivatives of P points."""

    pose: Array  # (6, 2, P) of the reprojections by the motion
    ground: Array  # (3, P) of the inverse depths by the ground
    depth: Array  # (3, P) of both by the point's inverse depth
    missing: Array  # (3, P) what is missing
    weight: Array  # (P,) of the reprojections

    @cached_property
    def _crossed(self) -> Array:
        """(9, P) motion and ground beside the inverse depth."""
        return np.concatenate([(self.pose * self.depth[:2]).sum(axis=1), self.ground * self.depth[2]])

    @cached_property
    def _square(self) -> Array:
        return np.asarray((self.depth**2).sum(axis=0))

    @cached_property
    def _along(self) -> Array:
        return np.asarray((self.depth * self.missing).sum(axis=0))

    def without_depths(self) -> tuple[Array, Array]:
        """(9, 9) Hessian and (9,) gradient of motion and ground, inverse depths eliminated."""
        pose, hessian = self.pose.reshape(6, -1), np.zeros((9, 9))
        hessian[:6, :6] = pose @ pose.T
        hessian[6:, 6:] = self.ground @ self.ground.T
        hessian -= (self._crossed / self._square) @ self._crossed.T
        gradient = np.concatenate([pose @ self.missing[:2].reshape(-1), self.ground @ self.missing[2]])
        return hessian, gradient - self._crossed @ (self._along / self._square)

    def depths(self, step: Array) -> Array:
        """(P,) changes of the inverse depths that go with a step (9,) of motion and ground."""
        return np.asarray((self._along - step @ self._crossed) / self._square)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Points as rays, and which may be the road's."""

    before: Array  # (P, 3) rays with z = 1
    after: Array  # (P, 2) the next image's, x / z and y / z
    road: NDArray[np.bool_]  # (P,) whether a point may be the road's
    depth: Array  # (P,) inverse depth on the road, or the mean of others
    spread: Array  # (P,) its standard deviation
    slopes: Array  # (P, 3) derivative of the road's inverse depth by the ground's two slopes and relative height
    prior: Array  # (3,) inverse variances of these
    sigma: float  # of a point, in the unit of rays

    @classmethod
    def of(cls, before: Array, after: Array, camera: Camera, ground: Ground) -> _Problem:
        rays = camera.rays(before)
        road = _is_road(rays, ground)
        depth = np.where(road, rays @ ground.normal / ground.distance, SETTINGS.other_inverse_depth_per_m)
        slopes = np.stack([rays[:, 0] / ground.distance, rays[:, 2] / ground.distance, -depth], axis=1) * road[:, None]
        return cls(
            before=rays,
            after=camera.rays(after)[:, :2],
            road=road,
            depth=depth,
            spread=np.where(road, SETTINGS.road_relief_sigma * depth, SETTINGS.other_inverse_depth_sigma_per_m),
            slopes=slopes,
            prior=np.array([ground.slope_sigma, ground.slope_sigma, SETTINGS.height_sigma]) ** -2.0,
            sigma=SETTINGS.point_sigma_px / float(camera.matrix[0, 0]),
        )

    def solve(self, current_T_previous: Array, *, still: bool = False) -> _End | None:
        """Iterate from a motion; None where it leads nowhere. A camera that stands still may turn alone."""
        turn, shift = current_T_previous[:3, :3].copy(), current_T_previous[:3, 3].copy()
        plane, depth = np.zeros(3), self.depth.copy()
        trust = self.road.astype(np.float64)  # that a point is the road's
        if (kernel := native("fgrecon.video._egomotion")) is not None:
            weight, hessian = np.empty_like(depth), np.empty((9, 9))
            state = turn, shift, plane, depth, trust, weight, hessian
            standing = SETTINGS.standing_information_per_m2 if still else 0.0
            limits = SETTINGS.max_iterations, SETTINGS.least_iterations, SETTINGS.smallest_step
            if not kernel.Points(self, SETTINGS).iterate(*state, standing, *limits):
                return None
            return self._end(turn, shift, self._cost(depth, plane, weight, trust), weight, trust, hessian)
        for iteration in range(SETTINGS.max_iterations):
            there = self.before @ turn.T + depth[:, None] * shift
            if (there[:, 2] < 0.05).mean() > 0.2:
                return None
            there[:, 2] = np.maximum(there[:, 2], 0.05)
            rows = self._linearised(there, shift, depth, plane, trust)
            hessian, gradient = rows.without_depths()
            hessian[6:, 6:] += np.diag(self.prior)
            gradient[6:] -= self.prior * plane
            if still:
                hessian[[3, 4, 5], [3, 4, 5]] += SETTINGS.standing_information_per_m2
            try:
                step: Array = np.linalg.solve(hessian + 1e-9 * np.eye(9), gradient).astype(np.float64)
            except np.linalg.LinAlgError:
                return None
            depth = depth + rows.depths(step)
            plane = plane + step[6:]
            rotation = exponential(step[:3])
            turn, shift = rotation @ turn, rotation @ shift + step[3:6]
            trust = self.road / (1.0 + (self._off_road(depth, plane) / SETTINGS.inlier_sigmas) ** 2) ** 2
            if iteration > SETTINGS.least_iterations and np.abs(step[:6]).max() < SETTINGS.smallest_step:
                break
        cost = self._cost(depth, plane, rows.weight, trust)
        return self._end(turn, shift, cost, rows.weight, trust, hessian)

    def _linearised(self, there: Array, shift: Array, depth: Array, plane: Array, trust: Array) -> _Rows:
        """Whitened rows of each point: two of its reprojection, one of its inverse depth."""
        elsewhere = SETTINGS.other_inverse_depth_sigma_per_m
        inverse = 1.0 / there[:, 2]
        x, y = there[:, 0] * inverse, there[:, 1] * inverse
        off = (self.after.T - np.stack([x, y])) / self.sigma
        weight = 1.0 / (1.0 + (off**2).sum(axis=0) / SETTINGS.inlier_sigmas**2)
        root = np.sqrt(weight) / self.sigma
        far, cross = root * inverse, root * x * y
        tight = np.sqrt(np.where(self.road, np.maximum(trust, (self.spread / elsewhere) ** 2), 1.0))
        known = tight / np.where(trust > 0, self.spread, elsewhere)
        # Of x / z and y / z by turn and shift; a turn w moves a point by its cross product with w.
        pose = np.zeros((6, 2, len(there)))
        pose[0] = -cross, -root * (1.0 + y * y)
        pose[1] = root * (1.0 + x * x), cross
        pose[2] = -root * y, root * x
        pose[3, 0] = pose[4, 1] = depth * far
        pose[5] = -x * pose[3, 0], -y * pose[3, 0]
        by_depth = np.stack([far * (shift[0] - x * shift[2]), far * (shift[1] - y * shift[2]), known])
        short = known * (self.depth + self.slopes @ plane - depth)
        return _Rows(pose, -known * self.slopes.T, by_depth, np.stack([*(root * self.sigma * off), short]), weight)

    def _off_road(self, depth: Array, plane: Array) -> Array:
        """(P,) by how many standard deviations inverse depths are off the road."""
        return np.asarray((depth - (self.depth + self.slopes @ plane)) / self.spread)

    def _cost(self, depth: Array, plane: Array, weight: Array, trust: Array) -> float:
        """How badly a motion explains the points, nats."""
        cost = -np.log(np.maximum(weight, 1e-9)).sum() - 0.5 * np.log(np.maximum(trust[self.road], 1e-2)).sum()
        cost += 0.5 * np.minimum(((depth - self.depth) / self.spread) ** 2, 9.0)[~self.road].sum()
        return float(cost + 0.5 * float(self.prior @ plane**2))

    @staticmethod
    def _end(turn: Array, shift: Array, cost: float, weight: Array, trust: Array, hessian: Array) -> _End | None:
        pose = rigid(turn, shift)
        if not np.isfinite(hessian).all() or not np.isfinite(shift).all():
            return None
        try:
            covariance: Array = np.linalg.inv(hessian)[:6, :6].astype(np.float64) * SETTINGS.correlation_inflation**2
        except np.linalg.LinAlgError:
            return None
        stands = np.abs(shift).max() < 1e-6
        standing, driving = SETTINGS.standing_sigma_m**2 * np.eye(3), SETTINGS.length_sigma**2 * np.outer(shift, shift)
        covariance[3:, 3:] += standing if stands else driving
        good = weight > 0.5
        return _End(pose, covariance, cost, int(good.sum()), int((good & (trust > 0.25)).sum()))


def _is_road(rays: Array, ground: Ground) -> NDArray[np.bool_]:
    """(P,) whether rays (P, 3) meet the ground near enough, and not far aside."""
    falls = rays @ ground.normal
    distance = ground.distance / np.maximum(falls, 1e-9)
    near, aside = SETTINGS.road_depth_m, SETTINGS.road_half_width_m
    return np.asarray((distance < near) & (np.abs(distance * rays[:, 0]) < aside))


def _flowed(pixels: Array, camera: Camera, ground: Ground, previous_T_current: Array) -> Array:
    """(P, 2) where pixels will be after a motion: those below the horizon on the ground, others far away."""
    rays = camera.rays(camera.undistort(pixels))
    on_ground = np.maximum(rays @ ground.normal, 0.0) / ground.distance
    depth = np.where(_is_road(rays, ground), on_ground, SETTINGS.far_inverse_depth_per_m)
    current_T_previous = np.linalg.inv(previous_T_current)
    there = rays @ current_T_previous[:3, :3].T + depth[:, None] * current_T_previous[:3, 3]
    usable = there[:, 2] > 0.1
    there[~usable] = rays[~usable]
    return camera.distort(camera.project(there))


def _essential(before: Array, after: Array, camera: Camera, problem: _Problem) -> Array | None:
    """(4, 4) current_T_previous by the essential matrix, scaled by the road; None where it is not determined."""
    import cv2

    if len(before) < SETTINGS.min_points or np.median(np.abs(after - before)) < 0.3:
        return None
    matrix, inside = cv2.findEssentialMat(before, after, camera.matrix, cv2.RANSAC, 0.999, 1.0)
    if matrix is None or matrix.shape != (3, 3):
        return None
    _, turn, direction, _ = cv2.recoverPose(matrix, before, after, camera.matrix, mask=inside.copy())
    shift = direction[:, 0]
    # For x' z' = R x / rho + s t: the inverse depth of unit motion, by least squares along the parallax.
    rotated = problem.before @ turn.T
    after_rays = np.concatenate([problem.after, np.ones((len(before), 1))], axis=1)
    parallax, off = np.cross(after_rays, shift), np.cross(after_rays, rotated)
    square = (parallax**2).sum(axis=1)
    unit_depth = -(parallax * off).sum(axis=1) / np.maximum(square, 1e-12)  # rho times the length of the motion
    noise = problem.sigma / np.sqrt(np.maximum(square, 1e-12))
    usable = problem.road & (inside[:, 0] > 0) & (unit_depth > 5.0 * noise)
    if usable.sum() < SETTINGS.min_road_points:
        return None
    return rigid(turn, shift * _road_length(problem, unit_depth, noise, usable))


def _road_length(problem: _Problem, unit_depth: Array, noise: Array, usable: NDArray[np.bool_]) -> float:
    """How long the motion is, metres, by the plane of the most points: the lowest of those that have many.

    What is no road stands on it, and would make the motion longer.

    Args:
        unit_depth: (P,) their inverse depths, were the motion of unit length.
        noise: (P,) standard deviations of these.
        usable: (P,) which may be the road's, and have a parallax.
    """
    measured, spread = unit_depth[usable], np.hypot(noise[usable], SETTINGS.road_relief_sigma * unit_depth[usable])
    # Linear in length, and in length times the ground's slopes, whose priors hold the latter two.
    design = np.column_stack([problem.depth[usable], problem.slopes[usable, :2]])
    ends = []
    for length in np.quantile(measured / design[:, 0], (0.1, 0.25, 0.5, 0.75)):
        plane = np.array([length, 0.0, 0.0])
        for _ in range(10):
            weight = (1.0 / (1.0 + ((measured - design @ plane) / spread / SETTINGS.inlier_sigmas) ** 2) / spread) ** 2
            normal = design.T @ (weight[:, None] * design)
            normal[[1, 2], [1, 2]] += problem.prior[:2] / plane[0] ** 2
            plane = np.linalg.solve(normal, design.T @ (weight * measured))
        agree = float((1.0 / (1.0 + ((measured - design @ plane) / spread / SETTINGS.inlier_sigmas) ** 2)).sum())
        ends.append((agree, float(plane[0])))
    most = max(agree for agree, _ in ends)
    return min(length for agree, length in ends if agree > 0.8 * most)
