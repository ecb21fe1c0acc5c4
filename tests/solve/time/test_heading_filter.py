"""The belief of a heading: what poses, directions and ways say, over time."""

import numpy as np
import pytest

from fgrecon.core.half_turn import flipped_observation, partners
from fgrecon.core.metrics import wrap_angle
from fgrecon.solve.time.heading_filter import (
    HEADINGS,
    Aspect,
    Belief,
    TrackHeading,
    direction_evidence,
    earlier_beliefs,
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


PLACE = np.array([2.0, 1.65, 20.0])


def towards(heading, nats):
    """What an image says that tells one half of all headings from the other by so many nats."""
    return np.where(np.abs(wrap_angle(HEADINGS - heading)) < 0.6, nats, 0.0)


def followed(images, heights=None, ways=None, turn=0.0):
    """The heading after each of several frames, a tenth of a second apart, as high in the image as is given."""
    heights = [50.0] * len(images) if heights is None else heights
    found = [TrackHeading.begun(images[0], PLACE, heights[0])]
    for image, height, way in zip(images[1:], heights[1:], (ways or [None] * len(images))[1:], strict=True):
        found.append(found[-1].following(0.1, turn, image, PLACE, height, way))
    return found


def sides(headings):
    return [one.belief.facing(0.0) for one in headings]


def test_the_frames_of_one_view_say_little_more_than_one_of_them():
    one, *_, many = sides(followed([towards(0.0, 1.0)] * 40))
    assert one < many < Belief.none().updated(towards(0.0, 2.0)).facing(0.0)
    _, *_, closer = sides(followed([towards(0.0, 1.0)] * 40, heights=np.geomspace(50.0, 200.0, 40)))
    assert closer > many + 0.05


def test_a_few_frames_that_are_turned_do_not_turn_a_vehicle():
    images = [towards(np.pi if i % 3 == 1 else 0.0, 2.0) for i in range(30)]
    assert min(sides(followed(images))[3:]) > 0.5


def test_a_vehicle_faces_as_its_last_images_where_these_are_surer_than_all_before():
    """However long the others were believed: they may all be wrong alike."""
    followed_before = followed([towards(np.pi, 0.8)] * 100)[-1].belief
    *_, one, two = followed([towards(np.pi, 0.8)] * 100 + [towards(0.0, 3.0)] * 2)
    last = followed([towards(np.pi, 0.8)] * 100 + [towards(0.0, 3.0)] * 10)[-1]
    assert followed_before.facing(0.0) < one.belief.facing(0.0) < two.belief.facing(0.0) < 0.5  # no few turn it
    assert last.belief.facing(0.0) > 0.7
    assert last.whole.facing(0.0) < 0.5  # in the end all count


def test_a_way_counts_whole_beside_the_images():
    """It is evidence of another kind: each stretch tells anew, and no image is surer than both."""
    forth = path_evidence(np.array([10.0, 0.0, 0.0]), 0.3)
    images, ways = [towards(np.pi, 2.0)] * 3, [None, forth, forth]
    first, _, last = followed(images, ways=ways)
    assert first.belief.facing(0.0) < 0.5 < last.belief.facing(0.0)
    assert last.way.facing(0.0) > 0.99


def test_views_differ_by_direction_and_size_and_not_by_front_and_rear():
    view = Aspect(1.0, 4.0)
    assert not view.differs(Aspect(1.0 + np.pi, 4.1))
    assert view.differs(Aspect(1.4, 4.0))
    assert view.differs(Aspect(1.0, 4.5))


def test_what_is_known_turns_with_the_camera():
    image = pose_evidence([0.5], [0.0], alone=True)
    last = followed([image, np.zeros(len(HEADINGS))], turn=0.7)[-1]
    assert abs(wrap_angle(last.belief.heading - 1.2)) < 0.1


def test_later_frames_mend_earlier_ones():
    """The last frame tells which way all faced, each image along which axis: the first alone is wrong, and all turn."""
    headings = 0.3 + 0.2 * np.arange(4)
    images = [pose_evidence([h + turn], [0.0], alone=True) for h, turn in zip(headings, (np.pi, 0, 0, 0), strict=True)]
    last = Belief.none().updated(2.0 * images[-1])
    beliefs = earlier_beliefs(last, images, [(0.1, 0.2)] * 3)
    assert beliefs[-1] is last
    assert Belief.none().updated(images[0]).facing(0.3) < 0.2
    for belief, heading in zip(beliefs, headings, strict=True):
        assert belief.facing(heading) > 0.9
        assert abs(wrap_angle(belief.heading - heading)) < 0.1


def test_flipped_twice_is_as_before():
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
