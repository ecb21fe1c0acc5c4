"""The full energy decides between proposals, whichever of them came first, for one image as for several.

Where the loop stops making visibility anew depends on where it started, and with it the end by a millimetre or so: that
is the tolerance between different starts.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors import X
from fgrecon.core.geometry import turn_between
from fgrecon.core.reconstruction import Alternative
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.search_settings import SETTINGS
from tests.cars import observe, pose_problem, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.support import constant, half_a_car, problem_of, solve


def swapped(start):
    """The same proposals, the second one first."""
    second, *others = start.alternatives
    first = Alternative(start.camera_T_object, start.coefficients, -second.excess)
    others = [replace(other, excess=other.excess - second.excess) for other in others]
    return replace(
        start,
        camera_T_object=second.camera_T_object,
        coefficients=second.coefficients,
        alternatives=(first, *others),
    )


@pytest.mark.parametrize("which", [0, 2, 9, 11, "half"])
def test_the_order_of_the_proposals_does_not_matter(which):
    problem, start = half_a_car() if which == "half" else problem_of(which)
    assert start.alternatives
    one, other = solve(problem, start), solve(problem, swapped(start))
    assert turn_between(swapped(start).camera_T_object, one.pose.matrix()) > SETTINGS.distinct_turn_radians
    np.testing.assert_allclose(other.pose.matrix(), one.pose.matrix(), atol=3e-3)
    np.testing.assert_allclose(other.coefficients, one.coefficients, atol=3e-3)
    assert other.optimum.energy == pytest.approx(one.optimum.energy, abs=3e-3)
    assert other.alternatives


@pytest.mark.parametrize("which", [2, 7, "half"])
def test_alternatives_are_refined_sorted_and_distinct(which):
    problem, start = half_a_car() if which == "half" else problem_of(which, ground=False)
    problem = constant(problem, start.visibility)  # then the end does not depend on the path
    near = replace(start.alternatives[0], camera_T_object=start.camera_T_object, excess=1.0)  # no other pose at all
    close = tuple(replace(other, excess=2.0) for other in start.alternatives)
    start = replace(start, everywhere=False)  # not searched on from a basin to a better one
    result = solve(problem, replace(start, alternatives=(near, *close)))
    assert result.alternatives
    excesses = [other.excess for other in result.alternatives]
    assert excesses == sorted(excesses)
    assert excesses[0] >= 0.0
    poses = [result.pose.matrix(), *(other.camera_T_object for other in result.alternatives)]
    for i, pose in enumerate(poses):
        assert all(turn_between(pose, known) > SETTINGS.distinct_turn_radians for known in poses[:i])
    for other in result.alternatives:  # each is the minimum of its own basin, and so much worse
        assert other.excess not in (1.0, 2.0)
        moved = replace(start, camera_T_object=other.camera_T_object, coefficients=other.coefficients, alternatives=())
        alone = solve(problem, moved)
        np.testing.assert_allclose(alone.pose.matrix(), other.camera_T_object, atol=1e-4)
        assert alone.optimum.energy - result.optimum.energy == pytest.approx(other.excess, abs=1e-4)


def test_proposals_that_are_far_worse_are_reported_as_they_are():
    problem, start = problem_of(0)
    far = tuple(replace(other, excess=1e3 + i) for i, other in enumerate(start.alternatives))
    result = solve(problem, replace(start, alternatives=far))
    assert result.alternatives == far


CAR = np.array([0.9, -0.6, 0.4, 0.2, -0.5])


def several(count=3):
    """One car in several images and the proposals of each."""
    prior, seen, starts = load_prior("car14"), [], []
    for t in range(count):
        pose = yaw_pose(-2.3 + 0.5 * t, (-3.0 + 2.0 * t, 1.65, 14.0 - t))
        observation = observe(prior, pose, CAR, noise=2.0, seed=t)
        problem, _ = pose_problem(prior, observation, options=make_options(free_offsets=False))
        seen.append(GraphObservation(problem, image=t))
        starts.append(search_pose(problem))
    return seen, starts


@pytest.mark.parametrize("wrong", [(1,), (0, 2)])
def test_images_that_start_in_the_wrong_basin_change_over(wrong):
    """The shape is everybody's: an image with the front for the back prefers its other proposal under it."""
    seen, starts = several()
    right = minimise_from_proposals(seen, starts)
    turned = list(starts)
    for i in wrong:
        pose = starts[i].camera_T_object.copy()
        pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
        first = Alternative(starts[i].camera_T_object, starts[i].coefficients, 1.0)
        turned[i] = replace(starts[i], camera_T_object=pose, alternatives=(first,))
    found = minimise_from_proposals(seen, turned)
    for mine, expected in zip(found.optimum.state.poses, right.optimum.state.poses, strict=True):
        np.testing.assert_allclose(mine.matrix(), expected.matrix(), atol=3e-3)
    np.testing.assert_allclose(found.optimum.state.shapes[0][0], right.optimum.state.shapes[0][0], atol=3e-3)
    assert found.optimum.energy == pytest.approx(right.optimum.energy, abs=3e-3)
    for i in wrong:  # the pose that it left is reported as the other one
        (other,) = found.alternatives[i]
        assert turn_between(other.camera_T_object, found.optimum.state.poses[i].matrix()) > np.pi - 0.3
        assert other.excess > 0.0


def pair():
    """Two problems whose visibility does not change, and no ground: then the end does not depend on the path."""
    parts = [problem_of(seed, ground=False) for seed in (0, 1)]
    return [(constant(problem, start.visibility), start) for problem, start in parts]


def test_two_vehicles_in_two_images_are_solved_as_if_alone():
    """No factor in common: each ends where it ends by itself, and the energy is the sum."""
    parts = pair()
    alone = [solve(problem, replace(start, alternatives=())) for problem, start in parts]
    together, values = both(parts)
    for number, one in enumerate(alone):
        np.testing.assert_allclose(together.state.poses[number].matrix(), one.pose.matrix(), atol=3e-5)
        np.testing.assert_allclose(together.state.shapes[number][0], one.coefficients, atol=3e-5)
        held = together.state.weights[number]
        np.testing.assert_allclose(held.keypoints, one.weights.keypoints, atol=1e-5)
    assert together.energy == pytest.approx(sum(one.optimum.energy for one in alone), abs=1e-6)
    assert {X(0, 0), X(1, 1)} <= set(values.keys())


def test_a_factor_between_two_vehicles_moves_both():
    """A convoy: the second car is known to follow the first at a distance that the images do not quite have."""
    parts = pair()
    free, _ = both(parts)
    between = free.state.poses[0].between(free.state.poses[1])
    longer = gtsam.Pose3(between.rotation(), between.translation() * 1.05)
    misses = []
    for sigma in (1e3, 1e-3):
        noise = gtsam.noiseModel.Isotropic.Sigma(6, sigma)
        tied, _ = both(parts, [gtsam.BetweenFactorPose3(X(0, 0), X(1, 1), longer, noise)])
        met = tied.state.poses[0].between(tied.state.poses[1])
        misses.append(np.linalg.norm(longer.localCoordinates(met)))
        moved = [np.linalg.norm(a.localCoordinates(b)) for a, b in zip(free.state.poses, tied.state.poses, strict=True)]
        assert bool(min(moved) > 1e-3) is (sigma < 1.0)
        assert tied.energies["extra"] == pytest.approx(0.5 * (misses[-1] / sigma) ** 2, rel=1e-6)
        assert tied.energy - tied.energies["extra"] >= free.energy - 1e-6
    assert misses[0] == pytest.approx(np.linalg.norm(longer.localCoordinates(between)), rel=1e-3)
    assert misses[1] < 1e-3 * misses[0]


def both(parts, extra=()):
    """Two problems as two vehicles in two images of one graph."""
    seen = [GraphObservation(problem, vehicle=i, image=i) for i, (problem, _) in enumerate(parts)]
    starts = [replace(start, alternatives=()) for _, start in parts]
    found = minimise_from_proposals(seen, starts, extra)
    assert found.optimum.failure is None
    assert found.optimum.unfinished is None
    return found.optimum, found.optimum.values
