"""Newton's method with acceleration: it ends at a minimum, few steps from anywhere, and says where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from factors.mixture import Form
from fgrecon.core.camera import Ground
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph import newton
from fgrecon.solve.graph.anderson import Anderson
from fgrecon.solve.graph.graph import Graph, GraphObservation
from fgrecon.solve.graph.multi_start import start_state
from fgrecon.solve.graph.newton import Descent
from fgrecon.solve.graph.optimise import _Loop, optimise
from fgrecon.solve.proposals.pose_search import search_pose
from tests.cars import observe, pose_problem, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.support import half_a_car, problem_of


def descent_of(problem, start):
    state = start_state([GraphObservation(problem)], [start])
    graph = Graph([GraphObservation(problem)], state, pose_free=True)
    assert graph.is_robust
    return Descent(graph, state)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "settings", [{}, {"free_offsets": True, "disabled_terms": ("planarity", "laplacian")}], ids=str
)
def test_the_end_is_where_re_weighting_stays(seed, settings):
    """The loop of re-weighting, another algorithm for the same energy, does not leave it; and there it is steady."""
    problem, start = problem_of(seed, **settings)
    descent = descent_of(problem, start)
    descent.run()
    assert descent.converged
    assert descent.iterations < 25
    graph = descent.graph
    loop = _Loop(graph, graph.read(descent.values, descent.weights))
    energy = sum(graph.energies(descent.values, descent.weights).values())
    loop.reweigh(1.0)
    loop.settle()
    assert loop.converged
    moved = descent.values.localCoordinates(loop.values).vector()
    assert np.abs(moved).max() < 1e-5
    assert loop.energy() == pytest.approx(energy, abs=1e-8)
    (again,) = graph.reweigh(descent.values, descent.weights, 1.0)
    np.testing.assert_allclose(again.visibility, descent.weights[0].visibility, atol=1e-9)  # followed to the end


@pytest.mark.parametrize("seed", range(4))
def test_a_step_of_gtsams_from_the_end_moves_nothing(seed):
    """Of the graph as it is built, with Python's callbacks: the rows compiled and their elimination are the same."""
    problem, start = problem_of(seed, free_offsets=True)
    descent = descent_of(problem, start)
    descent.run()
    built = descent.graph.build(descent.weights, Form.NEWTON)
    linear = built.linearize(descent.values)
    assert np.abs(linear.optimize().vector()).max() < 2.0 * newton.NEWTON.steady
    moved = descent.values.retract(linear.optimize())
    assert built.error(descent.values) - built.error(moved) < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_an_end_before_the_minimum_is_near_it_and_takes_fewer_steps(seed):
    """Its energy may even be lower, by as much as visibility changes it in the steps that are left."""
    problem, proposal = problem_of(seed)
    start = start_state([GraphObservation(problem)], [proposal])
    near, end = (
        optimise(Graph([GraphObservation(problem)], start, pose_free=True), start, steady=steady)
        for steady in (1e-2, None)
    )
    assert near.iterations < end.iterations
    assert -1e-3 < near.energy - end.energy < 0.05


def test_the_energy_is_lower_than_at_the_start_and_every_iterate_is_kept():
    problem, start = problem_of(1)
    descent = descent_of(problem, start)
    descent.run()
    assert len(descent.steps) == descent.iterations > 3
    assert descent.steps[-1].values is descent.values
    energy = sum(descent.graph.energies(descent.values, descent.weights).values())
    assert energy < descent.first


def test_visibility_that_swings_is_held(monkeypatch):
    """Every look shows another half of the car: the steps end all the same, with what was seen where it was best."""
    problem, start = problem_of(2)
    looks = []

    def swinging(poses):
        looks.append(None)
        half = np.arange(14) % 2 == len(looks) % 2
        return np.tile(np.where(half, 0.9, 0.1), (len(poses), 1))

    problem = replace(problem, energy=replace(problem.energy, visibility=swinging))
    descent = descent_of(problem, start)
    descent.run()
    assert descent.converged
    assert newton.NEWTON.followed_iterations < descent.iterations < newton.NEWTON.followed_iterations + 30


def test_a_direction_that_nothing_determines_is_levenberg_marquardts():
    """Gauss and Newton's system is singular there: GTSAM damps it, and the covariance is not there."""
    problem, start = half_a_car()
    descent = descent_of(problem, start)
    descent.graph.vehicles[0]._solved.clear()  # without lambda's prior nothing but five points is left
    descent.run()
    assert np.isfinite(sum(descent.graph.energies(descent.values, descent.weights).values()))


def test_cars_on_a_crease_of_their_outline_come_to_rest(monkeypatch):
    """Seen square on and wider than its box, without keypoints that say how it is turned: no step needs damping."""
    monkeypatch.setattr(newton, "minimise", None)
    iterations = [_on_a_crease(seed) for seed in range(24)]
    assert sorted(iterations)[-2] < newton.NEWTON.followed_iterations  # one of 72 takes twice as many


def _on_a_crease(seed):
    seen = observe(
        load_prior("car14"), yaw_pose(np.radians(90 + seed), (0.25 * seed, 1.65, 12.0)), noise=2.0, seed=seed
    )
    left, top, right, bottom = seen.box
    narrow = np.array([left + 0.06 * (right - left), top, right - 0.06 * (right - left), bottom])
    faint = replace(seen, confidence=np.full(14, 0.02), box=narrow)
    given = {"size": SIZE_PRIORS["kitti"], "ground": Ground.level(1.65)}
    options = make_options(free_offsets=False, box_model="cuboid")
    problem, _ = pose_problem(load_prior("car14"), faint, options=options, **given)
    descent = descent_of(problem, search_pose(problem))
    descent.run()
    assert descent.converged
    return descent.iterations


def test_a_step_up_is_not_taken(monkeypatch):
    problem, start = problem_of(3)
    monkeypatch.setattr(Anderson, "propose", lambda _self, step: -50.0 * step)
    descent = descent_of(problem, start)
    descent.run()
    assert descent.converged


@pytest.mark.parametrize("rests", [True, False])
def test_steps_that_never_end_are_left_to_levenberg_marquardt_which_says_whether_it_rests(monkeypatch, rests):
    problem, start = problem_of(1)
    usual = descent_of(problem, start)
    usual.run()
    original = newton.minimise
    monkeypatch.setattr(newton, "NEWTON", replace(newton.NEWTON, steady=-1.0))
    monkeypatch.setattr(newton, "minimise", lambda *a, **b: replace(original(*a, **b), converged=rests))
    descent = descent_of(problem, start)
    descent.run()
    assert descent.converged is rests
    assert np.abs(usual.values.localCoordinates(descent.values).vector()).max() < 1e-6


def test_one_image_that_swings_is_held_and_the_others_follow_their_poses(monkeypatch):
    """Of three images one shows another half of the car at every look; without holding it none ever ends."""
    found = [problem_of(seed) for seed in (1, 2, 3)]
    seen = [GraphObservation(problem, image=i) for i, (problem, _) in enumerate(found)]
    state = start_state(seen, [start for _, start in found])
    descent = Descent(Graph(seen, state, pose_free=True), state)
    swinging = descent.graph.observations[1]
    look, looks = swinging.reweigh, []

    def other_half(values, before, progress, *, hold=False):
        weights = look(values, before, progress, hold=hold)
        if hold:
            return weights
        looks.append(1)
        half = np.where(np.arange(14) % 2 == len(looks) % 2, 0.9, 0.1)
        return look(values, replace(weights, visibility=half), progress, hold=True)

    monkeypatch.setattr(swinging, "reweigh", other_half)
    monkeypatch.setattr(descent.graph, "_judges", False)  # or the kernel looks
    descent.run()
    assert descent.converged
    assert descent.iterations < newton.NEWTON.followed_iterations
    assert descent._swinging.held == {1}
    for i in (0, 2):
        (part, weights) = descent.graph.observations[i], descent.weights[i]
        again = part.reweigh(descent.values, weights, 1.0)
        np.testing.assert_allclose(again.visibility, weights.visibility, atol=1e-8)


def test_a_pose_settles_apart_at_the_minimum_of_its_own_image():
    """As an optimisation of that image alone ends; the other image, the shape and what was before stay as they are."""
    found = [problem_of(seed) for seed in (1, 2)]
    seen = [GraphObservation(problem, image=i) for i, (problem, _) in enumerate(found)]
    state = start_state(seen, [start for _, start in found])
    descent = Descent(Graph(seen, state, pose_free=True), state)
    before = descent.values
    descent._settle_apart({1})
    alone, there = descent.graph.alone(1, before, state.weights)
    settled = _Loop(alone, there)
    settled.settle()
    key = descent.graph.observations[1].pose_key
    expected, pose = settled.values.atPose3(key), descent.values.atPose3(key)
    np.testing.assert_allclose(pose.matrix(), expected.matrix(), atol=1e-6)
    assert not pose.equals(before.atPose3(key), 1e-4)
    changed = before.localCoordinates(descent.values)
    others = [changed.at(each) for each in descent.values.keys() if each != key]  # noqa: SIM118
    np.testing.assert_allclose(np.concatenate(others), 0.0, atol=1e-12)


def test_a_look_after_an_energy_with_another_visibility_is_a_look():
    """What the kernel made of a state is kept, but not what it made of it with a visibility that was held."""
    problem, start = problem_of(1)
    descent = descent_of(problem, start)
    part, values = descent.graph.observations[0], descent.values
    (fresh,) = descent.graph.reweigh(values, descent.weights, 1.0)
    part.energies(values, replace(fresh, visibility=np.full(len(fresh.visibility), 0.5)))
    (again,) = descent.graph.reweigh(values, descent.weights, 1.0)
    np.testing.assert_array_equal(again.visibility, fresh.visibility)
