"""Coupling of vehicles' headings: what the other vehicles and the traffic say of one.

Vehicles near one another face alike in a row or lane, some metres beside it often not: of two whose headings are known
but for half a turn, how far apart they are across them says how probable it is that they face alike. That is a weak
factor between any two, and a small Ising model over all.

Where a camera looks along a road and traffic keeps to the right, vehicles to the left come towards the camera and those
ahead or to the right go as it does; so do most of those that are parked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.choices import TrafficSide
from fgrecon.core.geometry import view_azimuth, yaw_rotation

_BESIDE = np.array([0.0, 1.0, 2.0, 3.0, 3.5, 4.5, 5.5, 7.0, 9.0, 12.0, 20.0])  # metres across two headings
_ALIKE = np.array([0.965, 0.955, 0.93, 0.91, 0.80, 0.69, 0.53, 0.34, 0.40, 0.40, 0.50])
"""Share of pairs there that face alike, of those that do or face opposite ways: 32,000 pairs of cars and vans in one
image, labelled in KITTI's object train split."""


@dataclass(frozen=True)
class HeadingCouplingSettings:
    """What headings of vehicles near one another, and the traffic, say of each. Not tuned."""

    aligned_cosine: float = float(np.cos(np.deg2rad(25.0)))  # of two headings, but for a half turn
    message_rounds: int = 60  # of the odds that vehicles pass on
    across_share: float = 0.25  # of vehicles that face neither along the road nor against it
    way_concentration: float = 8.0  # (von Mises) of the two ways: some 20 degrees
    traffic_share: float = 0.75  # that counts: the vehicles of one road face alike, and some are against the rule


SETTINGS = HeadingCouplingSettings()
"""What is used."""


def heading_odds(headings: Array, places: Array, near: float) -> Array:
    """(N, N) half the logarithm of the odds that two headings are both right or both wrong; 0 where nothing says.

    Args:
        headings: (N,) `rotation_y`, radians, each right or turned by half.
        places: (N, 3) in the frame of the headings, metres.
        near: Distance up to which vehicles say something of one another, metres.
    """
    away = places[:, None] - places
    turn = np.cos(headings[:, None] - headings)
    axis = np.angle(np.exp(2j * headings)[:, None] + np.exp(2j * headings)) / 2.0  # that the two have in common
    beside = np.abs(away[..., 0] * np.sin(axis) + away[..., 2] * np.cos(axis))
    alike = np.interp(beside, _BESIDE, _ALIKE)
    odds = 0.5 * np.sign(turn) * np.log(alike / (1.0 - alike))
    says = (np.hypot(away[..., 0], away[..., 2]) <= near) & (np.abs(turn) >= SETTINGS.aligned_cosine)
    return np.where(says & ~np.eye(len(headings), dtype=np.bool_), odds, 0.0)


def mean_field(own: Array, between: Array) -> Array:
    """(N,) probability that each is right less that it is wrong: mean field, as good as exact for factors this weak.

    Args:
        own: (N,) logarithm of the odds of each by itself.
        between: (N, N) `heading_odds`, as far as they count.
    """
    mean = np.tanh(own / 2.0)
    for _ in range(SETTINGS.message_rounds):
        mean = 0.5 * (mean + np.tanh(own / 2.0 + between @ mean))
    return np.asarray(mean, dtype=np.float64)


_ASIDE = np.array([-20.0, -12.0, -3.5, -2.2, -1.2, 0.0, 4.0, 15.0])  # metres, the traffic's side positive
_ALONG = np.array([-0.9, -2.6, -2.7, -0.1, 0.5, 2.4, 2.6, 1.4])
"""Log odds there of facing as the camera looks: cars and vans labelled in KITTI's object train split."""


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
    sharp, across = SETTINGS.way_concentration, SETTINGS.across_share
    two_ways = (along * np.exp(sharp * turned) + (1.0 - along) * np.exp(-sharp * turned)) / np.i0(sharp)
    density = (across + (1.0 - across) * two_ways) ** SETTINGS.traffic_share
    return density / density.sum()
