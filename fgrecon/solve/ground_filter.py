"""Filter of the ground plane over time, by the vehicles of frame after frame.

    given --- G(0) ---- road ---- G(1) ---- road ---- G(2)
                |                   |                   |
             vehicles            vehicles            vehicles

A camera nods, and the road bends; both change slowly, and in the long run the ground is as near to what is given as
that says (`Ground`). Each frame is one step: what its vehicles say, with poses and shapes eliminated
(`image_ground.py`), one factor from the ground before, and what is left of that. Vehicles that are seen again err
alike: they count by the time that has passed; what other cameras see at one time counts alike. How sure the ground is
goes by a second chain, in which they count as their keypoints do for covariances. Where nothing is given the first
vehicles say about where it is, nothing draws it back there, and it may change fast.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import gtsam
import numpy as np

from factors.contact import GroundFrame
from factors.ground_transition import ground_transition_factor
from factors.keys import G
from factors.marginals import Marginal, both, normal_marginal
from factors.noise import full_noise
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FactorCallbackError
from fgrecon.solve.image_ground import GroundEvidence, ground_spread, observed_ground, own_deviations
from fgrecon.solve.solve_settings import GROUND_FILTER, ROAD, SCENE
from fgrecon.solve.time.frame import CameraDrift, seconds_from
from fgrecon.solve.time.time_settings import SETTINGS


@dataclass(frozen=True)
class CameraFrame:
    """A frame of a camera, before its vehicles are looked at."""

    time: float  # seconds, by a clock on which no two frames are of one time
    camera: Camera
    ground: Ground | None = None  # about where the ground is, or None
    world_T_camera: gtsam.Pose3 | None = None  # pose of the camera, or None
    # (6, 6) of the camera's motion since the last frame with a place: rotation, translation in its frame; None
    # where it is exact
    motion_covariance: Array | None = None
    drift: CameraDrift = field(default_factory=CameraDrift)  # how far the camera may be astray
    sensed: bool = False  # whether measured points say where the ground is

    def motion_from(self, before: CameraFrame) -> gtsam.Pose3 | None:
        """camera_before_T_camera_now; None where that is not known."""
        if before.world_T_camera is None or self.world_T_camera is None:
            return None
        return before.world_T_camera.between(self.world_T_camera)


class _Vehicles(Protocol):
    """The vehicles of a frame, looked at on a ground; `fgrecon.solve.frame_vehicles.FrameVehicles` are such."""

    def poses(self) -> Sequence[Array]:
        """Pose (4, 4) of each that was looked at."""

    def ground_evidence(self, known: Marginal, plane: Ground, /) -> GroundEvidence | None:
        """What they say of G(0), a change of the plane, beside what is known of it."""


Vehicles = TypeVar("Vehicles", bound=_Vehicles)


@dataclass(frozen=True)
class _Nominal:
    """About where the ground of a frame is; `given` where somebody has said so, else vehicles have."""

    plane: Ground
    given: bool = True
    sensed_s: float | None = None  # when measured points said so, seconds; None where they have not

    @property
    def spread(self) -> Array:
        """(3,) standard deviations of height, pitch and roll before any vehicle says more."""
        return ground_spread(self.plane if self.given else None)

    @property
    def axes(self) -> GroundFrame:
        """Axes in which G(0) changes it."""
        return GroundFrame.of(self.plane.normal, self.plane.distance)


@dataclass(frozen=True)
class _Past:
    """The ground of the last frame; `share` is that by which its vehicles counted."""

    frame: CameraFrame
    nominal: _Nominal
    known: _Known
    ground: Ground
    share: float


@dataclass(frozen=True)
class _Known:
    """What is known of G(0): where it is, and how sure that is."""

    where: Marginal
    counted: Marginal


@dataclass(frozen=True)
class KnownGround:
    """The ground of a frame."""

    ground: Ground  # the plane, and how far each vehicle is taken to be off it for itself
    nominal: Ground  # about where it is
    covariance: Array  # (3, 3) of its height, pitch and roll

    def considered(self, camera_T_object: Array, covariance: Array) -> Array:
        """The covariance (6, 6) of a pose that was solved on it, with what was left out of the ground's own.

        For the solve most of what is unsure about the ground is the same for all vehicles and frames, and no freedom of
        each. The pose is as unsure nevertheless, as far as the ground decides it (Schmidt's consider covariance).
        """
        rotation, place = camera_T_object[:3, :3], camera_T_object[:3, 3]
        across = np.array([-1.0, *(GroundFrame.of(self.ground.normal, self.ground.distance).across @ place)])
        depth = float(place[2])
        whole = _own_variance(self.nominal, depth) + float(across @ self.covariance @ across)
        used = self.ground.height_sigma_at_depth(depth) ** 2
        by_height = covariance[:, 3:] @ rotation.T @ self.ground.normal / used  # of the pose, by the ground's height
        return covariance + max(whole - used, 0.0) * np.outer(by_height, by_height)


@dataclass(frozen=True)
class GroundFilter:
    """The ground of one video up to a frame; `past` is None before the first."""

    past: _Past | None = None

    def later(
        self, frame: CameraFrame, look: Callable[[Ground | None], Vehicles]
    ) -> tuple[GroundFilter, KnownGround | None, Vehicles]:
        """Take a frame, and look at its vehicles on its ground.

        Args:
            look: Looks at its vehicles, there may be none, on a ground.

        Returns:
            The road up to the frame, its ground, and its vehicles. No ground where nothing tells of it: fewer than two
            vehicles do not.
        """
        nominal, vehicles = self._nominal(frame), None
        if nominal is None:
            vehicles = look(None)
            poses = vehicles.poses()
            observed = observed_ground(poses) if len(poses) > 1 else None
            if observed is None:
                return GroundFilter(), None, vehicles
            nominal = _Nominal(observed, given=False)
            known, share = _first(nominal)
        else:
            known, share = self._before(frame, nominal)
        if vehicles is None:
            here = _ground(nominal, known)
            vehicles = look(nominal.plane if here is None else here.ground)
        evidence = vehicles.ground_evidence(known.where, nominal.plane)
        if evidence is not None:
            marginal, before = evidence.marginal.scaled(share), known
            less = marginal.scaled(1.0 / evidence.common_factor)
            known = _known(lambda: (both(before.where, marginal), both(before.counted, less))) or known
        found = _ground(nominal, known)
        return (
            GroundFilter(None if found is None else _Past(frame, nominal, known, found.ground, share)),
            found,
            vehicles,
        )

    def _before(self, frame: CameraFrame, nominal: _Nominal) -> tuple[_Known, float]:
        """What is known of the ground of a frame before its vehicles speak, and by which share these count."""
        past = self.past
        alike = past is not None and (past.nominal.sensed_s is None) == (nominal.sensed_s is None)
        if past is not None and (not nominal.given or (past.nominal.given and alike)):
            moved, before = _moved(past, frame, nominal), past.known
            known = _known(lambda: (_on_road(before.where, moved), _on_road(before.counted, moved)))
            if known is not None:
                seconds = frame.time - past.frame.time
                simultaneous = seconds < SETTINGS.simultaneous_s
                return known, past.share if simultaneous else min(seconds / GROUND_FILTER.correlation_s, 1.0)
        # The first frame, or the camera has gone where no ground before tells of this one, or now it is given.
        return _first(nominal)

    def _nominal(self, frame: CameraFrame) -> _Nominal | None:
        """About where the ground of a frame is: as is given, else where it was; None where that is open.

        Where points said it shortly before, and now none are there, it is where it was as well.
        """
        last = None if self.past is None or frame.sensed else self.past.nominal.sensed_s
        held = last is not None and seconds_from(last, frame.time) < ROAD.held_s
        if (frame.ground is None or held) and (carried := self._carried(frame, given=held)) is not None:
            return carried
        return None if frame.ground is None else _Nominal(frame.ground, sensed_s=frame.time if frame.sensed else None)

    def _carried(self, frame: CameraFrame, *, given: bool) -> _Nominal | None:
        """Where the ground was in the frame before, as it is seen from this one; None where that is open."""
        past = self.past
        if past is None:
            return None
        motion = frame.motion_from(past.frame)
        if motion is None:
            same = np.array_equal(past.frame.camera.matrix, frame.camera.matrix)
            return replace(past.nominal, given=given) if same else None
        here = replace(past.nominal.plane, normal=past.ground.normal, distance=past.ground.distance)
        normal = motion.rotation().matrix().T @ here.normal
        if normal[1] <= SCENE.least_normal_down:  # it looks upside down
            return None
        distance = max(here.distance - float(here.normal @ motion.translation()), SCENE.least_camera_height_m)
        return replace(past.nominal, plane=replace(here, normal=normal, distance=distance), given=given)


def _first(nominal: _Nominal) -> tuple[_Known, float]:
    """What is known of the ground of a first frame before its vehicles speak, and by which share these count."""
    values = gtsam.Values()
    values.insert(G(0), np.zeros(3))
    first = Marginal((G(0),), (3,), values, np.diag(1.0 / nominal.spread), np.zeros(3))
    return _Known(first, first), 1.0


def _moved(past: _Past, frame: CameraFrame, nominal: _Nominal) -> gtsam.CustomFactor:
    """What ties a frame's ground G(1) to the one before, G(0)."""
    motion, seconds, axes = frame.motion_from(past.frame), frame.time - past.frame.time, nominal.axes
    kept = max(float(np.exp(-seconds / GROUND_FILTER.deviation_s)), GROUND_FILTER.least_kept) if nominal.given else 1.0
    changes = 1.0 - kept**2 if nominal.given else 2.0 * seconds / GROUND_FILTER.estimated_change_s
    unsure = np.diag(changes * ground_spread(nominal.plane) ** 2)
    if motion is not None and frame.motion_covariance is not None:
        by_motion = np.zeros((3, 6))  # of height and slopes, in the camera's frame now
        by_motion[0, 3:], by_motion[1:, :3] = axes.normal, np.cross(axes.normal, axes.across)
        unsure = unsure + by_motion @ frame.motion_covariance @ by_motion.T
    return ground_transition_factor(
        G(0), G(1), (past.nominal.axes, axes), full_noise("ground_transition", unsure), motion, kept
    )


def _known(make: Callable[[], tuple[Marginal, Marginal]]) -> _Known | None:
    """What is known after a step; None where the numbers leave it open."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a camera may be given any place
            found = _Known(*make())
        spreads = [_covariance(one) for one in (found.where, found.counted) if len(one.matrix) == 3]
    except FactorCallbackError:
        raise
    except (RuntimeError, np.linalg.LinAlgError):  # GTSAM's and numpy's signs of a system that determines nothing
        return None
    return found if len(spreads) == 2 and np.isfinite(spreads).all() else None


def _on_road(left: Marginal, moved: gtsam.CustomFactor) -> Marginal:
    """What is known of a frame's ground by those before.

    The frame's vehicles have not spoken yet, so the ground before stays where it is, and this one is where that leads.
    """
    covariance = _covariance(left)
    place = left.values.atVector(G(0)) + np.linalg.solve(left.matrix.T @ left.matrix, left.matrix.T @ left.right)
    values = gtsam.Values()
    values.insert(G(0), place)
    values.insert(G(1), np.zeros(3))
    rows, right = moved.linearize(values).jacobian()
    before, now = rows[:, :3], np.linalg.inv(rows[:, 3:])
    return normal_marginal(G(0), now @ right, now @ (before @ covariance @ before.T + np.eye(3)) @ now.T)


def _ground(nominal: _Nominal, known: _Known) -> KnownGround | None:
    """The plane, and how far a vehicle's origin may be off it: as far as is given where nothing is known.

    None where the plane is no ground.
    """
    plane, spread = nominal.plane, nominal.spread
    normal, distance = nominal.axes.plane(known.where.values.atVector(G(0)))
    if normal[1] <= SCENE.least_normal_down:
        return None
    covariance = _covariance(known.where)

    def variance(depth: float) -> float:
        across = np.array([-1.0, depth, 0.0])
        own, whole = _own_variance(plane, depth), float(np.square(across * spread).sum())
        left = min(float(across @ covariance @ across) / whole, 1.0)
        return own + (whole - own) * left**2  # what is left of it counts less: it is mostly the same for all vehicles

    near, far = variance(GROUND_FILTER.near_m), variance(GROUND_FILTER.far_m)
    measured = nominal.sensed_s is not None  # such a plane is sure: what it is unsure by is how far roads are off it
    least_height, least_slope = (plane.height_sigma, plane.slope_sigma) if measured else own_deviations(plane, 1.0)
    slope = max((far - near) / (GROUND_FILTER.far_m**2 - GROUND_FILTER.near_m**2), least_slope**2)
    height = max(near - slope * GROUND_FILTER.near_m**2, least_height**2)
    ground = replace(
        plane,
        normal=normal,
        distance=max(distance, SCENE.least_camera_height_m),
        height_sigma=float(np.sqrt(height)),
        slope_sigma=float(np.sqrt(slope)),
    )
    return KnownGround(ground, plane, _covariance(known.counted))


def _covariance(known: Marginal) -> Array:
    return np.linalg.inv(known.matrix.T @ known.matrix).astype(np.float64)


def _own_variance(nominal: Ground, depth: float) -> float:
    """Of a vehicle's origin off the ground, what is its own, square metres."""
    by_height, by_slope = own_deviations(nominal, depth)
    return by_height**2 + by_slope**2
