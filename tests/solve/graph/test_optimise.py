"""The re-weighting loop: where it ends is a minimum of the robust energy, whatever visibility does on the way."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from factors import L, X
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.optimise import _Loop, optimise
from tests.solve.graph.energy import Whitened
from tests.solve.graph.support import (
    constant,
    energy_of,
    graph_at,
    problem_of,
    proposal,
    solved,
    vector,
)

SCENES = {
    "plain": {"seed": 0},
    "second": {"seed": 1},
    "covariances": {"seed": 2, "covariance": True},
    "no ground": {"seed": 6, "ground": False, "size": False},
    "no box": {"seed": 4, "box_model": "off"},
    "offsets": {"seed": 5, "free_offsets": True},
    "fixed pose": {"seed": 1, "joint": False},
}


def at_end(result):
    """The independent energy, and where the result is in its parameters."""
    joint = result.problem.options.shape.joint
    energy = energy_of(result.problem, result.weights, result.pose.matrix(), joint=joint)
    graph = result.graph(pose_free=joint)
    return energy, vector(energy, graph, result.optimum.values)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_the_end_is_a_minimum_of_the_robust_energy(scene):
    """Without weights: the likelihood of the mixtures has no slope there, and another solver stays or comes back."""
    result = solved(**scene)
    assert result.failure is None
    assert result.optimum.unfinished is None
    energy, x = at_end(result)
    shifted = 0.0 if result.problem.ground is None or not energy.joint else np.log(energy.height_sigma)
    assert energy.robust(x) + shifted == pytest.approx(result.optimum.energy, abs=1e-6)
    around = Whitened(energy, x)
    zero = np.zeros(len(x))
    np.testing.assert_allclose(around.gradient(zero), 0.0, atol=2e-6)  # nats per standard deviation
    if not result.problem.options.shape.free_offsets:  # which are too many to do so in short time
        np.testing.assert_allclose(around.minimise(zero), x, rtol=0, atol=1e-5)
        away = 0.2 * np.random.default_rng(0).normal(size=len(x))
        back = around.minimise(away)
        assert np.abs(around.at(away) - x).max() > 1e-3
        np.testing.assert_allclose(back, x, rtol=0, atol=1e-5)


@settings(deadline=None, derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 10_000),
    strategy=st.sampled_from(["mixture", "huber", "cauchy", "geman_mcclure", "tukey"]),
    offsets=st.booleans(),
    covariance=st.booleans(),
    ground=st.booleans(),
)
def test_with_visibility_held_the_energy_never_rises(seed, strategy, offsets, covariance, ground):
    """Step by step, over updates of the weights as well; and the end is no higher than any of these steps."""
    problem, start = problem_of(
        seed, strategy=strategy, free_offsets=offsets, covariance=covariance, ground=ground, box_model="surface"
    )
    state = proposal(problem, start)
    graph = graph_at(problem, state)
    optimum = optimise(graph, state)
    if optimum.failure is not None:
        return
    held = optimum.state.weights[0]
    steps = [step for step in optimum.steps if step.weights[0].visibility is held.visibility]
    steps = [step for step in steps if step.update > steps[0].update]  # that was before visibility was held
    energies = [sum(graph.energies(step.values, step.weights).values()) for step in steps]
    assert (np.diff([*energies, optimum.energy]) < 1e-7).all()
    assert optimum.energy == pytest.approx(sum(graph.energies(optimum.values, [held]).values()))


def flipping(problem, split, tables):
    """The problem with a visibility that is one of two tables, by the side of a place along the viewing ray."""

    def visibility(poses):
        return np.array([tables[int(pose[2, 3] > split)] for pose in poses])

    return replace(problem, energy=replace(problem.energy, visibility=visibility))


def end_of(problem, start):
    state = proposal(problem, start)
    return optimise(graph_at(problem, state), state)


def turns(problem, start, split, tables):
    """The visibilities of the updates that made it anew, by the number of their table, and the end."""
    turning = flipping(problem, split, tables)
    optimum = end_of(turning, start)
    seen = {}  # by update, before its solve
    for step in optimum.steps:
        seen.setdefault(step.update, step.weights[0].visibility)
    sides = [int(np.argmin([np.abs(visibility - table).max() for table in tables])) for visibility in seen.values()]
    return sides, optimum


def cycles(seed):
    """Problems whose visibility is always that of the other of two minima."""
    problem, start = problem_of(seed, ground=False, size=False)
    # Either table hides a part of what is seen: the two halves of the points have different ideas of the depth.
    half = np.flatnonzero(start.visibility > 0.5)
    for shift in range(1, len(half)):
        rolled = np.roll(half, shift)
        tables = [
            np.where(np.isin(np.arange(14), hidden), 0.0, start.visibility)
            for hidden in (rolled[: len(half) // 2], rolled[len(half) // 2 :])
        ]
        depths = [end_of(constant(problem, table), start).state.poses[0].z() for table in tables]
        if abs(depths[0] - depths[1]) > 0.1:
            # Nearer than the split table 0 holds, which leads beyond it, where table 1 holds, which leads back.
            yield problem, start, float(np.mean(depths)), tables if depths[0] > depths[1] else tables[::-1]


@pytest.fixture(scope="module")
def cycle():
    """One that has turned after three updates of visibility already."""
    found = (one for seed in range(1, 9) for one in cycles(seed))
    return next(one for one in found if len(set(turns(*one)[0][:3])) == 2)


@pytest.mark.parametrize("updates", [4, 5, 6, 7])
def test_a_cycle_of_visibility_ends_at_the_better_of_its_states(cycle, updates):
    """However many updates there are: at the minimum under the visibility of the state with the lower energy."""
    problem, start, split, tables = cycle
    strategy = replace(problem.options.strategy, updates=updates)
    problem = replace(problem, options=replace(problem.options, strategy=strategy))
    sides, optimum = turns(problem, start, split, tables)
    assert optimum.unfinished is None
    assert len(set(sides[: updates - 1])) == 2  # it did turn
    held = optimum.state.weights[0].visibility
    energies = []
    for table in tables:
        end = end_of(constant(problem, table), start)
        here = graph_at(flipping(problem, split, tables), end.state)
        again = here.reweigh(here.values(end.state), end.state.weights, 1.0)
        energies.append((sum(here.energies(here.values(end.state), again).values()), again[0].visibility))
    (low, expected), (high, _) = sorted(energies, key=lambda pair: pair[0])
    assert high - low > 0.1
    np.testing.assert_array_equal(held, expected)
    assert optimum.energy <= low + 1e-6
    again = optimise(graph_at(constant(problem, expected), optimum.state), optimum.state)
    assert again.energy == pytest.approx(optimum.energy, abs=1e-6)
    np.testing.assert_allclose(again.state.poses[0].matrix(), optimum.state.poses[0].matrix(), atol=1e-5)


@pytest.mark.parametrize("strategy", ["gnc", "tukey"])
def test_a_loop_that_never_comes_to_rest_says_so(monkeypatch, strategy):
    """Even where every single solve ends at its own minimum."""
    problem, start = problem_of(1, strategy=strategy)
    assert end_of(problem, start).unfinished is None
    monkeypatch.setattr("fgrecon.solve.graph.optimise.REWEIGHTING", replace(SETTINGS.reweighting, still=-1.0))
    optimum = end_of(problem, start)
    assert optimum.failure is None
    assert optimum.unfinished == f"after {optimum.iterations} iterations"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_guess_is_taken_only_downhill(sign):
    """From beside the minimum: along a step towards it the loop goes on, along one away from it it stays."""
    result = solved(1)
    loop = _Loop(result.graph(), result.optimum.state)
    end = loop.values
    step, zero = gtsam.VectorValues(), end.zeroVectors()
    for key in list(end.keys()):
        step.insert(key, np.full(len(zero.at(key)), sign * 1e-3 if key in (X(0, 0), L(0)) else 0.0))
    back = gtsam.VectorValues(step)
    back.scaleInPlace(-sign * 2.0)
    loop.values = beside = end.retract(back)
    energy = loop.energy()
    loop.guess(step, 0.5, energy)
    assert (loop.energy() < energy) is (sign > 0.0)
    assert beside.equals(loop.values, 1e-12) is (sign < 0.0)
