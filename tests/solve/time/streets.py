"""Made-up streets: vehicles on known paths before a camera that moves, their keypoints noisy and flipped."""

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.half_turn import partners
from fgrecon.core.observation import Observation
from fgrecon.io.catalogue import load_prior

CAMERA = Camera(np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]]))
PRIOR = load_prior("car14")
BINS = 2.0 * np.pi * np.arange(36) / 36


def upright(yaw, place):
    """(4, 4) pose of an upright vehicle, or of a camera that looks along z where yaw is 0."""
    pose = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = place
    return pose


def seen(pose, rng, *, noise=0.015, turned=False, shape=None, camera=CAMERA):
    """The observation of a car in a pose, with directions as a network gives them; flipped where it is so."""
    points = PRIOR.keypoints(np.zeros(PRIOR.dimension) if shape is None else shape)
    pixels = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
    box = np.array([*pixels.min(axis=0), *pixels.max(axis=0)])
    extent = float((box[2:] - box[:2]).max())
    pixels = pixels + noise * extent * rng.normal(size=pixels.shape)
    confidence = np.full(len(pixels), 0.8)
    x, _, z = -pose[:3, :3].T @ pose[:3, 3]
    azimuth = np.arctan2(z, x)
    if turned:
        partner = partners(PRIOR)
        there = partner >= 0
        pixels = np.where(there[:, None], pixels[np.maximum(partner, 0)], np.nan)
        confidence = np.where(there, confidence, 0.0)
        azimuth += np.pi
    directions = np.exp((np.cos(BINS - azimuth) - 1.0) / 0.1) + 0.02
    return Observation(pixels, confidence, box, azimuth=directions / directions.sum())


def off(estimate, pose):
    """Yaw error in degrees, and position error in metres."""
    turn = estimate.reconstruction.rotation_y - np.arctan2(-pose[2, 0], pose[0, 0])
    degrees = abs(np.degrees((turn + np.pi) % (2.0 * np.pi) - np.pi))
    return degrees, float(np.linalg.norm(estimate.reconstruction.location - pose[:3, 3]))
