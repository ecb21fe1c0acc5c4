"""Directions by the traffic: where vehicles are says which way they face."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgrecon.core.choices import TrafficSide
from fgrecon.core.detection import facing_probability
from fgrecon.core.geometry import view_azimuth, yaw_rotation
from fgrecon.core.heading_coupling import traffic_directions

AS_THE_CAMERA, AGAINST_IT = -np.pi / 2, np.pi / 2  # rotation_y


def seen_from(heading, place):
    return float(view_azimuth(yaw_rotation(heading), place))


@given(x=st.floats(-40, 40), z=st.floats(1, 80), bins=st.integers(8, 72), side=st.sampled_from(list(TrafficSide)))
def test_they_are_probabilities(x, z, bins, side):
    directions = traffic_directions(side, np.array([x, 1.6, z]), bins)
    assert directions.shape == (bins,)
    assert (directions > 0).all()
    assert directions.sum() == pytest.approx(1.0)


@given(x=st.floats(-40, 40), z=st.floats(1, 80))
def test_the_other_side_of_the_road_is_the_mirror_image(x, z):
    right = traffic_directions(TrafficSide.RIGHT, np.array([x, 1.6, z]), 36)
    left = traffic_directions(TrafficSide.LEFT, np.array([-x, 1.6, z]), 36)
    np.testing.assert_allclose(left, np.roll(right[::-1], 1), atol=1e-12)  # bin a becomes bin -a


@pytest.mark.parametrize(("x", "along"), [(-8.0, False), (-3.5, False), (0.0, True), (4.0, True)])
def test_vehicles_to_the_left_come_towards_a_camera_and_others_go_ahead(x, along):
    place = np.array([x, 1.6, 25.0])
    directions = traffic_directions(TrafficSide.RIGHT, place, 36)
    probable = seen_from(AS_THE_CAMERA if along else AGAINST_IT, place)
    assert abs(np.angle(np.exp(1j * (2 * np.pi * directions.argmax() / 36 - probable)))) < np.pi / 36 + 1e-9
    assert 0.65 < facing_probability(directions, probable) < 0.9  # some stand across, and some against the rule
    assert directions.min() > 0.1 / 36


def test_between_the_lanes_nobody_can_tell():
    place = np.array([-2.0, 1.6, 25.0])
    directions = traffic_directions(TrafficSide.RIGHT, place, 36)
    assert facing_probability(directions, seen_from(AS_THE_CAMERA, place)) == pytest.approx(0.5, abs=0.06)
