"""Observations of a car of known shape in a known pose, made without any code of `fgrecon.simulation.vehicles`."""

from __future__ import annotations

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import prepare

MATRIX = np.array([[721.5, 0.0, 609.6], [0.0, 718.9, 172.9], [0.0, 0.0, 1.0]])
CAMERA = Camera(MATRIX)
LOCATION = (1.5, 1.65, 12.0)


def yaw_pose(yaw, location=LOCATION):
    """camera_T_object of an upright car, rotation_y in radians."""
    pose = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = location
    return pose


def project(points, pose, matrix=MATRIX):
    """Pixels of object points, point by point."""
    pixels = []
    for point in points:
        x, y, z = matrix @ (pose[:3, :3] @ point + pose[:3, 3])
        pixels.append([x / z, y / z])
    return np.array(pixels)


def observe(prior, pose, coefficients=None, *, noise=0.0, seed=0, visible_only=False, box=True):
    """What an honest detector sees: confidence 0.9 where the prior's mean car shows a keypoint, 0.02 elsewhere."""
    rng = np.random.default_rng(seed)
    coefficients = np.zeros(prior.dimension) if coefficients is None else np.asarray(coefficients)
    pixels = project(prior.keypoints(coefficients), pose)
    pixels = pixels + noise * rng.standard_normal(pixels.shape)
    seen = prepare(prior).visibility.lookup(pose) > 0.5
    if visible_only:
        pixels[~seen] = np.nan
    outline = project(prior.surface.vertices(coefficients), pose)
    edges = np.concatenate([outline.min(axis=0), outline.max(axis=0)]) if box else None
    return Observation(pixels, np.where(seen, 0.9, 0.02), edges)


def pose_problem(prior, observation, *, ground=None, size=None, options=None):
    """The problem and the prepared model."""
    options = Options() if options is None else options
    model = prepare(prior, size, options.shape.basis_vectors)
    return Problem.of(observation, CAMERA, model, ground, options), model


def pose_energy(prior, observation, **settings):
    """The energy that the search minimises, and the prepared model."""
    problem, model = pose_problem(prior, observation, **settings)
    return problem.energy, model


def rotation_angle(a, b):
    """Angle between two rotations (3, 3), radians, exact for small ones."""
    return float(2.0 * np.arcsin(min(np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(8.0), 1.0)))
