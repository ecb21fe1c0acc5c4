"""From NRSfM to a metric prior: axes, scale, origin; comparing priors; real annotations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.shape_errors import expression_error, mean_error
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon_research.io.annotations import Annotations, load_annotations, spread
from fgrecon_research.training.priors.canonical_frame import (
    at_ground_level,
    levelled,
    metric_scale,
    metric_stretch,
    object_axes,
)
from fgrecon_research.training.priors.compare import align, compare_priors
from fgrecon_research.training.priors.factorisation import SymmetricSubspace, affine_factorisation, metric_upgrade
from fgrecon_research.training.priors.learn import default_size, learn_prior
from fgrecon_research.training.priors.nrsfm import NrsfmOptions
from research.tests.training.priors.nrsfm_data import chair, chair_mean, draw_world

CHAIR_SIZE = SizePrior("chair", np.array([0.5, 0.45, 0.92]), np.array([0.05, 0.05, 0.05]))


def random_orthogonal(seed, reflect):
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if (np.linalg.det(q) < 0) == reflect else -q


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000), reflect=st.booleans(), scale=st.floats(0.1, 10))
def test_object_axes_undo_any_rotation_and_depth_reversal(seed, reflect, scale):
    turn = random_orthogonal(seed, reflect)
    truth = chair_mean()
    axes = object_axes(chair(), scale * truth @ turn)
    np.testing.assert_allclose(scale * truth @ turn @ axes, scale * truth @ object_axes(chair(), truth), atol=1e-9)
    assert np.sign(np.linalg.det(axes)) == (-1 if reflect else 1)
    np.testing.assert_allclose(object_axes(chair(), truth), np.eye(3), atol=0.03)


def test_axes_need_groups_apart():
    flat = chair_mean()
    flat[:, 2] = 0.0
    with pytest.raises(DegenerateProblemError, match=r"dimensions\.width"):
        object_axes(chair(), flat)
    low = chair_mean()
    low[:, 1] *= 1e-3
    with pytest.raises(DegenerateProblemError, match=r"dimensions\.height"):
        object_axes(chair(), low)


def test_scale_and_ground():
    mean = chair_mean()
    assert metric_scale(chair(), 3.0 * mean, CHAIR_SIZE) == pytest.approx(metric_scale(chair(), mean, CHAIR_SIZE) / 3)
    with pytest.raises(DegenerateProblemError):
        metric_scale(chair(), -mean, CHAIR_SIZE)
    moved = at_ground_level(chair(), np.stack([mean + np.array([1.0, 2.0, 3.0]), 2 * mean]))
    feet = list(chair().ground_keypoints)
    np.testing.assert_allclose(moved[:, feet, 1].mean(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(moved[0], at_ground_level(chair(), mean), atol=1e-12)
    vector = np.random.default_rng(0).standard_normal((1, 11, 3))
    level = levelled(chair(), mean, vector)[0]
    x = mean[feet, 0] - mean[feet, 0].mean()
    assert level[feet, 1] @ x == pytest.approx(0, abs=1e-12)


def test_proportions_go_to_those_of_the_fleet():
    mean = 3.0 * chair_mean() * [1.2, 1.0, 0.9]
    boxes = {}
    for share in (0.0, 0.5, 1.0):
        moved = mean * metric_stretch(chair(), mean, CHAIR_SIZE, share)
        boxes[share] = np.tensordot(chair().dimension_operator, moved, axes=2)
    np.testing.assert_allclose(metric_stretch(chair(), mean, CHAIR_SIZE, 0.0), metric_scale(chair(), mean, CHAIR_SIZE))
    np.testing.assert_allclose(boxes[1.0], CHAIR_SIZE.mean)
    np.testing.assert_allclose(boxes[0.5], np.sqrt(boxes[0.0] * boxes[1.0]))
    with pytest.raises(InvalidInputError, match="proportions"):
        learn_prior(Annotations(chair(), np.zeros((5, 11, 2))), size=CHAIR_SIZE, proportions=1.5)


@pytest.fixture(scope="module")
def sure():
    """A chair from 120 images, with how sure its mean is, by what the images are said to show."""
    world = draw_world(3, count=120, missing=0.2)
    options = NrsfmOptions(basis=2, min_visible=6, restarts=1, bootstrap=6)

    def learn(bootstrap=6, vehicles=None):
        how = replace(options, bootstrap=bootstrap)
        return learn_prior(Annotations(chair(), world.keypoints, vehicles=vehicles), size=CHAIR_SIZE, options=how).prior

    return learn


def test_a_mean_says_how_sure_it_is_and_nothing_else_changes(sure):
    alone, without = sure(), sure(bootstrap=0)
    np.testing.assert_array_equal(alone.mean, without.mean)
    np.testing.assert_array_equal(alone.basis, without.basis)
    assert without.mean_sigma is None
    np.testing.assert_allclose(alone.mean_sigma, alone.mean_sigma[chair().mirror], atol=1e-12)
    error = np.abs(alone.mean - at_ground_level(chair(), chair_mean()))
    assert 0.0005 < np.sqrt(np.square(alone.mean_sigma).mean()) < 0.02  # metres; the error's own size
    assert np.sqrt(np.square(error).mean()) < 5.0 * np.sqrt(np.square(alone.mean_sigma).mean())


def test_few_vehicles_are_less_sure_than_many(sure):
    few = sure(vehicles=np.repeat(np.arange(4), 30))
    assert np.square(few.mean_sigma).mean() > np.square(sure().mean_sigma).mean()
    with pytest.raises(InvalidInputError, match="vehicles"):
        sure(vehicles=np.arange(7))
    for draws in (-1, 1):
        with pytest.raises(InvalidInputError, match="bootstrap"):
            NrsfmOptions(bootstrap=draws)


def test_align_undoes_a_similarity():
    shape = chair_mean()
    moved, scale, rotation = align(2.5 * shape @ random_orthogonal(3, reflect=False) + 4.0, shape)
    np.testing.assert_allclose(moved, shape, atol=1e-12)
    assert scale == pytest.approx(0.4)
    assert np.linalg.det(rotation) == pytest.approx(1)
    with pytest.raises(DegenerateProblemError):
        align(np.zeros((4, 3)), np.zeros((4, 3)))


def test_factorisation_is_exact_on_a_rigid_shape_without_noise():
    world = draw_world(3, count=60, vectors=0, sigma=0.0, missing=0.3)
    seen = np.isfinite(world.keypoints[:, :, 0])
    seen[seen.sum(axis=1) < 5] = True
    points = np.where(seen[:, :, None], world.complete, 0.0)
    points = (points - points.sum(axis=1, keepdims=True) / seen.sum(axis=1)[:, None, None]) * seen[:, :, None]
    points /= np.sqrt((points**2).sum(axis=(1, 2), keepdims=True) / seen.sum(axis=1)[:, None, None])
    for symmetric in (True, False):
        subspace = SymmetricSubspace.of(11, chair().symmetric_pairs, symmetric)
        best = None
        for start in range(4):
            shape, cameras, error = affine_factorisation(
                points, seen.astype(float), subspace, np.random.default_rng(start), 1000
            )
            upgraded = metric_upgrade(shape, cameras, subspace)
            if upgraded is not None and (best is None or error < best[1]):
                best = upgraded[0], error
        shape = best[0] @ object_axes(chair(), best[0])
        assert np.linalg.norm(align(shape, chair_mean())[0] - chair_mean(), axis=1).max() < 0.02


def test_a_chair_from_made_up_annotations_end_to_end():
    """Nothing here is of a car: category, size and annotations are a chair's."""
    world = draw_world(0, count=300, missing=0.3)
    learnt = learn_prior(
        Annotations(chair(), world.keypoints),
        size=CHAIR_SIZE,
        options=NrsfmOptions(basis=2, min_visible=6, restarts=2),
        name="chair",
    )
    prior = learnt.prior
    assert prior.is_symmetric
    feet = prior.mean[list(chair().ground_keypoints), 1]
    np.testing.assert_allclose(feet, 0.0, atol=0.01)
    np.testing.assert_allclose(prior.mean, at_ground_level(chair(), chair_mean()), atol=0.02)
    np.testing.assert_allclose(prior.box_size(np.zeros(2)), CHAIR_SIZE.mean, rtol=0.1)
    assert expression_error(prior, world.mean + np.tensordot(world.coefficients[:20], world.basis, 1)).mean() < 0.012
    assert (prior.offset_sigma > 0).all()
    assert prior.explained.sum() > 0.7
    assert "scaled orthography" in prior.provenance["method"]
    with pytest.raises(InvalidInputError, match="length,width,height"):
        default_size(chair())


def test_comparing_a_prior_with_itself_moved_and_scaled():
    prior = load_prior("car14")
    same = compare_priors(prior.scaled(1.3), prior)
    assert same.percent == pytest.approx(0, abs=1e-6)
    assert same.scale == pytest.approx(1 / 1.3)
    np.testing.assert_allclose(same.angles, 0, atol=1e-4)
    np.testing.assert_allclose(same.shared_variance, 1, atol=1e-9)
    bent = replace(prior, mean=prior.mean + np.eye(14, 3) * 0.1)
    assert compare_priors(bent, prior).rms > 0.01
    with pytest.raises(InvalidInputError, match="in common"):
        compare_priors(
            learn_prior(
                Annotations(chair(), draw_world(0, count=40, missing=0.0).keypoints),
                size=CHAIR_SIZE,
                options=NrsfmOptions(basis=0, restarts=1, iterations=4),
            ).prior,
            prior,
        )


def test_expression_error_of_shapes_in_the_span_is_zero():
    prior = load_prior("car14")
    shapes = np.stack([1.2 * prior.keypoints(c) for c in np.eye(5) * 0.5])
    assert expression_error(prior, shapes).max() < 1e-9
    inside = np.stack([prior.keypoints(c) for c in np.eye(5)])
    assert expression_error(prior, inside, similarity=False).max() < 1e-9
    assert expression_error(prior.truncated(0), 2.0 * prior.mean[None])[0] == pytest.approx(0, abs=1e-12)
    assert compare_priors(prior.truncated(0), prior).shared_variance[0] == 0


@pytest.mark.data
def test_300_real_images_give_the_shape_of_79_real_cars(data):
    """No coordinate of a car is known at the start: factorisation, pairs and dimension groups alone."""
    category = load_category("car14")
    annotations = load_annotations([data / "veri_keypoints14/keypoints.npz"], category)
    chosen = annotations.select(spread(annotations, 300, np.random.default_rng(0)))
    learnt = learn_prior(replace(chosen, vehicles=None), options=NrsfmOptions(restarts=2))
    cars = np.load(data / "apollo79/apollo79_car14.npz")["keypoints"]
    _, percent, _ = mean_error(learnt.prior, cars)
    assert percent <= 1.7
    assert expression_error(learnt.prior, cars).mean() < 0.08
    history = np.array(learnt.nrsfm.history)
    assert (np.diff(history) >= -1e-9 * np.abs(history[:-1])).all()
    assert learnt.nrsfm.converged
