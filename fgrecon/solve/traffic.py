"""An observation in its traffic: which way the vehicle faces by both, its detector and where it is.

A network that takes a rear for a front does so with its directions and with all its keypoints. So both are turned round
where the traffic makes that the more probable; what they say beside which way it faces stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.choices import TrafficSide
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.traffic import traffic_directions
from fgrecon.core.turned import half_a_turn, turned_round

__all__ = ["in_traffic"]

Array = NDArray[np.float64]

_LEAST = 1e-9  # probability


def in_traffic(seen: Observation, camera: Camera, prior: ShapePrior, side: TrafficSide) -> Observation:
    """The observation, turned round where that is more probable, with directions that know the traffic.

    It is as it was where its detector gives no directions.

    Args:
        seen: Without lens distortion.
        camera: The camera, which looks along the road.
        prior: Its height says about how far away a vehicle is.
        side: The side that the traffic keeps to.
    """
    place = _place(seen, camera, prior)
    if seen.azimuth is None or place is None:
        return seen
    bins = len(seen.azimuth)
    off = np.abs(wrap_angle(2.0 * np.pi * (np.arange(bins) - int(seen.azimuth.argmax())) / bins))
    near = np.clip((np.pi / 2.0 - off) * bins / (2.0 * np.pi) + 0.5, 0.0, 1.0)  # the half around the most probable one
    share = float(near @ seen.azimuth)
    ahead = near * seen.azimuth / share
    behind = half_a_turn(ahead)
    traffic = traffic_directions(side, place, bins)
    weights = np.array([share * float(ahead @ traffic), (1.0 - share) * float(behind @ traffic)]) + _LEAST
    right, turned = weights / weights.sum()
    told = turned_round(seen, prior) if turned > right else seen
    return replace(told, azimuth=right * ahead + turned * behind)


def _place(seen: Observation, camera: Camera, prior: ShapePrior) -> Array | None:
    """(3,) about where the vehicle is, metres, by its height in the image; None where nothing is measured."""
    points = seen.keypoints[seen.measured]
    if seen.box is None and len(points) < 2:
        return None
    corners = np.array([points.min(axis=0), points.max(axis=0)]) if seen.box is None else seen.box.reshape(2, 2)
    _, _, height = np.tensordot(prior.category.dimension_operator, prior.mean, axes=2)
    depth = float(height) * float(camera.matrix[1, 1]) / max(float(corners[1, 1] - corners[0, 1]), 1.0)
    place: Array = depth * camera.rays(corners.mean(axis=0)[None])[0]
    return place
