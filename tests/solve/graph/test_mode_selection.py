"""The chain that decides which basin each image is in, against all combinations written out."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.mode_selection import is_flipped, select_modes
from tests.cars import yaw_pose


def basin(degrees, energy):
    return Alternative(yaw_pose(np.radians(degrees)), np.zeros(5), float(energy))


images = st.lists(
    st.lists(st.tuples(st.floats(-180, 180), st.floats(0, 40)), min_size=1, max_size=3), min_size=1, max_size=4
)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(images)
def test_without_order_every_image_takes_its_best(found):
    basins = [[basin(*one) for one in own] for own in found]
    chosen, behind = select_modes(basins, in_order=False)
    for own, index, nats in zip(basins, chosen, behind, strict=True):
        energies = np.array([one.excess for one in own])
        assert index == energies.argmin()
        np.testing.assert_allclose(nats, energies - energies.min(), atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(images)
def test_in_order_it_is_the_most_probable_of_all_combinations(found):
    """Whatever a basin's energy is taken for by itself, and a turn by itself: read off from chains of one and two."""
    basins = [[basin(*one) for one in own] for own in found]
    chosen, behind = select_modes(basins, in_order=True)
    cost = {}
    for states in product(*(range(len(own)) for own in basins)):
        total = sum(alone(own)[index] for own, index in zip(basins, states, strict=True))
        pairs = [(basins[t][states[t]], basins[t + 1][states[t + 1]]) for t in range(len(states) - 1)]
        cost[states] = total + sum(turn(*pair) for pair in pairs)
    assert cost[tuple(chosen)] == pytest.approx(min(cost.values()), abs=1e-6)
    for t, own in enumerate(basins):
        weight = [sum(np.exp(-c) for states, c in cost.items() if states[t] == index) for index in range(len(own))]
        np.testing.assert_allclose(behind[t], np.log(weight[chosen[t]]) - np.log(weight), atol=1e-6)


def alone(own):
    """Nats of each basin of an image by itself, the best one's being zero."""
    _, (nats,) = select_modes([own], in_order=True)
    return nats - nats.min()


def turn(first, second):
    """Nats of the turn between two poses: of one image with this pose, before one with this and its own again."""
    (_, nats) = select_modes([[first], [second, first]], in_order=True)[1]
    own = alone([second, first])
    return (nats[0] - nats[1]) - (own[0] - own[1])


def test_a_minority_is_outvoted():
    """One image of seven takes the front for the rear, and is sure of it: in a sequence its neighbours know better."""
    basins = [[basin(10 + 5 * t, 0.0), basin(190 + 5 * t, 20.0)] for t in range(7)]
    basins[3] = [basin(190 + 15, 0.0), basin(10 + 15, 20.0)]
    assert select_modes(basins, in_order=True)[0] == [0, 0, 0, 1, 0, 0, 0]
    assert select_modes(basins, in_order=False)[0] == [0] * 7


def test_a_slow_turn_is_no_jump():
    """A car that really turns round, by and by, is believed."""
    basins = [[basin(12 * t, 0.0), basin(12 * t + 180, 20.0)] for t in range(16)]
    assert select_modes(basins, in_order=True)[0] == [0] * 16


@pytest.mark.parametrize(("degrees", "turned"), [(0, False), (85, False), (95, True), (180, True), (-120, True)])
def test_turned_is_more_than_a_quarter(degrees, turned):
    assert bool(is_flipped(yaw_pose(0.3), yaw_pose(0.3 + np.radians(degrees)))) is turned
