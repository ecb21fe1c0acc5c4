"""Simulated vehicles with known truth: poses, keypoints as a network would report them, scenes to draw.

Whatever is shown from here is to be called simulated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around, rigid, yaw_rotation
from fgrecon.core.observation import Observation
from fgrecon.core.repr import brief_repr
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.simulation.keypoint_noise import HOURGLASS, OUTLIER, NoiseModel, Twins
from fgrecon.solve.vehicle.visibility import TOLERANCE, clearance

KITTI_CAMERA = Camera(
    np.array([[721.5377, 0.0, 609.5593], [0.0, 721.5377, 172.854], [0.0, 0.0, 1.0]]), image_size=(1242, 375)
)
"""The colour camera of KITTI's training drives."""
_KITTI_HEIGHT = 1.65


_USUAL = 1.2
"""Standard deviations that coefficients are kept within, for a vehicle that looks like a car."""


@dataclass(frozen=True)
class Vehicle:
    """A shape to simulate.

    Attributes:
        category: Its category.
        keypoints: (K, 3) keypoints, object frame, metres.
        vertices: (V, 3) surface, object frame, metres.
        faces: (F, 3) its triangles, counter-clockwise as seen from outside.
        coefficients: (N,) lambda that made it, or None where no prior did.
    """

    category: Category
    keypoints: NDArray[np.float64]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    coefficients: NDArray[np.float64] | None = None

    __repr__ = brief_repr

    @classmethod
    def of_prior(cls, prior: ShapePrior, coefficients: ArrayLike) -> Vehicle:
        """The prior's shape at the coefficients (N,); the prior needs a surface."""
        if prior.surface is None:
            raise InvalidInputError("prior.surface", None, "Use a prior with a surface.")
        values = np.asarray(coefficients, dtype=np.float64)
        return cls(prior.category, prior.keypoints(values), prior.surface.vertices(values), prior.surface.faces, values)

    @classmethod
    def usual(cls, prior: ShapePrior, rng: np.random.Generator) -> Vehicle:
        """A random shape of the prior that looks like a car: coefficients are kept within `_USUAL`."""
        return cls.of_prior(prior, np.clip(rng.standard_normal(prior.dimension), -_USUAL, _USUAL))

    @classmethod
    def sample(cls, prior: ShapePrior, rng: np.random.Generator) -> Vehicle:
        """A random shape of the prior, lambda ~ N(0, I)."""
        return cls.of_prior(prior, rng.standard_normal(prior.dimension))


@dataclass(frozen=True)
class SimulatedTruth:
    """What a simulated observation was made from.

    Attributes:
        camera_T_object: (4, 4) pose.
        vehicle: The shape.
        projections: (K, 2) true pixels of every keypoint.
        visible: (K,) whether each keypoint can be seen.
        outlier: (K,) whether each measurement is farther than `OUTLIER` of the box extent from the truth.
        box: (4,) true 2D box of the surface, x1, y1, x2, y2 in pixels, cut at the image border.
    """

    camera_T_object: NDArray[np.float64]
    vehicle: Vehicle
    projections: NDArray[np.float64]
    visible: NDArray[np.bool_]
    outlier: NDArray[np.bool_]
    box: NDArray[np.float64]

    __repr__ = brief_repr


def simulate(
    vehicle: Vehicle,
    camera: Camera,
    camera_T_object: NDArray[np.float64],
    rng: np.random.Generator,
    noise: NoiseModel = HOURGLASS,
    hidden: NDArray[np.bool_] | None = None,
) -> tuple[Observation, SimulatedTruth]:
    """Observe a vehicle as a keypoint network would.

    Args:
        vehicle: The shape.
        camera: The camera; its lens distortion is applied.
        camera_T_object: (4, 4) true pose.
        rng: Source of randomness.
        noise: The network's mistakes.
        hidden: (K,) keypoints that something else hides, beside those that the vehicle itself hides.

    Returns:
        The observation (keypoints, confidences, 2D box) and the truth behind it.

    Raises:
        InvalidInputError: The vehicle is not wholly in front of the camera, or outside the image.
    """
    rotation, translation = camera_T_object[:3, :3], camera_T_object[:3, 3]
    points = vehicle.keypoints @ rotation.T + translation
    surface = vehicle.vertices @ rotation.T + translation
    if min(points[:, 2].min(), surface[:, 2].min()) <= 0.1:
        raise InvalidInputError("camera_T_object", translation.tolist(), "Put the vehicle in front of the camera.")
    projections = camera.distort(camera.project(points))
    outline = camera.distort(camera.project(surface))
    limit = np.array(camera.image_size or (np.inf, np.inf), dtype=np.float64) - 1.0
    lowest = 0.0 if camera.image_size else -np.inf
    box = box_around(outline)
    measured_box = box + noise.box_sigma * rng.standard_normal(4)
    box, measured_box = (np.clip(b.reshape(2, 2), lowest, limit).ravel() for b in (box, measured_box))
    if not (np.diff(measured_box.reshape(2, 2), axis=0) >= 2.0).all():
        raise InvalidInputError("camera_T_object", translation.tolist(), "Put the vehicle inside the image.")

    centre = -rotation.T @ translation
    visible = clearance(vehicle.vertices, vehicle.faces, vehicle.keypoints, centre) <= TOLERANCE
    visible &= ((projections >= lowest) & (projections <= limit)).all(axis=1)
    if hidden is not None:
        visible &= ~hidden
    if rng.random() < noise.covered:
        visible &= ~_covered(projections[:, 0], box, rng)
    pixels, confidence = noise.measure(projections, visible, measured_box, Twins.of(vehicle.category), rng)
    extent = float(max(box[2] - box[0], box[3] - box[1]))
    outlier = np.linalg.norm(pixels - projections, axis=1) > OUTLIER * extent
    truth = SimulatedTruth(camera_T_object, vehicle, projections, visible, outlier, box)
    return Observation(pixels, confidence, measured_box), truth


def simulate_track(
    vehicle: Vehicle,
    frames: int,
    rng: np.random.Generator,
    noise: NoiseModel = HOURGLASS,
    camera: Camera = KITTI_CAMERA,
) -> list[tuple[Observation, SimulatedTruth]]:
    """Observe one vehicle in consecutive frames, ten a second, until it leaves the image or is nearer than 5 m.

    Seen from the camera, it moves along its heading at a constant speed of up to 10 m/s and turns a little. The noise
    of one frame knows nothing of the others' (a real network's does: about half of its variance is common to a track).
    """
    pose = kitti_like_pose(rng, camera)
    turn = _rotation(1, np.radians(rng.normal(0.0, 0.5)))
    step = rigid(turn, (rng.uniform(-1.0, 1.0), 0.0, 0.0))
    track: list[tuple[Observation, SimulatedTruth]] = []
    while len(track) < frames and pose[2, 3] > 5.0:
        try:
            track.append(simulate(vehicle, camera, pose, rng, noise))
        except InvalidInputError:
            break
        pose = pose @ step
    return track


def _covered(u: NDArray[np.float64], box: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.bool_]:
    share = rng.uniform(0.1, 0.6)
    border = box[0] + (box[2] - box[0]) * (share if rng.random() < 0.5 else 1.0 - share)
    return np.asarray(u < border if border < 0.5 * (box[0] + box[2]) else u > border)


def kitti_like_pose(rng: np.random.Generator, camera: Camera = KITTI_CAMERA) -> NDArray[np.float64]:
    """A pose (4, 4) as cars of KITTI's tracking labels have them.

    Depth is uniform in 8-45 m; x / z is normal with deviation 0.33, kept inside the image; 78 % drive along the road
    (yaw +-90 degrees with a Laplace spread of 3 degrees), the others stand at any yaw. The camera is 1.65 m above a
    ground that tilts by 0.7 degrees in pitch and 0.5 in roll (from the spread of the labels' heights).
    """
    depth = rng.uniform(8.0, 45.0)
    width = camera.image_size[0] if camera.image_size is not None else 2.0 * camera.matrix[0, 2]
    edges = (np.array([0.0, width]) - camera.matrix[0, 2]) / camera.matrix[0, 0] * depth
    lateral = float(np.clip(0.33 * depth * rng.standard_normal(), edges[0] + 2.0, edges[1] - 2.0))
    yaw = float(rng.choice([-1, 1])) * np.pi / 2 + np.radians(rng.laplace(0.0, 3.0))
    if rng.random() < 0.22:
        yaw = rng.uniform(-np.pi, np.pi)
    pitch, roll = np.radians([0.7, 0.5]) * rng.standard_normal(2)
    level = yaw_pose(yaw, np.array([lateral, _KITTI_HEIGHT, depth]))
    return rigid(_rotation(0, pitch) @ _rotation(2, roll), 0.0) @ level


def yaw_pose(yaw: float, location: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose (4, 4) of a level vehicle from KITTI's rotation_y in radians and its location (3,) in metres."""
    return rigid(yaw_rotation(yaw), location)


def _rotation(axis: int, angle: float) -> NDArray[np.float64]:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix
