"""A worker's part of label correction: where the graph disagrees, and the labels as they are saved."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgrecon.app.picture_editor import hand_variance
from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded, solve
from fgrecon.batch.solve_tasks import Outcome
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform, view_azimuth
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.coco_keypoints import LabelledImage, VehicleLabel

_STATED = 0.1  # weight below which a keypoint is named


@dataclass(frozen=True)
class Judgement:
    """What the graph says of the keypoints of an image."""

    disagreement: float  # about how many keypoints of its worst car the graph disagrees with; all of one without a pose
    words: str  # which they are


def judge(folder: Path, uploaded: Uploaded, requested: Requested) -> Judgement:
    """What the graph disagrees with in a photograph, of given keypoints or of those that the networks detect."""
    try:
        outcomes = solve(folder, uploaded, requested, history=False).outcomes
    except InvalidInputError as error:
        if error.field == "detect":
            return Judgement(0.0, "no car detected")
        raise
    return max((judged(outcome) for outcome in outcomes), key=lambda one: one.disagreement)


def judged(outcome: Outcome) -> Judgement:
    """What the graph disagrees with in a car."""
    result, trust = outcome.result, _trust(outcome)
    if result is None or not result.status.determined:
        return Judgement(float(np.count_nonzero(trust)), f"{outcome.name}: no pose")
    weights = np.nan_to_num(result.diagnostics.weights)
    names = np.array(result.shape.keypoint_names)[(trust > 0) & (weights < _STATED)]
    words = ", ".join(name.replace("_", " ") for name in names)
    return Judgement(float((trust * (1.0 - weights)).sum()), f"{outcome.name}: {words or 'all fits'}")


def labels_of(folder: Path, uploaded: Uploaded, requested: Requested) -> tuple[list[VehicleLabel], list[str]]:
    """The labels of a photograph: given keypoints are visible, all others hidden, where the graph says they are.

    Returns:
        The labels, of an image of the uploaded file's name; and the names of cars that have none, for want of a pose.
    """
    outcomes = solve(folder, uploaded, requested, history=False).outcomes
    name = uploaded.photograph or uploaded.main
    labels, without = [], []
    for number, outcome in enumerate(outcomes):
        if outcome.result is None or not outcome.result.status.determined:
            without.append(outcome.name)
        else:
            labels.append(_label(outcome, outcome.result, Path(name), number))
    return labels, without


def _trust(outcome: Outcome) -> Array:
    """(K,) confidence of the keypoints that are rather right than wrong; 0 of the others."""
    given = outcome.task.instance
    measured = np.isfinite(given.keypoints).all(axis=1)
    confidence = measured.astype(np.float64) if given.confidence is None else np.nan_to_num(given.confidence)
    midpoint = given.confidence_midpoint or Observation.confidence_midpoint
    return np.where(measured & (confidence >= midpoint), confidence, 0.0)


def _label(outcome: Outcome, result: Reconstruction, image: Path, number: int) -> VehicleLabel:
    given, camera, pose = outcome.task.instance, outcome.task.camera, result.camera_T_object
    trust = _trust(outcome)
    given_by_hand, weights = trust > 0, np.nan_to_num(result.diagnostics.weights)
    corners = transform(pose, box_corners(result.box_size))
    width, height = camera.image_size or (0, 0)
    points = result.pose.wireframe_uv
    box = given.box if given.box is not None else np.concatenate([np.nanmin(points, axis=0), np.nanmax(points, axis=0)])
    hand = hand_variance(box.tolist()) * np.eye(2)
    exact = np.broadcast_to(hand, (len(given_by_hand), 2, 2)) if given.covariance is None else given.covariance
    return VehicleLabel(
        image=LabelledImage(image, (width, height), camera.matrix, "", 0),
        track=number if given.track is None else given.track,
        kind=given.kind or "Car",
        box=box,
        keypoints=np.where(given_by_hand[:, None], given.keypoints, points),
        probability=given_by_hand.astype(np.float64),
        covariance=np.where(given_by_hand[:, None, None], exact, _projected(result, camera)),
        corners=_pixels(camera, corners),
        location=result.location,
        rotation_y=float(result.rotation_y),
        size=result.box_size,
        azimuth=float(view_azimuth(pose[:3, :3], pose[:3, 3])),
        agreement=float((trust * weights).sum() / max(trust.sum(), 1e-9)),
        boxed=False,
    )


def _pixels(camera: Camera, points: Array) -> Array:
    """(N, 2) of points (N, 3) in the camera's frame; NaN behind the camera."""
    pixels = np.full((len(points), 2), np.nan)
    ahead = points[:, 2] > MIN_DEPTH
    pixels[ahead] = camera.distort(camera.project(points[ahead]))
    return pixels


def _projected(result: Reconstruction, camera: Camera) -> Array:
    """(K, 2, 2) of the projected wireframe, square pixels: pose and shape taken for independent."""
    about, points = result.uncertainty, result.wireframe
    rotation, depth = result.camera_T_object[:3, :3], transform(result.camera_T_object, points)
    x, y, z = np.clip(depth, [-np.inf, -np.inf, MIN_DEPTH], np.inf).T
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    zero = np.zeros_like(z)
    across, down = np.stack([fx / z, zero, -fx * x / z**2], -1), np.stack([zero, fy / z, -fy * y / z**2], -1)
    to_pixels = np.stack([across, down], 1) @ rotation
    a, b, c = points.T
    turns = np.stack([np.stack([zero, c, -b], -1), np.stack([-c, zero, a], -1), np.stack([b, -a, zero], -1)], 1)
    moves = np.concatenate([turns, np.broadcast_to(np.eye(3), turns.shape)], axis=2)
    spread = np.zeros((len(points), 3, 3))
    if about.keypoint_covariance is not None:
        spread = spread + about.keypoint_covariance
    if about.pose_covariance is not None:
        spread = spread + moves @ about.pose_covariance @ np.swapaxes(moves, 1, 2)
    return to_pixels @ spread @ np.swapaxes(to_pixels, 1, 2)
