"""The ground over time: what the vehicles of frame after frame say of the road under the camera.

    told ---- G(0) ---- road ---- G(1) ---- road ---- G(2)
                |                   |                   |
             vehicles            vehicles            vehicles

A camera nods, and the road bends; both change slowly, and in the long run the ground is as near to what is told as that
says (`Ground`). Each frame is one step: what its vehicles say, with poses and shapes eliminated (`ground_evidence.py`),
one factor from the ground before, and what is left of that. Vehicles that are seen again err alike: they count by the
time that has passed; what other cameras see at one time counts alike. How sure the ground is goes by a second chain, in
which they count as their keypoints do for covariances. Where nothing is told the first vehicles say about where it is,
nothing draws it back there, and it may change fast.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.contact import GroundFrame
from factors.keys import G
from factors.marginals import Marginal, marginal, marginal_factor
from factors.noise import full_noise
from factors.road import road_factor
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FactorCallbackError
from fgrecon.solve.ground_evidence import GroundEvidence
from fgrecon.solve.standing import (
    LEAST_DOWN,
    LEAST_HEIGHT,
    ground_spread,
    own_deviations,
    seen_ground,
)
from fgrecon.solve.time.window import AT_ONCE

__all__ = ["KnownGround", "Road"]

Array = NDArray[np.float64]

_ALIKE = 0.3  # seconds after which what vehicles say of the ground counts whole again
_LASTS = 12.0  # seconds after which a deviation from what is told has fallen to a third, and another one has come
_FREE = 0.1  # seconds in which a ground that nobody told may change by as much: the camera may be in a hand
_NEAR, _FAR = 10.0, 40.0  # metres: depths at which the uncertainty is that of the ground's
_LEAST_KEPT = 1e-6
_ROUNDS = 3  # of a solve that is nearly linear


class _Vehicles(Protocol):
    """The vehicles of a frame; `fgrecon.solve.frame_vehicles.FrameVehicles` are such."""

    def look(self, ground: Ground | None, /) -> None:
        """Look at them on a ground."""

    def poses(self) -> Sequence[Array]:
        """Pose (4, 4) of each that was looked at."""

    def say(self, known: Marginal, plane: Ground, /) -> GroundEvidence | None:
        """What they say of G(0), a change of the plane, beside what is known of it."""


@dataclass(frozen=True)
class _About:
    """About where the ground of a frame is.

    Attributes:
        plane: The plane.
        camera: What sees it.
        is_told: Whether somebody has told it, else vehicles speak of it.
    """

    plane: Ground
    camera: Camera
    is_told: bool = True

    @property
    def spread(self) -> Array:
        """(3,) standard deviations of height, pitch and roll before any vehicle says more."""
        return ground_spread(self.plane if self.is_told else None)


@dataclass(frozen=True)
class _Past:
    """The ground of the last frame."""

    time: float
    about: _About
    frame: GroundFrame
    world_T_camera: gtsam.Pose3 | None
    known: _Known
    ground: Ground
    weight: float  # share by which its vehicles counted


@dataclass(frozen=True)
class _Known:
    """What is known of G(0): where it is, and how sure that is."""

    where: Marginal
    counted: Marginal


@dataclass(frozen=True)
class KnownGround:
    """The ground of a frame.

    Attributes:
        ground: The plane, and how far each vehicle is taken to lie off it for itself.
        told: About where it is.
        covariance: (3, 3) of its height, pitch and roll.
    """

    ground: Ground
    told: Ground
    covariance: Array

    def considered(self, camera_T_object: Array, covariance: Array) -> Array:
        """The covariance (6, 6) of a pose that was solved on it, with what was left out of the ground's own.

        For the solve most of what is unsure about the ground is the same for all vehicles and frames, and no freedom of
        each. The pose is as unsure nevertheless, as far as the ground decides it (Schmidt's consider covariance).
        """
        rotation, place = camera_T_object[:3, :3], camera_T_object[:3, 3]
        across = np.array([-1.0, *(GroundFrame.of(self.ground.normal, self.ground.distance).across @ place)])
        depth = float(place[2])
        whole = _own_variance(self.told, depth) + float(across @ self.covariance @ across)
        used = self.ground.height_sigma_at_depth(depth) ** 2
        by_height = covariance[:, 3:] @ rotation.T @ self.ground.normal / used  # of the pose, by the ground's height
        considered: Array = covariance + max(whole - used, 0.0) * np.outer(by_height, by_height)
        return considered


class Road:
    """The ground of one video, frame by frame."""

    def __init__(self) -> None:
        """Begin without a frame."""
        self._past: _Past | None = None

    def later(
        self,
        time: float,
        told: Ground | None,
        camera: Camera,
        world_T_camera: gtsam.Pose3 | None,
        vehicles: _Vehicles,
        *,
        motion_covariance: Array | None = None,
    ) -> KnownGround | None:
        """Take a frame, and look at its vehicles on its ground.

        Args:
            time: Of the frame, seconds.
            told: About where the ground is, or None.
            camera: What sees it.
            world_T_camera: Pose of the camera, or None.
            vehicles: Those of the frame; may be none.
            motion_covariance: (6, 6) of the camera's motion since the last frame with a place: rotation, translation in
                its frame; None where it is exact.

        Returns:
            The ground; None where nothing tells of it: fewer than two vehicles do not.
        """
        about = self._about(told, camera, world_T_camera)
        looked = about is None
        if about is None:
            vehicles.look(None)
            poses, self._past = vehicles.poses(), None
            seen = seen_ground(poses) if len(poses) > 1 else None
            if seen is None:
                return None
            about = _About(seen, camera, is_told=False)
        frame = GroundFrame.of(about.plane.normal, about.plane.distance)
        known, weight = self._before(time, about, frame, world_T_camera, motion_covariance)
        here = _ground(about, frame, known)
        if not looked:
            vehicles.look(about.plane if here is None else here.ground)
        evidence = vehicles.say(known.where, about.plane)
        if evidence is not None:
            said = evidence.said.scaled(weight)
            less, until_now = said.scaled(1.0 / evidence.common_factor), known
            both = _known(lambda: (_both(until_now.where, said), _both(until_now.counted, less)))
            known = both or known
        found = _ground(about, frame, known)
        self._past = None if found is None else _Past(time, about, frame, world_T_camera, known, found.ground, weight)
        return found

    def _before(
        self,
        time: float,
        about: _About,
        frame: GroundFrame,
        world_T_camera: gtsam.Pose3 | None,
        motion_covariance: Array | None,
    ) -> tuple[_Known, float]:
        """What is known of the ground of a frame before its vehicles speak, and by which share these count."""
        past = self._past
        if past is not None and (past.about.is_told or not about.is_told):
            seconds = time - past.time
            moved = _moved(past, seconds, frame, world_T_camera, about, motion_covariance)
            before = past.known
            known = _known(lambda: (_on_road(before.where, moved), _on_road(before.counted, moved)))
            if known is not None:
                return known, past.weight if seconds < AT_ONCE else min(seconds / _ALIKE, 1.0)
        # The first frame, or the camera has gone where no ground before tells of this one, or now it is told.
        values = gtsam.Values()
        values.insert(G(0), np.zeros(3))
        first = Marginal((G(0),), (3,), values, np.diag(1.0 / about.spread), np.zeros(3))
        return _Known(first, first), 1.0

    def _about(self, told: Ground | None, camera: Camera, world_T_camera: gtsam.Pose3 | None) -> _About | None:
        """About where the ground of the next frame is: as is told, else where it was; None where that is open."""
        past = self._past
        if told is not None:
            return _About(told, camera)
        if past is None:
            return None
        motion = _motion(past, world_T_camera)
        if motion is not None:
            here = replace(past.about.plane, normal=past.ground.normal, distance=past.ground.distance)
            plane = _carried(here, motion)
            return None if plane is None else _About(plane, camera, is_told=False)
        return replace(past.about, is_told=False) if np.array_equal(past.about.camera.matrix, camera.matrix) else None


def _moved(
    past: _Past,
    seconds: float,
    frame: GroundFrame,
    world_T_camera: gtsam.Pose3 | None,
    about: _About,
    covariance: Array | None,
) -> gtsam.CustomFactor:
    """What ties a frame's ground G(1) to the one before, G(0)."""
    motion = _motion(past, world_T_camera)
    kept = max(float(np.exp(-seconds / _LASTS)), _LEAST_KEPT) if about.is_told else 1.0
    changes = 1.0 - kept**2 if about.is_told else 2.0 * seconds / _FREE
    unsure = np.diag(changes * ground_spread(about.plane) ** 2)
    if motion is not None and covariance is not None:
        by_motion = np.zeros((3, 6))  # of height and slopes, in the camera's frame now
        by_motion[0, 3:], by_motion[1:, :3] = frame.normal, np.cross(frame.normal, frame.across)
        unsure = unsure + by_motion @ covariance @ by_motion.T
    return road_factor(G(0), G(1), (past.frame, frame), full_noise("road", unsure), motion, kept)


def _motion(past: _Past, world_T_camera: gtsam.Pose3 | None) -> gtsam.Pose3 | None:
    """How the camera has moved since the last frame; None where that is not known."""
    before = past.world_T_camera
    return None if before is None or world_T_camera is None else before.between(world_T_camera)


def _carried(plane: Ground, motion: gtsam.Pose3) -> Ground | None:
    """The plane as it is seen after a motion of the camera; None where that looks upside down."""
    normal = motion.rotation().matrix().T @ plane.normal
    if normal[1] <= LEAST_DOWN:
        return None
    distance = plane.distance - float(plane.normal @ motion.translation())
    return replace(plane, normal=normal, distance=max(distance, LEAST_HEIGHT))


def _known(make: Callable[[], tuple[Marginal, Marginal]]) -> _Known | None:
    """What is known after a step; None where the numbers leave it open."""
    try:
        found = _Known(*make())
        spreads = [_covariance(one) for one in (found.where, found.counted) if len(one.matrix) == 3]
    except FactorCallbackError:
        raise
    except (RuntimeError, np.linalg.LinAlgError):  # GTSAM's and numpy's signs of a system that determines nothing
        return None
    return found if len(spreads) == 2 and np.isfinite(spreads).all() else None


def _on_road(left: Marginal, moved: gtsam.CustomFactor) -> Marginal:
    """What is known of a frame's ground by those before."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values(left.values)
    graph.add(marginal_factor(left))
    graph.add(moved)
    values.insert(G(1), np.zeros(3))
    return _on_first(marginal(graph, _solved(graph, values), [G(0)]))


def _both(known: Marginal, said: Marginal) -> Marginal:
    """What is known of a ground by both."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(marginal_factor(known))
    graph.add(marginal_factor(said))
    values = _solved(graph, known.values)
    return marginal(graph, values, [])


def _solved(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    for _ in range(_ROUNDS):
        values = values.retract(graph.linearize(values).optimize())
    return values


def _on_first(left: Marginal) -> Marginal:
    """The same about G(0)."""
    values = gtsam.Values()
    values.insert(G(0), left.values.atVector(left.keys[0]))
    return Marginal((G(0),), left.dims, values, left.matrix, left.right)


def _ground(about: _About, frame: GroundFrame, known: _Known) -> KnownGround | None:
    """The plane, and how far a vehicle's origin may lie off it: as far as is told where nothing is known.

    None where the plane is no ground.
    """
    told, spread = about.plane, about.spread
    normal, distance = frame.plane(known.where.values.atVector(G(0)))
    if normal[1] <= LEAST_DOWN:
        return None
    covariance = _covariance(known.where)

    def variance(depth: float) -> float:
        across = np.array([-1.0, depth, 0.0])
        own, whole = _own_variance(told, depth), float(np.square(across * spread).sum())
        left = min(float(across @ covariance @ across) / whole, 1.0)
        return own + (whole - own) * left**2  # what is left of it counts less: it is mostly the same for all vehicles

    near, far = variance(_NEAR), variance(_FAR)
    least_height, least_slope = own_deviations(told, 1.0)
    slope = max((far - near) / (_FAR**2 - _NEAR**2), least_slope**2)
    height = max(near - slope * _NEAR**2, least_height**2)
    ground = replace(
        told,
        normal=normal,
        distance=max(distance, LEAST_HEIGHT),
        height_sigma=float(np.sqrt(height)),
        slope_sigma=float(np.sqrt(slope)),
    )
    return KnownGround(ground, told, _covariance(known.counted))


def _covariance(known: Marginal) -> Array:
    covariance: Array = np.linalg.inv(known.matrix.T @ known.matrix).astype(np.float64)
    return covariance


def _own_variance(told: Ground, depth: float) -> float:
    """Of a vehicle's origin off the ground, what is its own, square metres."""
    by_height, by_slope = own_deviations(told, depth)
    return by_height**2 + by_slope**2
