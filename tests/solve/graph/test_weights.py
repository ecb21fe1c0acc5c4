"""The weights that a result holds are those of its own residuals, and no others."""

import numpy as np
import pytest

from fgrecon.core.observation import Observation
from fgrecon.solve.graph.adjust import SETTLED, adjust_shape
from fgrecon.solve.proposals.adjust import adjust_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.terms import Hypotheses
from tests.solve.graph.support import problem_of, weights_at


@pytest.mark.parametrize(("seed", "strategy"), [(2, "mixture"), (2, "tukey"), (4, "cauchy"), (4, "tukey")])
def test_the_weights_belong_to_the_result(seed, strategy):
    """They have settled: made anew from the result they are the same, which those of the pose search are not."""
    problem, start = problem_of(seed, strategy=strategy)
    result = adjust_shape(problem, start)
    assert result.failure is None
    again, box_weights, visibility = weights_at(problem, result.pose.matrix(), result.coefficients)
    assert np.abs(result.weights - start.weights).max() > 20 * SETTLED
    np.testing.assert_allclose(result.weights, again, atol=3 * SETTLED)
    np.testing.assert_allclose(result.box_weights, box_weights, atol=SETTLED)
    np.testing.assert_allclose(result.visibility, visibility, atol=SETTLED)


@pytest.mark.parametrize("strategy", ["mixture", "huber"])
def test_the_energies_are_those_of_the_pose_search(strategy):
    """Terms that both stages have are told alike; only the ground's has another constant."""
    problem, start = problem_of(1, strategy=strategy)
    result = adjust_shape(problem, start)
    pose = result.pose.matrix()[None]
    search = problem.energy.energies(Hypotheses(pose[:, :3, :3], pose[:, :3, 3], result.coefficients[None]))
    shared = set(search) - {"ground"}
    assert shared == {"reprojection", "box", "dimensions", "coefficients"}
    for name in shared:
        assert result.energies[name] == pytest.approx(search[name][0], rel=1e-9)
    assert set(result.energies) == set(search) | {"cheirality", "planarity", "rectangularity", "laplacian"}


@pytest.mark.parametrize("edge", range(4))
def test_a_wrong_edge_of_the_box_loses_its_weight(edge):
    """An edge that is far off counts for nothing, and the car stays where the right edges and the keypoints have it."""
    problem, start = problem_of(3)
    seen = problem.observation
    box = seen.box.copy()
    box[edge] += (-0.3 if edge < 2 else 0.3) * seen.extent
    spoilt = Problem.of(
        Observation(seen.keypoints, seen.confidence, box),
        problem.camera,
        problem.model,
        problem.ground,
        problem.options,
    )
    right, wrong = adjust_shape(problem, start), adjust_shape(spoilt, adjust_pose(spoilt))
    others = np.arange(4) != edge
    assert wrong.box_weights[edge] < 0.01
    assert wrong.box_weights[others].min() > 0.5
    assert right.box_weights.min() > 0.5
    assert np.linalg.norm(wrong.pose.translation() - right.pose.translation()) < 0.03 * right.pose.z()
