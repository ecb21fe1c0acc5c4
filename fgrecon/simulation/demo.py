"""The scene of `fgrecon demo`: one simulated car on a road, partly behind a planter.

With it come its keypoints as a network would report them, and the truth behind them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.core.repr import brief_repr
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel
from fgrecon.simulation.render import Body, Picture, render
from fgrecon.simulation.scenery import BODY_COLOURS, car_paint, planter, road, with_shadow
from fgrecon.simulation.vehicles import SimulatedTruth, Vehicle, simulate, yaw_pose
from fgrecon.solve.vehicle.visibility import clearance

_IMAGE_SIZE = (960, 540)
_CAMERA = Camera(np.array([[900.0, 0.0, 479.5], [0.0, 900.0, 229.5], [0.0, 0.0, 1.0]]), image_size=_IMAGE_SIZE)
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
    observation, truth = simulate(vehicle, _CAMERA, pose, rng, noise, hidden)

    colour = list(BODY_COLOURS.values())[rng.integers(len(BODY_COLOURS))]
    length, width = np.ptp(vehicle.vertices[:, [0, 2]], axis=0)
    background = road(_CAMERA, ground, _IMAGE_SIZE, seed)
    background = with_shadow(background, _CAMERA, pose, length, width)
    background = with_shadow(background, _CAMERA, planter_pose, _PLANTER[0], _PLANTER[1])
    paint = car_paint(vehicle.keypoints, prior.category.keypoints, colour)
    bodies = [
        Body(vehicle.vertices, vehicle.faces, paint, pose),
        Body(box_vertices, box_faces, box_paint, planter_pose),
    ]
    return DemoScene(render(bodies, _CAMERA, background), _CAMERA, ground, observation, truth)


def _before_nearest_wheel(vehicle: Vehicle, camera_T_object: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose (4, 4) on the ground between the camera and the nearest ground keypoint, broadside to the camera."""
    ground = vehicle.keypoints[list(vehicle.category.ground_keypoints)] * np.array([1.0, 0.0, 1.0])
    wheels = transform(camera_T_object, ground)
    wheel = wheels[wheels[:, 2].argmin()]
    away = np.array([wheel[0], 0.0, wheel[2]]) / np.hypot(wheel[0], wheel[2])
    return yaw_pose(float(np.arctan2(away[0], away[2])), wheel - _PLANTER_GAP * away)
