"""Simulated keypoints on the real poses of KITTI's labelled cars.

Real are the frames, cameras, poses, sizes, occlusion levels and the detector's 2D boxes. Simulated are the shape (one
of the 79 car models, drawn at random and scaled per axis to the labelled size) and the keypoints with their confidences
(`fgrecon.simulation.keypoint_noise`, fitted to what a real network did). A keypoint is hidden where the car's own
surface, another labelled object, or the border of the image hides it. Whatever comes from here is to be called
simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import match_detections
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.observation import Observation
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.kitti_files import Objects
from fgrecon.simulation.keypoint_noise import HOURGLASS, NoiseModel, Twins
from fgrecon.simulation.vehicles import Vehicle, yaw_pose
from fgrecon.solve.vehicle.visibility import TOLERANCE, clearance
from fgrecon_research.evaluation.kitti_devkit import counted_cars

Mask = NDArray[np.bool_]

_SOLID = 0.9
"""An object fills its labelled box to about this share of each side."""

_NEAREST = 0.3
"""Points nearer to the camera than this, in metres, are imaged as if they were there."""


@dataclass(frozen=True)
class SimulatedInstance:
    """One labelled car that counts in some regime."""

    frame: str  # name of the frame
    index: int  # position in the frame's label file
    regimes: Mask  # (3,) whether Easy, Moderate and Hard count it
    camera: Camera  # the colour camera
    label_offset: Array  # (3,) a labelled point in the camera's frame is X + label_offset, metres
    camera_T_object: Array  # (4, 4) true pose in the camera's frame
    rotation_y: float  # labelled yaw, radians
    keypoints: Array  # (K, 3) true keypoints, object frame, metres
    projections: Array  # (K, 2) their true pixels
    visible: Mask  # (K,) which of them can be seen
    detection: int  # position of its detection among the frame's, or -1: no detection overlaps enough
    observation: Observation | None  # simulated keypoints and the detected box; None without a detection


@dataclass(frozen=True)
class Fleet:
    """What is simulated: shapes to draw from, the network's mistakes, and the seed of the whole run."""

    vehicles: Sequence[Vehicle]  # shapes
    sizes: Array  # (len(vehicles), 3) length, width and height of their boxes, metres
    noise: NoiseModel = HOURGLASS  # the network's mistakes
    seed: int = 0


@dataclass(frozen=True)
class KittiFrame:
    """What KITTI has of one image: its name (a number), labels, detections and camera."""

    name: str
    labels: Objects
    detections: Objects
    calibration: KittiCalibration


def simulate_frame(frame: KittiFrame, fleet: Fleet) -> list[SimulatedInstance]:
    """Simulate every car of a frame that counts in some regime.

    What an instance looks like depends on the seed, the frame's name and its place in the label file alone, so the
    order in which frames are worked on does not matter.
    """
    chosen, regimes = counted_cars(frame.labels)
    found = match_detections(frame.labels.take(chosen), frame.detections)
    each = zip(chosen.tolist(), regimes, found.tolist(), strict=True)
    return [_instance(frame, fleet, *one) for one in each]


def _instance(frame: KittiFrame, fleet: Fleet, index: int, regimes: Mask, detection: int) -> SimulatedInstance:
    labels, camera, offset = frame.labels, frame.calibration.camera, frame.calibration.label_offset
    rng = np.random.default_rng([fleet.seed, int(frame.name), index])
    pose = yaw_pose(float(labels.rotation_y[index]), labels.location[index] + offset)
    model = int(rng.integers(len(fleet.vehicles)))
    vehicle = _scaled(fleet.vehicles[model], labels.size[index] / fleet.sizes[model])
    points = transform(pose, vehicle.keypoints)
    projections = camera.project(np.column_stack([points[:, :2], np.maximum(points[:, 2], _NEAREST)]))
    centre = -pose[:3, :3].T @ pose[:3, 3]
    visible = clearance(vehicle.vertices, vehicle.faces, vehicle.keypoints, centre) <= TOLERANCE
    others = np.array([kind != "DontCare" for kind in labels.kind], dtype=bool)
    others[index] = False
    visible &= (points[:, 2] > _NEAREST) & ~hidden_by_boxes(points - offset, labels.take(others), -offset)
    if camera.image_size is not None:
        limit = np.array(camera.image_size, dtype=np.float64) - 1.0
        visible &= np.all((projections >= 0.0) & (projections <= limit), axis=1)
    observation = None
    if detection >= 0:
        box = frame.detections.box[detection]
        pixels, confidence = fleet.noise.measure(projections, visible, box, Twins.of(vehicle.category), rng)
        observation = Observation(pixels, confidence, box)
    return SimulatedInstance(
        frame=frame.name,
        index=index,
        regimes=regimes,
        camera=camera,
        label_offset=offset,
        camera_T_object=pose,
        rotation_y=float(labels.rotation_y[index]),
        keypoints=vehicle.keypoints,
        projections=projections,
        visible=visible,
        detection=detection,
        observation=observation,
    )


def _scaled(vehicle: Vehicle, factors: Array) -> Vehicle:
    """The vehicle with length, width and height multiplied."""
    scale = factors[[0, 2, 1]]
    return Vehicle(vehicle.category, vehicle.keypoints * scale, vehicle.vertices * scale, vehicle.faces)


def hidden_by_boxes(points: Array, objects: Objects, centre: Array) -> Mask:
    """(P,) whether the line of sight from a centre (3,) to each point (P, 3) passes through an object's box.

    Points, centre and objects are in the frame of the labels, metres. Boxes are shrunk to `_SOLID`, as vehicles do not
    fill them.
    """
    hidden = np.zeros(len(points), dtype=bool)
    for i in range(len(objects)):
        cosine, sine = np.cos(objects.rotation_y[i]), np.sin(objects.rotation_y[i])
        to_object = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
        length, width, height = objects.size[i]
        middle = objects.location[i] - [0.0, height / 2.0, 0.0]
        half = _SOLID * np.array([length, height, width]) / 2.0
        start, end = to_object @ (centre - middle), (points - middle) @ to_object.T
        direction = end - start
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-half - start) / direction, (half - start) / direction
        enter = np.fmax.reduce(np.fmin(first, second), axis=1)
        leave = np.fmin.reduce(np.fmax(first, second), axis=1)
        hidden |= (enter < np.minimum(leave, 1.0)) & (leave > 0.0)
    return hidden
