"""Which way vehicles face beside and on a road, seen by a camera that looks along it: mostly as the traffic goes.

Where traffic keeps to the right, vehicles to the left come towards the camera and those ahead or to the right go as it
does; so do most of those that are parked. A network that takes a rear for a front is corrected by that where it is not
sure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.choices import TrafficSide
from fgrecon.core.geometry import view_azimuth, yaw_rotation

__all__ = ["traffic_directions"]

Array = NDArray[np.float64]

_ASIDE = np.array([-20.0, -12.0, -3.5, -2.2, -1.2, 0.0, 4.0, 15.0])  # metres, the traffic's side positive
_ALONG = np.array([-0.9, -2.6, -2.7, -0.1, 0.5, 2.4, 2.6, 1.4])
"""Log odds there of facing as the camera looks: cars and vans labelled in KITTI's object train split."""
_ACROSS = 0.25  # share of vehicles that face neither way
_SHARP = 8.0  # concentration (von Mises) of the two ways: some 20 degrees
_COUNTS = 0.75  # of it: the vehicles of one road face alike, and some roads are against the rule


def traffic_directions(side: TrafficSide, location: Array, bins: int) -> Array:
    """(A,) probability of each direction from a vehicle to the camera, as in `Observation.azimuth`, by the traffic.

    Args:
        side: The side that it keeps to.
        location: (3,) place of the vehicle in the frame of a camera that looks along the road, metres.
        bins: How many directions A.
    """
    aside = float(location[0]) if side is TrafficSide.RIGHT else -float(location[0])
    along = 1.0 / (1.0 + np.exp(-np.interp(aside, _ASIDE, _ALONG)))
    # The direction falls or rises with the heading one to one, so that one heading tells them all.
    ahead = float(view_azimuth(yaw_rotation(-np.pi / 2.0), location))  # of a vehicle that faces as the camera looks
    turned = np.cos(2.0 * np.pi * np.arange(bins) / bins - ahead)
    two_ways = (along * np.exp(_SHARP * turned) + (1.0 - along) * np.exp(-_SHARP * turned)) / np.i0(_SHARP)
    density = (_ACROSS + (1.0 - _ACROSS) * two_ways) ** _COUNTS
    probability: Array = density / density.sum()
    return probability
