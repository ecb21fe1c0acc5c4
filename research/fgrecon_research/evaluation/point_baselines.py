"""Baselines of a vehicle's place from LiDAR points and a 2D box.

`MEDIAN` puts a vehicle where the median depth of the points in its 2D box is, and half its length farther; `CUBOID`
fits a cuboid of the fleet's size to those of the points that are near that depth and above the ground, by least squares
over its place on the ground and its yaw. Facing and, for the first, yaw are those of the picture alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

from fgrecon.calibration.labelled_boxes import BoxOutcome
from fgrecon.calibration.labelled_frames import ReconstructedFrame, ReconstructedVehicle, failed
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import yaw_rotation
from fgrecon.core.metrics import orientation_error, wrap_angle
from fgrecon.core.point_frames import in_image
from fgrecon.io.track_file import GroundTruth

MEDIAN, CUBOID = "median_depth", "fitted_cuboid"
"""Names of the baselines."""

_REACH = 4.0  # metres about the median depth in which points are the vehicle's
_FEET = 0.25  # metres above the ground below which points are the ground's
_LOSS = 0.1  # metres: farther points count less than their squares
_YAW = np.radians(5.0)  # that the picture's is trusted, 1 sigma; points alone turn cuboids by more
_FEWEST = 3  # points that a cuboid is fitted to


def score_baselines(solved: ReconstructedFrame, points: Array, suffix: str = "") -> list[Mapping[str, BoxOutcome]]:
    """The baselines on each labelled box of a frame; one without a point in its 2D box, or a pose, has failed.

    Args:
        solved: The boxes, and what was found in each by the picture alone.
        points: (N, 3) in the camera's frame, metres.
        suffix: Of the baselines' names: of points of another sensor than a LiDAR.
    """
    scored = [
        _score(solved, vehicle, in_box(points, solved.camera, _box(solved, vehicle))) for vehicle in solved.vehicles
    ]
    return [{f"{name}{suffix}": one for name, one in found.items()} for found in scored]


def in_box(points: Array, camera: Camera, box: Array) -> Array:
    """The points (N, 3) in the camera's frame that fall into a 2D box (4,)."""
    visible = points[in_image(points, camera)]
    pixels = camera.project(visible)
    return visible[np.all((pixels >= box[:2]) & (pixels <= box[2:]), axis=1)]


def _box(solved: ReconstructedFrame, vehicle: ReconstructedVehicle) -> Array:
    assert vehicle.label is not None
    return solved.frame.objects.box[vehicle.label]


def _score(solved: ReconstructedFrame, vehicle: ReconstructedVehicle, points: Array) -> Mapping[str, BoxOutcome]:
    found, prior = vehicle.found.result, solved.setup.size_prior
    if found is None or not len(points):
        return dict.fromkeys((MEDIAN, CUBOID), failed("no point in the 2D box" if found else "no pose by the picture"))
    size = prior.mean if prior is not None else found.box_size
    middle = by_median_depth(points, solved.camera, _box(solved, vehicle), size)
    place = middle + np.array([0.0, size[2] / 2.0, 0.0])
    labels, offset = solved.frame.objects, solved.frame.calibration.label_offset
    truth, labelled = solved.truth(vehicle), labels.size[vehicle.label]
    scored = {MEDIAN: pose_outcome(place - offset, found.rotation_y, size, truth, labelled)}
    bottom = float(found.location[1])  # of the picture: on its ground
    near = (np.abs(points[:, 2] - middle[2] + size[0] / 2.0) < _REACH) & (points[:, 1] < bottom - _FEET)
    if near.sum() < _FEWEST:
        return scored | {CUBOID: failed("too few points above the ground")}
    start = np.array([middle[0], bottom, middle[2]])
    place, yaw = fit_cuboid(points[near], start, found.rotation_y, size)
    return scored | {CUBOID: pose_outcome(place - offset, yaw, size, truth, labelled)}


def by_median_depth(points: Array, camera: Camera, box: Array, size: Array) -> Array:
    """(3,) the middle of a vehicle of a size (3,) whose points (N, 3) in its 2D box (4,) are its near side's."""
    ray = camera.rays([(box[:2] + box[2:]) / 2.0])[0]
    return np.asarray(ray * (float(np.median(points[:, 2])) + size[0] / 2.0))


def fit_cuboid(points: Array, location: Array, yaw: float, size: Array) -> tuple[Array, float]:
    """Place (3,) and yaw of a cuboid whose surface is nearest to points (N, 3); its height in the world stays.

    Args:
        points: In the camera's frame, metres.
        location: (3,) from where, the centre of the bottom face.
        yaw: From which, radians.
        size: (3,) length, width and height.
    """
    half = np.array([size[0], size[2], size[1]]) / 2.0  # along the object's x, y, z

    def distances(state: Array) -> Array:
        centre = np.array([state[0], location[1] - half[1], state[1]])
        inside = np.abs((points - centre) @ yaw_rotation(state[2])) - half
        outer = np.linalg.norm(np.maximum(inside, 0.0), axis=1)
        turned = _LOSS * wrap_angle(state[2] - yaw) / _YAW * np.sqrt(len(points))
        return np.append(outer + np.minimum(inside.max(axis=1), 0.0), turned)

    start = np.array([location[0], location[2], yaw])
    found = least_squares(distances, start, loss="cauchy", f_scale=_LOSS, x_scale=[1.0, 1.0, 0.2])
    x, z, angle = found.x.tolist()
    return np.array([x, location[1], z]), float(wrap_angle(angle))


def pose_outcome(location: Array, yaw: float, size: Array, truth: GroundTruth, labelled_size: Array) -> BoxOutcome:
    """How far a box is off that has no covariances.

    Args:
        location: (3,) estimated origin in the label's frame, metres.
        yaw: Estimated, radians.
        size: (3,) length, width and height.
        truth: Labelled place and yaw.
        labelled_size: (3,) the same of the label.
    """
    length, width, height = (size - labelled_size).tolist()
    x, y, z = (location - truth.location).tolist()
    return BoxOutcome(
        degrees=float(orientation_error([yaw], [truth.rotation_y])[0]),
        metres=float(np.linalg.norm(location - truth.location)),
        size=(length, width, height),
        status=None,
        failure=None,
        off=(float(np.degrees(wrap_angle(yaw - truth.rotation_y))), x, y, z),
    )
