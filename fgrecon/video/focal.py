"""The focal length of a video that nobody knows: its vehicles tell it, as those of an image do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation
from fgrecon.io.frames import FrameSource, SourceFrame
from fgrecon.solve.scene import reconstruct_scenes
from fgrecon.video.records import FrameRecord

__all__ = ["EstimatedCamera", "estimate_camera"]

_APART = 1.0  # seconds between the frames: nearer ones say the same
_IMAGES = 8  # with vehicles, which are enough
_LOOKED = 40  # frames that are looked at to find them
_VEHICLES = 4  # of a frame, the largest


@dataclass(frozen=True)
class EstimatedCamera:
    """What vehicles tell of a camera.

    Attributes:
        camera: With its focal length, and how far it is known (`Camera.focal_sigma`).
        vehicles: How many told it.
        images: Of how many images.
    """

    camera: Camera
    vehicles: int
    images: int


def estimate_camera(
    source: FrameSource, look: Callable[[SourceFrame], FrameRecord], start: Camera, **arguments: Any
) -> EstimatedCamera | None:
    """Find the focal length that a few frames have in common (`fgrecon.reconstruct_scenes`).

    Args:
        source: The frames; some of the first are looked at, a second apart.
        look: Says what a frame shows.
        start: The camera, with what is known of its focal length (`Camera.of_unknown`).
        arguments: Of `fgrecon.reconstruct_scenes`: prior, ground, size_prior, options.

    Returns:
        The camera; None where no vehicle tells.
    """
    images: list[list[Observation]] = []
    looked, last = 0, -np.inf
    for frame in source.read():
        if frame.time - last < _APART:
            continue
        last, looked = frame.time, looked + 1
        seen = [one.observation for one in look(frame).sightings if one.observation is not None]
        if seen:
            images.append(sorted(seen, key=_extent, reverse=True)[:_VEHICLES])
        if len(images) == _IMAGES or looked == _LOOKED:
            break
    scenes = reconstruct_scenes(images, start, **arguments) if images else []
    vehicles = sum(len(scene.vehicles) for scene in scenes)
    if not vehicles:
        return None
    return EstimatedCamera(scenes[0].camera, vehicles, sum(bool(scene.vehicles) for scene in scenes))


def _extent(seen: Observation) -> float:
    """Longer side of what is seen, pixels."""
    corners = seen.keypoints if seen.box is None else seen.box.reshape(2, 2)
    return float(np.ptp(corners[np.isfinite(corners).all(axis=1)], axis=0).max(initial=0.0))
