"""Mode of each image of a vehicle: a discrete factor graph over the images, a chain.

    mode(0) ---- turn ---- mode(1) ---- turn ---- mode(2) ...
        |                       |                       |
     energy                  energy                  energy

An image's factor is the energy of its modes, but not without limit: a network that takes a front for a rear does so
with all its keypoints, and how well they fit says nothing about that. Between neighbours of a sequence a turn costs. So
a few images that take the front for the rear are outvoted by the others, and the marginals tell how sure it all is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import turn_between
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.graph_settings import SETTINGS


def is_flipped(first: Array, second: Array) -> bool:
    """Whether two poses (4, 4) are turned by more than a quarter against each other."""
    return float(np.vdot(first[:3, :3], second[:3, :3])) < 1.0  # the trace is 1 + 2 cos


def select_modes(modes: Sequence[Sequence[Alternative]], *, in_order: bool) -> tuple[list[int], list[Array]]:
    """Choose a mode for each image.

    Args:
        modes: Of each image of one vehicle its modes, with their energies in nats.
        in_order: Whether the images were taken one after the other.

    Returns:
        The index of each image's mode in the most probable choice; and for each image how many nats its modes are
        behind the chosen one, whatever modes the other images are in.
    """
    unary, between = [], []
    for own in modes:
        energy = np.array([mode.excess for mode in own])
        above_least = energy - energy.min()
        unary.append(-np.minimum(above_least, SETTINGS.image_evidence_nats) if in_order else -above_least)
    for before, after in pairwise(modes):
        turns = [[turn_between(a.camera_T_object, b.camera_T_object) for b in after] for a in before]
        cost = np.minimum(np.square(np.array(turns) / SETTINGS.turn_sigma_radians) / 2.0, SETTINGS.most_turn_nats)
        between.append(-cost if in_order else np.zeros_like(cost))
    chosen = _most_probable(unary, between)
    return chosen, [m[index] - m for m, index in zip(_marginals(unary, between), chosen, strict=True)]


def _most_probable(unary: Sequence[Array], between: Sequence[Array]) -> list[int]:
    """The states of a chain with the greatest sum of logarithms (Viterbi)."""
    score, back = unary[0], []
    for own, table in zip(unary[1:], between, strict=True):
        through = score[:, None] + table
        back.append(through.argmax(axis=0))
        score = through.max(axis=0) + own
    states = [int(score.argmax())]
    for pointers in reversed(back):
        states.append(int(pointers[states[-1]]))
    return states[::-1]


def _marginals(unary: Sequence[Array], between: Sequence[Array]) -> list[Array]:
    """Logarithms, but for a constant, of each state's probability (sum-product, in logarithms: chains are long)."""
    forward, backward = [unary[0]], [np.zeros(len(unary[-1]))]
    for own, table in zip(unary[1:], between, strict=True):
        forward.append(own + np.logaddexp.reduce(forward[-1][:, None] + table, axis=0))
    for own, table in zip(unary[:0:-1], between[::-1], strict=True):
        backward.append(np.logaddexp.reduce(table + own + backward[-1], axis=1))
    return [f + b for f, b in zip(forward, backward[::-1], strict=True)]
