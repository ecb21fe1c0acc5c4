"""The belief of a heading: what poses, directions and ways say, over time."""

import numpy as np
import pytest

from fgrecon.core.half_turn import flipped_observation, partners
from fgrecon.core.metrics import wrap_angle
from fgrecon.solve.time.heading_filter import (
    HEADINGS,
    Belief,
    backward,
    combined,
    direction_evidence,
    evidence_weight,
    path_evidence,
    pose_evidence,
)
from tests.solve.time.streets import PRIOR, seen, upright


def test_the_better_pose_is_more_probable_and_half_a_turn_remains():
    belief = Belief.none().updated(pose_evidence([0.5, 2.0], [0.0, 4.0], alone=True))
    assert abs(wrap_angle(belief.heading - 0.5)) < 0.1
    assert 0.7 < belief.facing(0.5) < 0.95
    beside = Belief.none().updated(pose_evidence([0.5], [0.0], alone=False))
    assert 0.5 < beside.facing(0.5) < 0.65


def test_a_belief_turns_with_the_camera():
    belief = Belief.none().updated(pose_evidence([0.5], [0.0], alone=True))
    later = belief.predicted(0.1, 0.7)
    assert abs(wrap_angle(later.heading - 1.2)) < 0.1
    assert later.probability.sum() == pytest.approx(1.0)
    assert later.facing(1.2) == pytest.approx(belief.facing(0.5), abs=0.01)


def test_directions_say_where_the_camera_is():
    """GraphObservation from ahead, straight before the camera: the vehicle faces it, rotation_y pi / 2."""
    ahead = np.zeros(36)
    ahead[0] = 1.0
    said = direction_evidence(ahead, np.array([0.0, 1.65, 20.0]))
    assert HEADINGS[said.argmax()] == pytest.approx(np.pi / 2.0)
    assert said.max() - said.min() == pytest.approx(np.log((0.95 * 36 + 0.05) / 0.05))
    np.testing.assert_array_equal(direction_evidence(None, np.zeros(3)), np.zeros(len(HEADINGS)))


def test_a_way_says_more_the_longer_it_is():
    short, far = (path_evidence(np.array([0.0, 0.0, -metres]), 0.5) for metres in (1.0, 10.0))
    np.testing.assert_array_equal(short, 0.0)
    assert HEADINGS[far.argmax()] == pytest.approx(np.pi / 2.0)
    assert Belief.none().updated(far).facing(np.pi / 2.0) > 0.8


def forward(evidence):
    """The belief of each frame by it and those before, a tenth of a second apart."""
    beliefs = [Belief.none().updated(evidence[0])]
    for own in evidence[1:]:
        beliefs.append(beliefs[-1].predicted(0.1, 0.0).updated(own))
    return beliefs


def test_later_frames_mend_earlier_ones():
    """Forward and backward is what a whole chain says: the first frame alone is wrong."""
    evidence = [pose_evidence([0.3 + turn], [0.0], alone=True) for turn in (np.pi, 0.0, 0.0, 0.0)]
    beliefs = forward(evidence)
    later = backward(evidence, [(0.1, 0.0)] * 3)
    assert beliefs[0].facing(0.3) < 0.2
    assert beliefs[-1].facing(0.3) > 0.9
    whole = [combined(belief, likelihood).facing(0.3) for belief, likelihood in zip(beliefs, later, strict=True)]
    np.testing.assert_allclose(whole, whole[-1], atol=0.01)
    np.testing.assert_allclose(combined(beliefs[-1], later[-1]).probability, beliefs[-1].probability)


def test_a_vehicle_does_not_turn_round_in_the_middle_of_its_track():
    """What is doubtful at first and sure later is one vehicle, which faces as it is seen when it is near."""

    def towards(heading, nats):
        return np.where(np.abs(wrap_angle(HEADINGS - heading)) < 0.6, nats, 0.0)

    evidence = [towards(np.pi, 0.8)] * 16 + [towards(0.0, 1.7)] * 25
    beliefs = forward(evidence)
    assert beliefs[15].facing(np.pi) > 0.99
    later = backward(evidence, [(0.1, 0.0)] * (len(evidence) - 1))
    whole = [combined(belief, likelihood).facing(0.0) for belief, likelihood in zip(beliefs, later, strict=True)]
    assert min(whole) > 0.7


def test_weights():
    assert evidence_weight(None, 100.0) == 1.0
    assert evidence_weight(0.1, 100.0) == pytest.approx(1.0 / 3.0)
    assert evidence_weight(5.0, 30.0) == pytest.approx(0.5)


def test_turned_round_twice_is_as_before():
    observation = seen(upright(0.8, [1.0, 1.65, 15.0]), np.random.default_rng(0), noise=0.0)
    partner = partners(PRIOR)
    names = PRIOR.category.keypoints
    assert names[partner[names.index("left_front_wheel")]] == "right_back_wheel"
    assert partner[names.index("left_side_mirror")] == -1
    turned = flipped_observation(observation, PRIOR)
    assert not turned.measured[partner < 0].any()
    again = flipped_observation(turned, PRIOR)
    there = partner >= 0
    np.testing.assert_array_equal(again.keypoints[there], observation.keypoints[there])
    np.testing.assert_allclose(again.azimuth, observation.azimuth)
    other = seen(upright(0.8, [1.0, 1.65, 15.0]), np.random.default_rng(0), noise=0.0, turned=True)
    np.testing.assert_array_equal(turned.keypoints, other.keypoints)
