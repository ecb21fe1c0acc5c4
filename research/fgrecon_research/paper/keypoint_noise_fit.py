"""Fits a `NoiseModel` to keypoints that a network found on vehicles of known pose and size.

The true shape of such vehicles is not known, so each track gets one: the prior is scaled to the labelled box, and its
coefficients are fitted to the confident keypoints of all frames at the labelled poses. What the fit leaves is the noise
(about half of its variance is common to the frames of a track, which the model does not express).

The constants of `fgrecon.simulation.keypoint_noise.HOURGLASS` are what this returns for the 76 frames of the three
tracks in `kitti_tracking_keypoints14` with the prior `car14`:

    prior = load_prior("car14")
    fit_noise_model([read_vehicle(path, prior.category) for path in sorted(folder.glob("*.json"))], prior)
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.track_file import read_track
from fgrecon.simulation.keypoint_noise import OUTLIER, NoiseModel, Twins
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.solve.vehicle.visibility import TOLERANCE, clearance

_CONFIDENT = 0.3
_PIXEL_SIGMA = 0.02
_SIZE_SIGMA = 0.02


@dataclass(frozen=True)
class PosedVehicle:
    """One vehicle in several images, at labelled poses."""

    camera: Camera
    observations: tuple[Observation, ...]  # F observations, each with a box
    camera_T_object: NDArray[np.float64]  # (F, 4, 4) labelled poses
    box_size: NDArray[np.float64]  # (3,) labelled length, width and height, metres


@dataclass(frozen=True)
class Residuals:
    """What a network's keypoints differ from the truth, for F frames of K keypoints."""

    # (F, K, 2) measured minus true pixels, in units of the box extent; NaN where not measured
    errors: NDArray[np.float64]
    confidence: NDArray[np.float64]  # (F, K)
    visible: NDArray[np.bool_]  # (F, K) whether the vehicle itself does not hide the keypoint
    # (F, K, 3) distance from each measurement to the true places of its rotated twin, mirror image and swapped twin, in
    # units of the box extent
    places: NDArray[np.float64]
    # (F, K) distance to the nearest measurement of another keypoint that was found, in the same units
    nearest: NDArray[np.float64]


def read_vehicle(path: Path, category: Category) -> PosedVehicle:
    """Read a track file (format: `fgrecon.io.track_file`) whose labels also give the vehicle's size.

    Raises:
        InvalidInputError: The file is not such a track, or a frame has no keypoints or box.
    """
    track = read_track(path, category)
    labels = json.loads(path.read_text(encoding="utf-8"))["frames"]
    poses = [yaw_pose(f.truth.rotation_y, f.truth.location + track.label_offset) for f in track.frames]
    observations = tuple(
        f.observation for f in track.frames if f.observation is not None and f.observation.box is not None
    )
    if len(observations) != len(poses):
        raise InvalidInputError(str(path), "a frame without keypoints or box", "Give both for every frame.")
    try:
        size = np.array([float(labels[0]["gt"][name]) for name in ("length", "width", "height")])
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(f"{path}: gt", str(error), "Give length, width and height in metres.") from error
    return PosedVehicle(track.camera, observations, np.array(poses), size)


def residuals(vehicle: PosedVehicle, prior: ShapePrior) -> Residuals:
    """Fit a shape to the vehicle at its labelled poses and return what the keypoints differ from it.

    Raises:
        InvalidInputError: The prior has no surface.
    """
    scaled = prior.for_fleet(SizePrior("label", vehicle.box_size, _SIZE_SIGMA * vehicle.box_size))
    if scaled.surface is None:
        raise InvalidInputError("prior.surface", None, "Use a prior with a surface.")
    pixels = np.array([o.keypoints for o in vehicle.observations])
    confidence = np.array([o.confidence for o in vehicle.observations])
    extent = np.array([o.extent for o in vehicle.observations])[:, None, None]
    rotation, translation = vehicle.camera_T_object[:, :3, :3], vehicle.camera_T_object[:, None, :3, 3]
    weight = np.sqrt(np.where(confidence > _CONFIDENT, confidence, 0.0))[..., None]

    def project(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        points = np.einsum("fij,kj->fki", rotation, scaled.keypoints(coefficients)) + translation
        return vehicle.camera.project(points)

    def cost(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        data = np.nan_to_num((project(coefficients) - pixels) / extent) * weight / _PIXEL_SIGMA
        size = (scaled.box_size(coefficients) / vehicle.box_size - 1.0) / _SIZE_SIGMA
        return np.concatenate([data.ravel(), coefficients, size])

    coefficients = least_squares(cost, np.zeros(scaled.dimension), loss="soft_l1").x
    truth = project(coefficients)
    keypoints, surface = scaled.keypoints(coefficients), scaled.surface.vertices(coefficients)
    centres = [-pose[:3, :3].T @ pose[:3, 3] for pose in vehicle.camera_T_object]
    visible = np.array([clearance(surface, scaled.surface.faces, keypoints, c) <= TOLERANCE for c in centres])
    errors = (pixels - truth) / extent
    twins = Twins.of(scaled.category)
    others = [truth[:, index] for index in (twins.rotated, twins.mirrored, twins.swapped)]
    places = np.stack([np.linalg.norm(pixels - other, axis=2) / extent[..., 0] for other in others], axis=2)
    between = np.linalg.norm(pixels[:, :, None] - pixels[:, None], axis=3) / extent
    found = np.linalg.norm(errors, axis=2) <= OUTLIER
    usable = found[:, None, :] & ~np.eye(len(keypoints), dtype=bool)
    nearest = np.where(usable, between, np.inf).min(axis=2)
    return Residuals(errors, confidence, visible, places, nearest)


def fit_noise_model(vehicles: Sequence[PosedVehicle], prior: ShapePrior) -> NoiseModel:
    """Noise model of the network that found the vehicles' keypoints.

    Found keypoints are those within `OUTLIER` of the truth. Shares and spreads are the sample's; Beta distributions are
    fitted by moments, the lost keypoints' confidence by median and deviation of its logarithm. What such data does not
    show (confusions of a whole vehicle, covered vehicles) stays zero.
    """
    sets = [residuals(vehicle, prior) for vehicle in vehicles]
    errors, confidence, visible, places, nearest = (
        np.concatenate([getattr(s, name) for s in sets])
        for name in ("errors", "confidence", "visible", "places", "nearest")
    )
    measured = np.isfinite(errors[..., 0])
    found = np.linalg.norm(errors, axis=2) <= OUTLIER
    lost = measured & ~found
    log_lost = np.log(np.maximum(confidence[lost], 1e-4))
    confident = lost & (confidence > _CONFIDENT)
    return NoiseModel(
        found_visible=float(found[measured & visible].mean()),
        found_hidden=float(found[measured & ~visible].mean()),
        sigma_visible=float(np.sqrt(np.mean(errors[found & visible] ** 2))),
        sigma_hidden=float(np.sqrt(np.mean(errors[found & ~visible] ** 2))),
        lost_to=_lost_to(places[lost], nearest[lost]),
        confidence_visible=_beta(confidence[found & visible]),
        confidence_hidden=_beta(confidence[found & ~visible]),
        confidence_lost=(float(np.exp(np.median(log_lost))), float(log_lost.std())),
        confident_lost=float(confident.sum() / max(lost.sum(), 1)),
        missing=float(1.0 - measured.mean()),
    )


def _beta(sample: NDArray[np.float64]) -> tuple[float, float]:
    mean, variance = float(sample.mean()), float(sample.var())
    strength = mean * (1.0 - mean) / variance - 1.0
    return mean * strength, (1.0 - mean) * strength


def _lost_to(places: NDArray[np.float64], nearest: NDArray[np.float64]) -> tuple[float, float, float, float, float]:
    """Shares of where lost keypoints lie: the first of the places, in the model's order, that is near enough."""
    near = np.concatenate([places < 0.07, (nearest < 0.02)[:, None], np.ones((len(places), 1), dtype=bool)], axis=1)
    counts = np.bincount(near.argmax(axis=1), minlength=5) / max(len(places), 1)
    return (float(counts[0]), float(counts[1]), float(counts[2]), float(counts[3]), float(counts[4]))
