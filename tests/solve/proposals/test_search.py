"""The search over many poses at once: exact on exact data, monotone, deterministic, and not fooled by flips."""

import numpy as np
import pytest

from fgrecon.core.camera import Ground
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.search import search
from fgrecon.solve.proposals.starts import at_azimuths, view_box
from fgrecon.solve.proposals.terms import CoefficientTerm, Hypotheses, Quadratic
from tests.cars import CAMERA, observe, pose_energy, rotation_angle, yaw_pose
from tests.settings import options

CLOCK = np.arange(24) * np.pi / 12
GROUND = Ground.level(1.65)
NO_BOX = {"strategy": "huber", "box_model": "off"}


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def starts_of(observation, model, ground=None):
    return at_azimuths(view_box(observation), CAMERA, model, ground, CLOCK, relative=True)


@pytest.mark.parametrize("box", [False, True])
@pytest.mark.parametrize("ground", [None, GROUND], ids=["free", "ground"])
@pytest.mark.parametrize("degrees", range(7, 360, 30))
def test_exact_from_exact_keypoints(prior, degrees, ground, box):
    """Pose and coefficients from any azimuth; the second search has so little noise that the prior's pull vanishes."""
    truth, coefficients = yaw_pose(np.radians(degrees)), np.random.default_rng(degrees).normal(size=5)
    observation = observe(prior, truth, coefficients, box=box)
    coarse, model = pose_energy(prior, observation, ground=ground, options=options(**NO_BOX))
    found = search(coarse, starts_of(observation, model, ground), 10, {5: 3})
    fine, _ = pose_energy(
        prior, observation, ground=ground, options=options(**NO_BOX, sigma_relative=0, sigma_pixels=0.003)
    )
    best = search(fine, found.hypotheses, 60, {}).hypotheses
    assert rotation_angle(best.rotation[0], truth) < 1e-5
    np.testing.assert_allclose(best.translation[0], truth[:3, 3], atol=1e-3)
    np.testing.assert_allclose(best.coefficients[0], coefficients, atol=1e-3)


@pytest.mark.parametrize("degrees", range(0, 360, 30))
@pytest.mark.parametrize("box", [False, True])
def test_flips_are_resolved_by_the_defaults(prior, degrees, box):
    """Rough keypoints of which the hidden half is unsure: no azimuth ends turned around."""
    truth = yaw_pose(np.radians(degrees))
    observation = observe(prior, truth, noise=4.0, seed=degrees, box=box)
    problem, model = pose_energy(prior, observation)
    best = search(problem, starts_of(observation, model), 10, {2: 12, 4: 5, 6: 3}).hypotheses
    assert np.degrees(rotation_angle(best.rotation[0], truth)) < 12


@pytest.mark.parametrize("swap", [(4, 6), (5, 7)], ids=["left lamps", "right lamps"])
def test_a_confident_mirror_mistake_does_not_turn_the_car(prior, swap):
    truth = yaw_pose(np.radians(-60))
    observation = observe(prior, truth)
    pixels, confidence = observation.keypoints.copy(), observation.confidence.copy()
    pixels[list(swap)] = pixels[list(swap)[::-1]]
    confidence[list(swap)] = 0.9
    problem, model = pose_energy(prior, Observation(pixels, confidence, observation.box))
    best = search(problem, starts_of(observation, model), 10, {2: 12, 4: 5, 6: 3}).hypotheses
    assert np.degrees(rotation_angle(best.rotation[0], truth)) < 12


@pytest.fixture(scope="module", params=["mixture", "huber", "gnc"])
def noisy(request, prior):
    """A hard observation: wrong points among right ones."""
    rng = np.random.default_rng(3)
    observation = observe(prior, yaw_pose(0.8), noise=5.0)
    pixels = observation.keypoints.copy()
    pixels[[0, 5, 10]] += rng.normal(size=(3, 2)) * 60
    observation = Observation(pixels, rng.uniform(0.05, 0.9, 14), observation.box)
    problem, model = pose_energy(prior, observation, ground=GROUND, options=Options(strategy=request.param))
    return problem, starts_of(observation, model, GROUND)


def test_no_energy_above_any_start(noisy):
    problem, starts = noisy
    before = problem.evaluate(starts)[0].energy
    for iterations in (0, 1, 3, 10):
        result = search(problem, starts, iterations, {2: 12, 4: 5})
        assert result.energy[0] <= before.min() + 1e-9
        assert (np.diff(result.energy) >= 0).all()
        np.testing.assert_allclose(result.energy, problem.evaluate(result.hypotheses)[0].energy, rtol=1e-11)


def test_pruning_keeps_the_winner(noisy):
    """Dropping losers early ends where keeping them all ends."""
    problem, starts = noisy
    pruned, whole = (search(problem, starts, 10, keep) for keep in ({2: 12, 4: 5, 6: 3}, {}))
    assert 1 <= len(pruned.energy) <= 3  # at most, as those that turn alike are one
    assert len(whole.energy) == len(starts)
    assert pruned.energy[0] == pytest.approx(whole.energy[0], abs=0.02)


def test_bit_for_bit(noisy):
    problem, starts = noisy
    first, second = (search(problem, starts, 10, {2: 12, 4: 5, 6: 3}) for _ in range(2))
    for name in ("energy", "weights", "path_weights"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.hypotheses.matrices().tobytes() == second.hypotheses.matrices().tobytes()
    assert first.path.matrices().tobytes() == second.path.matrices().tobytes()


def test_the_path_leads_from_a_start_to_the_result_downhill(noisy):
    problem, starts = noisy
    result = search(problem, starts, 10, {2: 12, 4: 5, 6: 3})
    path = result.path.matrices()
    assert any((path[0] == start).all() for start in starts.matrices())
    assert path[-1].tobytes() == result.hypotheses.matrices()[0].tobytes()
    assert (np.diff(problem.evaluate(result.path)[0].energy) <= 1e-12).all()
    assert len(result.path_weights) == len(path)


def test_a_hypothesis_does_not_depend_on_the_others(noisy):
    problem, starts = noisy
    whole = search(problem, starts, 6, {})
    alone = [search(problem, starts.take(np.array([i])), 6, {}).energy[0] for i in range(len(starts))]
    np.testing.assert_allclose(np.sort(alone), whole.energy, rtol=1e-6, atol=1e-3)


def test_starts_behind_the_camera_lose(prior):
    truth = yaw_pose(0.3)
    observation = observe(prior, truth)
    problem, model = pose_energy(prior, observation)
    behind = Hypotheses.at_poses(np.array([yaw_pose(0.3, (0.0, 1.65, -5.0)), yaw_pose(0.3, (0.0, 1.0, 0.0))]), 5)
    good = starts_of(observation, model)
    both = Hypotheses(
        np.concatenate([behind.rotation, good.rotation]),
        np.concatenate([behind.translation, good.translation]),
        np.concatenate([behind.coefficients, good.coefficients]),
    )
    best = search(problem, both, 10, {2: 12, 4: 5, 6: 3})
    assert np.isfinite(best.energy).all()
    assert np.degrees(rotation_angle(best.hypotheses.rotation[0], truth)) < 3
    alone = search(problem, behind, 10, {})
    assert (alone.energy == np.inf).all()
    assert {m.tobytes() for m in alone.hypotheses.matrices()} == {m.tobytes() for m in behind.matrices()}


def test_energies_by_term_add_up(noisy):
    problem, starts = noisy
    total = problem.evaluate(starts)[0].energy
    parts = problem.energies(starts)
    assert set(parts) == {"reprojection", "box", "ground", "coefficients"}
    np.testing.assert_allclose(sum(parts.values()), total, rtol=1e-12)


def test_the_search_minimises_every_term(prior):
    """Energy, gradient and matrix are the sums over keypoints, box, size, ground and the coefficients' prior."""
    observation = observe(prior, yaw_pose(0.8), noise=3.0)
    problem, model = pose_energy(prior, observation, ground=GROUND, size=SIZE_PRIORS["kitti"])
    starts = starts_of(observation, model, GROUND)
    h = Hypotheses(starts.rotation, starts.translation, np.random.default_rng(0).normal(size=(len(starts), 5)))
    parts = [Quadratic(len(h), 11) for _ in range(5)]
    problem.keypoints.add(parts[0], h, problem.visibility(h.matrices()), 1.0)
    for part, term in zip(parts[1:4], (problem.box, problem.size, problem.ground), strict=True):
        term.add(part, h)
    CoefficientTerm().add(parts[4], h)
    total, _ = problem.evaluate(h)
    for name in ("energy", "gradient", "matrix"):
        assert all(np.abs(getattr(part, name)).max() > 1e-3 for part in parts)
        np.testing.assert_allclose(getattr(total, name), sum(getattr(part, name) for part in parts), rtol=1e-9)
    assert set(problem.energies(h)) == {"reprojection", "box", "dimensions", "ground", "coefficients"}
    np.testing.assert_allclose(sum(problem.energies(h).values()), total.energy, rtol=1e-12)
