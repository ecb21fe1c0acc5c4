"""Sample inputs, all simulated: a street with cars, one car over several images, and the scene of `fgrecon demo`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import transform
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.observation import Observation
from fgrecon.core.repr import brief_repr
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
from fgrecon.simulation.render import Body, Picture, render
from fgrecon.simulation.scenery import BODY_COLOURS, car_paint, planter, road, with_shadow
from fgrecon.simulation.vehicles import KITTI_CAMERA, SimulatedTruth, Vehicle, simulate, yaw_pose
from fgrecon.solve.vehicle.visibility import clearance

GROUND = Ground.level(1.65)
"""The road under KITTI's camera."""

LABEL_OFFSET = np.array([0.06, -0.0004, 0.0027])
"""A labelled point in the camera's frame is X + offset, metres; as in KITTI's calibrations."""

_POINTS, _ON_GROUND, _RANGE_SIGMA = 3e4, 2000, 0.02  # of a scan: on cars, for each steradian of theirs; metres
_AHEAD, _ONCOMING = -np.pi / 2, np.pi / 2
_PARKED = ((_ONCOMING + 0.35, -3.4, 11.0), (_AHEAD - 0.3, 2.9, 13.5), (_ONCOMING + 0.1, -10.5, 17.5))
"""Yaw in radians, x and z in metres of the street's cars."""
_FIRST, _STEP = np.array([-3.6, 0.0, 21.0]), np.array([0.02, 0.0, -1.3])
"""Where the track's car is at first, and how far it moves from one image to the next; metres."""


@dataclass(frozen=True)
class SeenCar:
    """A car as a network would report it, and the truth behind that."""

    observation: Observation
    truth: SimulatedTruth


@dataclass(frozen=True)
class SampleStreet:
    """A picture of cars.

    Attributes:
        image: (H, W, 3) RGB.
        camera: Its camera.
        cars: The cars.
    """

    image: NDArray[np.uint8]
    camera: Camera
    cars: tuple[SeenCar, ...]


def sample_street(prior: ShapePrior, seed: int = 0) -> SampleStreet:
    """Render three cars beside a road, none before another. The same seed gives the same bits.

    Args:
        prior: A prior with a surface.
        seed: Of shapes, places, keypoints and scenery.

    Raises:
        InvalidInputError: The prior has no surface.
    """
    rng = np.random.default_rng(seed)
    poses = []
    for yaw, x, z in _PARKED:
        away = rng.uniform(-0.3, 0.3, 2)
        poses.append(yaw_pose(yaw + rng.uniform(-0.1, 0.1), np.array([x + away[0], GROUND.distance, z + away[1]])))
    vehicles = [Vehicle.usual(prior, rng) for _ in poses]
    cars = tuple(_seen(vehicle, pose, rng) for vehicle, pose in zip(vehicles, poses, strict=True))
    colours = rng.permutation(list(BODY_COLOURS.values()))
    assert KITTI_CAMERA.image_size is not None
    background = road(KITTI_CAMERA, GROUND, KITTI_CAMERA.image_size, seed)
    return SampleStreet(_picture(vehicles, poses, colours, background), KITTI_CAMERA, cars)


def sample_scan(street: SampleStreet, seed: int = 0) -> NDArray[np.float64]:
    """(N, 3) points of a LiDAR at the camera, in its frame, metres: on the cars' sides that it sees, and on the ground.

    Args:
        street: What is there.
        seed: Of the points' places and noise.
    """
    rng = np.random.default_rng([seed, 3])
    scan = []
    for car in street.cars:
        truth = car.truth
        corners = transform(truth.camera_T_object, truth.vehicle.vertices)[truth.vehicle.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middles = corners.mean(axis=1)
        solid = np.maximum(-(normals * middles).sum(axis=1), 0.0) / np.linalg.norm(middles, axis=1) ** 3
        chosen = corners[rng.choice(len(solid), round(float(solid.sum()) * _POINTS), p=solid / solid.sum())]
        first, second = np.sort(rng.uniform(size=(2, len(chosen), 1)), axis=0)  # even in a triangle
        scan.append(first * chosen[:, 0] + (second - first) * chosen[:, 1] + (1.0 - second) * chosen[:, 2])
    angle, below = rng.uniform(-0.7, 0.7, _ON_GROUND), rng.uniform(0.05, 0.35, _ON_GROUND)
    away = GROUND.distance / below
    scan.append(np.stack([away * np.sin(angle), np.full(_ON_GROUND, GROUND.distance), away * np.cos(angle)], axis=1))
    points = np.concatenate(scan)
    noise: NDArray[np.float64] = 1.0 + _RANGE_SIGMA * rng.normal(size=(len(points), 1)) / np.linalg.norm(
        points, axis=1, keepdims=True
    )
    return points * noise


def sample_track(prior: ShapePrior, frames: int = 8, seed: int = 0) -> list[SeenCar]:
    """One car that comes nearer, in every image once more observed. The same seed gives the same bits.

    Args:
        prior: A prior with a surface.
        frames: Number of images, at most 10.
        seed: Of shape and keypoints.

    Raises:
        InvalidInputError: The prior has no surface.
    """
    rng = np.random.default_rng([seed, 1])
    vehicle, turn = Vehicle.usual(prior, rng), rng.uniform(-0.1, 0.1)
    places = [_FIRST + number * _STEP + [0.0, GROUND.distance, 0.0] for number in range(frames)]
    return [_seen(vehicle, yaw_pose(_ONCOMING + turn, place), rng) for place in places]


def sample_drive(prior: ShapePrior, frames: int = 8, seed: int = 0) -> list[SampleStreet]:
    """The images of `sample_track`, ten a second, rendered by a camera that stands. The same seed gives the same bits.

    Args:
        prior: A prior with a surface.
        frames: Number of images, at most 10.
        seed: Of shape, keypoints and scenery.

    Raises:
        InvalidInputError: The prior has no surface.
    """
    assert KITTI_CAMERA.image_size is not None
    background = road(KITTI_CAMERA, GROUND, KITTI_CAMERA.image_size, seed)
    colours = np.random.default_rng(seed).permutation(list(BODY_COLOURS.values()))
    return [
        SampleStreet(_picture([c.truth.vehicle], [c.truth.camera_T_object], colours, background), KITTI_CAMERA, (c,))
        for c in sample_track(prior, frames, seed)
    ]


def disturbed_boxes(boxes: Sequence[Box3D], camera: Camera, errors: BoxErrors, rng: np.random.Generator) -> list[Box3D]:
    """True boxes, disturbed: farther or nearer on their rays, seen some pixels aside, turned, some of them round.

    Args:
        errors: How far a detector's are off.
    """
    found = []

    def draw(count: int) -> NDArray[np.float64]:
        """Standard deviations, within 3: where errors are large a box would be behind the camera."""
        return np.clip(rng.standard_normal(count), -3.0, 3.0)

    for box in boxes:
        ray = box.location / box.location[2]
        ray[:2] += errors.bearing * rng.standard_normal(2) / camera.matrix.diagonal()[:2]
        depth = box.location[2] * (1.0 + errors.depth * draw(1)[0])
        turn = errors.yaw * rng.standard_normal() + np.pi * (rng.random() < errors.flip_probability)
        size = None if box.size is None else box.size * (1.0 + errors.size * draw(3))
        found.append(Box3D(ray * depth, float(wrap_angle(box.rotation_y + turn)), size))
    return found


def _seen(vehicle: Vehicle, camera_T_object: NDArray[np.float64], rng: np.random.Generator) -> SeenCar:
    return SeenCar(*simulate(vehicle, KITTI_CAMERA, camera_T_object, rng, HOURGLASS))


def _picture(
    vehicles: Sequence[Vehicle],
    poses: Sequence[NDArray[np.float64]],
    colours: NDArray[np.float64],
    background: NDArray[np.float64],
) -> NDArray[np.uint8]:
    bodies = []
    for vehicle, pose, colour in zip(vehicles, poses, colours, strict=False):
        red, green, blue = colour.tolist()
        body, background = _standing(vehicle, pose, (red, green, blue), KITTI_CAMERA, background)
        bodies.append(body)
    return render(bodies, KITTI_CAMERA, background).image


def _standing(
    vehicle: Vehicle,
    pose: NDArray[np.float64],
    colour: tuple[float, float, float],
    camera: Camera,
    background: NDArray[np.float64],
) -> tuple[Body, NDArray[np.float64]]:
    """A painted car, and the background with its shadow."""
    length, width = np.ptp(vehicle.vertices[:, [0, 2]], axis=0)
    paint = car_paint(vehicle.keypoints, vehicle.category.keypoints, colour)
    body = Body(vehicle.vertices, vehicle.faces, paint, pose)
    return body, with_shadow(background, camera, pose, length, width)


_DEMO_SIZE = (960, 540)
_DEMO_CAMERA = Camera(np.array([[900.0, 0.0, 479.5], [0.0, 900.0, 229.5], [0.0, 0.0, 1.0]]), image_size=_DEMO_SIZE)
_CAMERA_HEIGHT = 1.65
_PLANTER = (1.2, 0.4, 0.58)
_PLANTER_GAP = 1.0
"""Length, width and height of the planter, and its distance from the wheel that it hides; metres."""


@dataclass(frozen=True)
class DemoScene:
    """A rendered scene with known truth.

    Attributes:
        picture: The image, with depth and which body each pixel shows (0 the car, 1 the planter).
        camera: Its camera.
        ground: The ground plane under it.
        observation: Keypoints as a network would report them, and the 2D box of the car.
        truth: What they were made from.
    """

    picture: Picture
    camera: Camera
    ground: Ground
    observation: Observation
    truth: SimulatedTruth

    __repr__ = brief_repr


def demo_scene(prior: ShapePrior, seed: int = 0, noise: NoiseModel = HOURGLASS) -> DemoScene:
    """Render a random car of the prior on a road and observe it.

    The car is seen from an angle at 8 to 10 m; a planter hides the wheel that is nearest to the camera. The same seed
    gives the same bits.

    Args:
        prior: A prior with a surface.
        seed: Of everything.
        noise: The network's mistakes.

    Raises:
        InvalidInputError: The prior has no surface.
    """
    rng = np.random.default_rng(seed)
    vehicle = Vehicle.usual(prior, rng)
    ground = Ground.level(_CAMERA_HEIGHT)
    yaw = float(rng.choice([-1.0, 1.0])) * (np.pi / 2 + rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(25.0, 55.0)))
    pose = yaw_pose(yaw, np.array([rng.uniform(-0.8, 0.8), _CAMERA_HEIGHT, rng.uniform(8.0, 10.0)]))
    planter_pose = _before_nearest_wheel(vehicle, pose)
    box_vertices, box_faces, box_paint = planter(*_PLANTER, seed)

    to_planter = np.linalg.inv(planter_pose) @ pose
    keypoints = transform(to_planter, vehicle.keypoints)
    centre = -planter_pose[:3, :3].T @ planter_pose[:3, 3]
    hidden = clearance(box_vertices, box_faces, keypoints, centre) > 0.0
    observation, truth = simulate(vehicle, _DEMO_CAMERA, pose, rng, noise, hidden)

    colour = list(BODY_COLOURS.values())[rng.integers(len(BODY_COLOURS))]
    body, background = _standing(vehicle, pose, colour, _DEMO_CAMERA, road(_DEMO_CAMERA, ground, _DEMO_SIZE, seed))
    background = with_shadow(background, _DEMO_CAMERA, planter_pose, _PLANTER[0], _PLANTER[1])
    bodies = [body, Body(box_vertices, box_faces, box_paint, planter_pose)]
    return DemoScene(render(bodies, _DEMO_CAMERA, background), _DEMO_CAMERA, ground, observation, truth)


def _before_nearest_wheel(vehicle: Vehicle, camera_T_object: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose (4, 4) on the ground between the camera and the nearest ground keypoint, broadside to the camera."""
    ground = vehicle.keypoints[list(vehicle.category.ground_keypoints)] * np.array([1.0, 0.0, 1.0])
    wheels = transform(camera_T_object, ground)
    wheel = wheels[wheels[:, 2].argmin()]
    away = np.array([wheel[0], 0.0, wheel[2]]) / np.hypot(wheel[0], wheel[2])
    return yaw_pose(float(np.arctan2(away[0], away[2])), wheel - _PLANTER_GAP * away)
