"""Points of an image that two vehicles claim, against the cases counted one by one; and a hidden car in a scene."""

from dataclasses import replace
from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import fgrecon
from fgrecon.core.observation import Observation
from fgrecon.core.options import KeypointOptions
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.solve.exclusive_keypoints import with_exclusive_keypoints
from tests.cars import CAMERA, observe

OPTIONS = KeypointOptions()
PIXELS = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 50.0], [np.nan, np.nan]])
MOVED = np.array([[1.0, 0.0], [60.0, 0.0], [0.0, 40.0], [0.0, 0.0]])
confidences = st.floats(0.0, 0.99)


def counted(first, second):
    """Probability of the first of two claims that exclude each other, from the four cases."""
    cases = {(a, b): (first if a else 1 - first) * (second if b else 1 - second) for a in (0, 1) for b in (0, 1)}
    del cases[1, 1]
    return cases[1, 0] / sum(cases.values())


@settings(max_examples=50, deadline=None, derandomize=True)
@given(first=confidences, second=confidences)
def test_of_two_claims_one_is_right(first, second):
    """To one point of three: of the others one is elsewhere, and one not measured."""
    one = Observation(PIXELS, np.full(4, first))
    other = Observation(PIXELS + MOVED, np.full(4, second))
    a, b = with_exclusive_keypoints([one, other], OPTIONS)
    np.testing.assert_allclose(a.confidence, [counted(first, second), first, first, 0.0], atol=1e-12)
    np.testing.assert_allclose(b.confidence, [counted(second, first), second, second, 0.0], atol=1e-12)


def test_claims_that_are_certain_are_half_as_probable():
    a, b = with_exclusive_keypoints([Observation(PIXELS, np.ones(4))] * 2, OPTIONS)
    np.testing.assert_allclose([a.confidence, b.confidence], [[0.5, 0.5, 0.5, 0.0]] * 2, atol=1e-3)


def test_their_order_is_nothing():
    rng = np.random.default_rng(0)
    seen = [Observation(PIXELS + rng.normal(0.0, 2.0, (4, 2)), rng.uniform(0.1, 0.9, 4)) for _ in range(3)]
    usual = with_exclusive_keypoints(seen, OPTIONS)
    assert all((one.confidence[:3] < given.confidence[:3]).all() for one, given in zip(usual, seen, strict=True))
    for order in permutations(range(3)):
        found = with_exclusive_keypoints([seen[i] for i in order], OPTIONS)
        for i, one in zip(order, found, strict=True):
            np.testing.assert_allclose(one.confidence, usual[i].confidence, rtol=1e-12)


def test_cars_of_their_own_keep_their_keypoints():
    prior = load_prior("car14")
    seen = [observe(prior, yaw_pose(0.4, np.array([x, 1.65, 18.0]))) for x in (-3.0, 0.0, 3.0)]
    found = with_exclusive_keypoints(seen, OPTIONS)
    assert all(one is given for one, given in zip(found, seen, strict=True))
    assert with_exclusive_keypoints(seen[:1], OPTIONS) == seen[:1]


def test_a_hidden_car_with_the_keypoints_of_the_one_before_it():
    """The left half of the car before it, of which the network is surer with that one's own box."""
    prior = load_prior("car14")
    poses = [yaw_pose(1.3, np.array([-1.5, 1.65, 21.0])), yaw_pose(1.3, np.array([0.0, 1.65, 17.0]))]
    alone, together = [], []
    for seed in range(6):
        hidden, free = (observe(prior, pose, noise=1.0, seed=seed) for pose in poses)
        taken = (free.confidence > 0.5) & (free.keypoints[:, 0] < np.median(free.keypoints[:, 0]))
        pixels = np.where(taken[:, None], free.keypoints + 0.5, hidden.keypoints)
        hidden = replace(hidden, keypoints=pixels, confidence=np.where(taken, 0.6, 0.5 * hidden.confidence))
        one = fgrecon.reconstruct(hidden, CAMERA, ground=1.65)
        scene = fgrecon.reconstruct_scene([hidden, free], CAMERA, ground=1.65)
        alone.append(one.location - poses[0][:3, 3])
        together.append([a.location - pose[:3, 3] for a, pose in zip(scene.vehicles, poses, strict=True)])
    off = np.linalg.norm(together, axis=2)
    assert off[:, 1].max() < 0.5
    assert np.mean(off[:, 0]) < 0.5 * np.linalg.norm(alone, axis=1).mean()
