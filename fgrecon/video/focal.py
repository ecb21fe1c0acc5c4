"""The unknown focal length of a video, estimated from its vehicles as from those of an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation
from fgrecon.io.frames import FrameSource
from fgrecon.io.source_frames import SourceFrame
from fgrecon.solve.scene import reconstruct_scenes
from fgrecon.video.records import FrameRecord


@dataclass(frozen=True)
class FocalSettings:
    """Which frames and vehicles a focal length is estimated from. Set by hand; not tuned."""

    frame_gap_seconds: float = 1.0  # between the frames: nearer ones say the same
    max_images: int = 8  # with vehicles, which are enough
    max_frames: int = 40  # that are searched for them
    max_vehicles: int = 4  # of a frame, the largest


SETTINGS = FocalSettings()


@dataclass(frozen=True)
class EstimatedCamera:
    """A camera that is estimated from vehicles.

    Attributes:
        camera: With its focal length, and how far it is known (`Camera.focal_sigma`).
        vehicles: From how many.
        images: Of how many images.
    """

    camera: Camera
    vehicles: int
    images: int


def estimate_camera(
    source: FrameSource, detect: Callable[[SourceFrame], FrameRecord], start: Camera, **arguments: Any
) -> EstimatedCamera | None:
    """Estimate the focal length that a few frames have in common (`fgrecon.reconstruct_scenes`).

    Args:
        source: The frames; some of the first are looked at, a second apart.
        detect: Detects what a frame shows (`FrameDetector`).
        start: The camera, with what is known of its focal length (`Camera.of_unknown`).
        arguments: Of `fgrecon.reconstruct_scenes`: prior, ground, size_prior, options.

    Returns:
        The camera; None where no vehicle determines it.
    """
    images: list[list[Observation]] = []
    looked, last = 0, -np.inf
    for frame in source.read():
        if frame.time - last < SETTINGS.frame_gap_seconds:
            continue
        last, looked = frame.time, looked + 1
        observations = [one.observation for one in detect(frame).sightings if one.observation is not None]
        if observations:
            images.append(sorted(observations, key=_extent, reverse=True)[: SETTINGS.max_vehicles])
        if len(images) == SETTINGS.max_images or looked == SETTINGS.max_frames:
            break
    scenes = reconstruct_scenes(images, start, **arguments) if images else []
    vehicles = sum(len(scene.vehicles) for scene in scenes)
    if not vehicles:
        return None
    return EstimatedCamera(scenes[0].camera, vehicles, sum(bool(scene.vehicles) for scene in scenes))


def _extent(observation: Observation) -> float:
    """Longer side of an observation, pixels."""
    corners = observation.keypoints if observation.box is None else observation.box.reshape(2, 2)
    return float(np.ptp(corners[np.isfinite(corners).all(axis=1)], axis=0).max(initial=0.0))
