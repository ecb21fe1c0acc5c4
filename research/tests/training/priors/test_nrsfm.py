"""NRSfM on data drawn from the model itself: what is recovered, and that no iteration lowers the likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon_research.training.priors.em_ppca import (
    Cameras,
    Data,
    ShapeModel,
    bound,
    e_step,
    em,
    model_step,
    orthonormal_rows,
    pose_step,
    start_state,
)
from fgrecon_research.training.priors.factorisation import SymmetricSubspace
from fgrecon_research.training.priors.nrsfm import NrsfmOptions, fit_nrsfm
from research.tests.training.priors.nrsfm_data import best_similarity, chair, draw_world

GAUSSIAN = NrsfmOptions(basis=2, dof=None, min_visible=5, restarts=2)


@pytest.fixture(scope="module")
def learnt():
    world = draw_world(0, count=400)
    return world, fit_nrsfm(chair(), world.keypoints, GAUSSIAN)


def test_mean_is_recovered_with_40_percent_missing(learnt):
    world, result = learnt
    moved, _, _ = best_similarity(result.mean, world.mean)
    error = np.sqrt(((moved - world.mean) ** 2).sum(axis=1).mean())
    assert error < 0.006  # metres, of a chair 0.92 m high with noise 5 mm and modes of 30 mm: 0.7 %


def test_subspace_is_recovered(learnt):
    world, result = learnt
    _, rotation, scale = best_similarity(result.mean, world.mean)

    def flat(basis):
        """Without the motions of the mean as a whole, which a camera can take up."""
        centred = world.mean - world.mean.mean(0)
        motions = [np.tile(e, (11, 1)) for e in np.eye(3)] + [np.cross(e, centred) for e in np.eye(3)] + [centred]
        q = np.linalg.qr(np.array(motions).reshape(7, -1).T)[0]
        rows = basis.reshape(len(basis), -1)
        return rows - rows @ q @ q.T

    ours, truth = flat(scale * result.basis @ rotation.T), flat(world.basis)
    a, b = np.linalg.qr(ours.T)[0], np.linalg.qr(truth.T)[0]
    angles = np.degrees(np.arccos(np.clip(np.linalg.svd(a.T @ b, compute_uv=False), 0, 1)))
    assert angles.max() < 12
    assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(truth), rel=0.15)


def test_noise_is_recovered_by_the_restricted_likelihood_and_underestimated_by_the_plain_one(learnt):
    world, result = learnt
    _, _, scale = best_similarity(result.mean, world.mean)
    assert scale * result.sigma == pytest.approx(world.sigma, rel=0.2)
    plain = fit_nrsfm(chair(), world.keypoints, replace(GAUSSIAN, restricted=False, restarts=1))
    _, _, plain_scale = best_similarity(plain.mean, world.mean)
    assert plain_scale * plain.sigma < 0.8 * world.sigma


def test_hidden_keypoints_are_filled_in(learnt):
    world, result = learnt
    hidden = np.isnan(world.keypoints[result.used, :, 0])
    cameras, shapes = result.cameras, result.mean + np.tensordot(result.coefficients, result.basis, axes=1)
    moved = shapes @ cameras.rotation.transpose(0, 2, 1) + cameras.translation[:, None]
    error = np.linalg.norm(moved / cameras.inverse_scale[:, None, None] - world.complete[result.used], axis=2)
    extent = np.ptp(world.complete[result.used], axis=1).max(axis=1)
    assert np.median((error / extent[:, None])[hidden]) < 0.025


def test_the_likelihood_never_falls(learnt):
    history = np.array(learnt[1].history)
    assert len(history) > 5
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1])).all()


def test_object_frame_is_right_handed_with_the_semantic_axes(learnt):
    world, result = learnt
    _, rotation, _ = best_similarity(result.mean, world.mean)
    assert np.degrees(np.arccos((np.trace(rotation) - 1) / 2)) < 3
    assert np.abs(result.mean[chair().mirror] * [1, 1, -1] - result.mean).max() < 1e-12


def test_same_seed_gives_the_same_result():
    world = draw_world(1, count=60, missing=0.2)
    options = replace(GAUSSIAN, restarts=1, iterations=20)
    first, second = (fit_nrsfm(chair(), world.keypoints, options) for _ in range(2))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.basis, second.basis)


@pytest.mark.parametrize("dof", [None, 2.0])
@pytest.mark.parametrize("freedom", [0.0, 6.0])
@pytest.mark.parametrize("symmetric", [True, False])
def test_every_step_raises_the_bound(dof, freedom, symmetric):
    """Each single step of EM against the bound computed afresh, from a start that knows nothing."""
    rng = np.random.default_rng(4)
    world = draw_world(2, count=40)
    seen = np.isfinite(world.keypoints[:, :, 0])
    seen[seen.sum(axis=1) < 5] = True
    points = world.complete - world.complete.mean(axis=1, keepdims=True)
    points = points / np.sqrt((points**2).sum(axis=(1, 2), keepdims=True) / 11) * seen[:, :, None]
    data = Data(points, seen.astype(float), rng.uniform(0.5, 2.0, 40), freedom)
    subspace = SymmetricSubspace.of(11, chair().symmetric_pairs, symmetric)
    model = ShapeModel(
        subspace.project(rng.standard_normal((11, 3))), subspace.project(0.1 * rng.standard_normal((2, 11, 3))), 0.1
    )
    cameras = Cameras(orthonormal_rows(rng.standard_normal((40, 2, 3))), np.ones(40), np.zeros((40, 2)))
    posterior = e_step(data, model, cameras, dof, None)
    value = bound(data, model, cameras, posterior, dof).sum()
    for _ in range(30):
        before = bound(data, model, cameras, posterior, dof)
        cameras = pose_step(data, model, cameras, posterior)
        # the pose step holds q(u): its own bound is compared after q(z) and q(u) follow
        model, posterior = model_step(data, model, cameras, posterior, subspace)
        posterior = e_step(data, model, cameras, dof, posterior.weight if dof else None)
        after = bound(data, model, cameras, posterior, dof)
        assert after.sum() >= before.sum() - 1e-9 * abs(before.sum())
    assert after.sum() > value


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), vectors=st.integers(0, 3), dof=st.sampled_from([None, 1.0, 4.0]))
def test_accelerated_iterations_never_lower_the_bound(seed, vectors, dof):
    world = draw_world(seed, count=25, missing=0.3)
    seen = np.isfinite(world.keypoints[:, :, 0])
    seen[seen.sum(axis=1) < 5] = True
    points = (world.complete - world.complete.mean(axis=1, keepdims=True)) / 100 * seen[:, :, None]
    data = Data(points, seen.astype(float), np.ones(25))
    rng = np.random.default_rng(seed)
    subspace = SymmetricSubspace.of(11, chair().symmetric_pairs, symmetric=True)
    model = ShapeModel(
        subspace.project(rng.standard_normal((11, 3))), subspace.project(rng.standard_normal((vectors, 11, 3))), 0.5
    )
    cameras = Cameras(orthonormal_rows(rng.standard_normal((25, 2, 3))), np.ones(25), np.zeros((25, 2)))
    _, history, _ = em(data, start_state(data, model, cameras, dof), subspace, dof=dof, iterations=30, tolerance=1e-12)
    gains = np.diff(history)
    assert (gains >= -1e-9 * np.abs(history[:-1])).all()


def test_the_bound_is_the_marginal_likelihood_for_gaussian_noise():
    """Against the density of the projected Gaussian, computed without the latent variables."""
    rng = np.random.default_rng(3)
    model = ShapeModel(rng.standard_normal((11, 3)), 0.3 * rng.standard_normal((3, 11, 3)), 0.04)
    cameras = Cameras(orthonormal_rows(rng.standard_normal((1, 2, 3))), np.array([1.7]), np.array([[0.2, -0.1]]))
    seen = np.ones((1, 11))
    seen[0, [2, 7]] = 0.0
    data = Data(rng.standard_normal((1, 11, 2)) * seen[:, :, None], seen, np.ones(1), 0.0)
    value = bound(data, model, cameras, e_step(data, model, cameras, None, None), None)[0]
    kept = np.flatnonzero(seen[0])
    R, a, t = cameras.rotation[0], 1.7, cameras.translation[0]
    mean = ((model.mean[kept] @ R.T + t) / a).ravel()
    design = np.stack([(vector[kept] @ R.T / a).ravel() for vector in model.basis], axis=1)
    covariance = design @ design.T + 0.04 / a**2 * np.eye(len(mean))
    difference = data.points[0, kept].ravel() - mean
    expected = -0.5 * (
        difference @ np.linalg.solve(covariance, difference)
        + np.linalg.slogdet(covariance)[1]
        + len(mean) * np.log(2 * np.pi)
    )
    assert value == pytest.approx(expected, rel=1e-10)


def test_wrong_annotations_hardly_matter_with_robust_noise():
    world = draw_world(5, count=250, missing=0.2)
    keypoints = world.keypoints.copy()
    rng = np.random.default_rng(0)
    swapped = rng.choice(len(keypoints), 40, replace=False)
    keypoints[swapped] = keypoints[swapped][:, np.where(rng.random(11) < 0.3, chair().mirror, np.arange(11))]
    errors = {}
    for dof in (None, 2.0):
        result = fit_nrsfm(chair(), keypoints, replace(GAUSSIAN, dof=dof, restarts=1))
        moved, _, _ = best_similarity(result.mean, world.mean)
        errors[dof] = np.sqrt(((moved - world.mean) ** 2).sum(axis=1).mean())
    assert errors[2.0] < 0.01
    assert errors[2.0] < 0.7 * errors[None]


def test_perspective_is_found_and_taken_out():
    world = draw_world(6, count=250, missing=0.1, nearness=0.5)
    options = replace(GAUSSIAN, basis=2, restarts=1)
    with_it, without = (fit_nrsfm(chair(), world.keypoints, replace(options, perspective=p)) for p in (True, False))
    _, _, scale = best_similarity(with_it.mean, world.mean)
    assert with_it.nearness / scale == pytest.approx(0.5, rel=0.15)
    assert without.nearness == 0
    assert with_it.sigma < 0.8 * without.sigma


def test_more_images_than_the_start_takes():
    world = draw_world(7, count=150, missing=0.2)
    options = replace(GAUSSIAN, restarts=1, start_images=60)
    result = fit_nrsfm(chair(), world.keypoints, options)
    moved, _, _ = best_similarity(result.mean, world.mean)
    assert np.sqrt(((moved - world.mean) ** 2).sum(axis=1).mean()) < 0.01
    assert result.used.sum() == len(result.coefficients) == len(result.cameras.rotation)


def test_views_count_alike():
    world = draw_world(8, count=60, missing=0.1)
    views = np.where(np.arange(60) < 50, "front", "rear")
    options = replace(GAUSSIAN, restarts=1, iterations=10)
    even, plain = (fit_nrsfm(chair(), world.keypoints, options, views=v) for v in (views, None))
    assert np.abs(even.mean - plain.mean).max() > 1e-6
    with pytest.raises(InvalidInputError, match="views"):
        fit_nrsfm(chair(), world.keypoints, options, views=views[:3])


def test_bad_input_is_named():
    world = draw_world(9, count=30, missing=0.0)
    with pytest.raises(InvalidInputError, match="shape"):
        fit_nrsfm(chair(), world.keypoints[:, :5])
    infinite = world.keypoints.copy()
    infinite[3, 4, 0] = np.inf
    with pytest.raises(InvalidInputError, match=r"keypoints\[3\] left_front_seat"):
        fit_nrsfm(chair(), infinite)
    with pytest.raises(DegenerateProblemError, match="0 images"):
        fit_nrsfm(chair(), np.full((5, 11, 2), np.nan))
    hidden = world.keypoints.copy()
    hidden[:, 10] = np.nan
    with pytest.raises(DegenerateProblemError, match="backrest_centre"):
        fit_nrsfm(chair(), hidden)
    with pytest.raises(InvalidInputError, match="basis"):
        NrsfmOptions(basis=-1)


def test_progress_is_reported_and_may_stop_the_work():
    world = draw_world(10, count=40, missing=0.0)
    steps = []
    fit_nrsfm(chair(), world.keypoints, replace(GAUSSIAN, restarts=1, iterations=20), progress=steps.append)
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert 0 < fractions[0] <= fractions[-1] <= 1
    assert steps[-1].iteration == GAUSSIAN.bootstrap  # the draws of other vehicles are work too
    assert fractions[-1] == 1

    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_nrsfm(chair(), world.keypoints, GAUSSIAN, progress=stop)
