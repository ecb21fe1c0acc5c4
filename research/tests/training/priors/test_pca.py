"""Priors from 3D shapes: against numpy's SVD, against the truth on drawn data, symmetric."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.solve.vehicle.conditioning import express
from fgrecon_research.training.priors.pca import SurfaceSamples, fit_linear_model, pca_prior

CATEGORY = load_category("car14")
FLIP = np.array([1.0, 1.0, -1.0])
MEAN = load_prior("car14").mean


def low_rank(rows, size, spreads, noise, seed):
    """Rows drawn from the model itself, with the truth."""
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(size, len(spreads))))[0]
    mean = rng.normal(size=size)
    data = mean + rng.normal(size=(rows, len(spreads))) * spreads @ directions.T
    return data + noise * rng.normal(size=data.shape), directions


def angle(a, b):
    """Largest angle between two subspaces, degrees."""
    return np.degrees(np.arccos(np.clip(np.linalg.svd(a.T @ b)[1].min(), -1, 1)))


def shapes(count, seed, asymmetry=0.02):
    """Cars drawn from the shipped prior, with noise of their own."""
    rng = np.random.default_rng(seed)
    prior = load_prior("car14")
    drawn = prior.mean + np.tensordot(rng.normal(size=(count, 5)), prior.basis, axes=1)
    return drawn + asymmetry * rng.normal(size=drawn.shape)


class TestLinearModel:
    def test_complete_data_is_the_singular_value_decomposition(self):
        data = np.random.default_rng(0).normal(size=(30, 8)) * np.arange(1, 9)
        model = fit_linear_model(data, 3)
        covariance = np.cov(data.T)
        values, vectors = np.linalg.eigh(covariance)
        assert model.mean == pytest.approx(data.mean(axis=0))
        assert model.std**2 == pytest.approx(values[::-1][:3])
        assert model.explained == pytest.approx(values[::-1][:3] / values.sum())
        assert angle(model.directions, vectors[:, ::-1][:, :3]) < 1e-5
        assert model.scores.std(axis=0, ddof=1) == pytest.approx(np.ones(3))
        assert model.scores.T @ model.scores == pytest.approx(29 * np.eye(3), abs=1e-9)
        left = data - model.mean - model.scores * model.std @ model.directions.T
        assert model.residual == pytest.approx((left**2).mean(axis=0))

    def test_weights_count_like_repeated_rows(self):
        data = np.random.default_rng(1).normal(size=(12, 4)) * [4, 3, 2, 1]
        weights = np.array([3, 1] * 6)
        weighted = fit_linear_model(data, 2, weights)
        repeated = fit_linear_model(np.repeat(data, weights, axis=0), 2)
        assert weighted.mean == pytest.approx(repeated.mean)
        assert np.abs(weighted.directions.T @ repeated.directions) == pytest.approx(np.eye(2), abs=1e-9)
        assert weighted.explained == pytest.approx(repeated.explained)
        assert weighted.effective == pytest.approx(24**2 / (6 * 9 + 6))
        # A row of weight zero changes nothing and gets the mean's coefficients.
        more = fit_linear_model(np.vstack([data, [100.0, 0, 0, 0]]), 2, [*weights, 0])
        assert more.std == pytest.approx(weighted.std)
        assert (more.scores[-1] == 0).all()

    def test_predicted_residual_is_what_held_out_rows_show(self):
        """In-sample residuals are 20 % too small here; the prediction is within 5 %."""
        data = low_rank(60, 20, [3.0, 2.0, 1.0, 0.8, 0.6], 0.3, seed=6)[0]
        held_out = np.zeros_like(data)
        for i in range(len(data)):
            rest = fit_linear_model(np.delete(data, i, axis=0), 5)
            off = data[i] - rest.mean
            held_out[i] = off - rest.directions @ (rest.directions.T @ off)
        truth = np.sqrt((held_out**2).mean())
        model = fit_linear_model(data, 5)
        assert np.sqrt(model.predicted_residual.mean()) == pytest.approx(truth, rel=0.05)
        assert np.sqrt(model.residual.mean()) < 0.9 * truth

    @pytest.mark.parametrize(
        ("rows", "count", "weights", "error"),
        [
            (np.zeros(3), 1, None, "rows"),
            (np.full((4, 3), np.inf), 1, None, "rows"),
            (np.eye(4), 4, None, "0 to 3 directions for 4 rows"),
            (np.eye(4), -1, None, "count"),
            (np.zeros((0, 4)), 0, None, "weights"),
            (np.eye(4), 1, [1, 1, 1, -1], "weights"),
            (np.eye(4), 1, [1, 1, 1], "weights"),
        ],
    )
    def test_errors(self, rows, count, weights, error):
        with pytest.raises(InvalidInputError, match=error):
            fit_linear_model(rows, count, weights)


class TestPrior:
    def test_unsymmetric_prior_is_plain_pca(self):
        data = shapes(40, 0)
        prior = pca_prior(CATEGORY, data, basis=4, symmetric=False)
        flat = data.reshape(40, -1)
        singular, right = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[1:]
        assert prior.mean.ravel() == pytest.approx(flat.mean(axis=0))
        expected = right[:4] * (singular[:4] / np.sqrt(39))[:, None]
        signs = np.sign((prior.basis.reshape(4, -1) * expected).sum(axis=1))
        assert prior.basis.reshape(4, -1) == pytest.approx(expected * signs[:, None], abs=1e-9)
        assert prior.explained == pytest.approx(singular[:4] ** 2 / (singular**2).sum())
        assert not prior.is_symmetric

    def test_symmetric_prior_is_pca_of_shapes_and_mirror_images(self):
        data = shapes(40, 1)
        average = (data + data[:, CATEGORY.mirror] * FLIP) / 2
        symmetric = pca_prior(CATEGORY, data, basis=4)
        plain = pca_prior(CATEGORY, average, basis=4, symmetric=False)
        assert symmetric.mean == pytest.approx(plain.mean)
        assert symmetric.basis == pytest.approx(plain.basis, abs=1e-8)
        assert symmetric.explained == pytest.approx(plain.explained)
        assert symmetric.offset_sigma == pytest.approx(plain.offset_sigma)

    @settings(max_examples=15, deadline=None, derandomize=True)
    @given(seed=st.integers(0, 10**6))
    def test_symmetric_to_the_last_bit(self, seed):
        data = shapes(40, seed)
        rng = np.random.default_rng(seed)
        vertices = rng.normal(size=(40, 4, 3))
        samples = SurfaceSamples(vertices, np.array([[0, 1, 2]], dtype=np.int32), np.array([1, 0, 2, 3]))
        prior = pca_prior(CATEGORY, data, basis=3, surface=samples)
        for array in (prior.mean[None], prior.basis):
            assert np.array_equal(array, array[:, CATEGORY.mirror] * FLIP)
        for array in (prior.surface.mean[None], prior.surface.basis):
            assert np.array_equal(array, array[:, samples.mirror] * FLIP)
        keypoints = prior.keypoints(rng.normal(size=3) * 3)
        # Hence mirrored quads are planar for every lambda.
        for face in CATEGORY.faces:
            corners = keypoints[list(face.keypoints)]
            assert np.linalg.svd(corners - corners.mean(axis=0))[1][2] < 1e-12

    def test_signs_say_larger(self):
        for symmetric in (True, False):
            prior = pca_prior(CATEGORY, shapes(40, 6), basis=5, symmetric=symmetric)
            for unit in np.eye(5):
                change = prior.box_size(unit) - prior.box_size(np.zeros(5))
                assert change[np.abs(change).argmax()] > 0

    def test_offset_sigma_is_what_is_left_of_fresh_cars(self):
        rng = np.random.default_rng(7)
        sigma = np.repeat(rng.uniform(0.02, 0.08, 7), 2)[:, None]
        basis = load_prior("car14").basis
        drawn = MEAN + np.tensordot(rng.normal(size=(400, 5)), basis, axes=1) + sigma * rng.normal(size=(400, 14, 3))
        prior = pca_prior(CATEGORY, drawn[:60], basis=5, symmetric=False)
        fresh = np.sqrt((express(prior, drawn[60:])[1] ** 2).mean(axis=(0, 2)))
        assert prior.offset_sigma == pytest.approx(fresh, rel=0.12)

    def test_surface_is_the_regression_on_the_coefficients(self):
        rng = np.random.default_rng(8)
        data = shapes(40, 9)
        prior = pca_prior(CATEGORY, data, basis=3, symmetric=False)
        coefficients = express(prior, data)[0]
        mean, change = rng.normal(size=(6, 3)), rng.normal(size=(3, 6, 3))
        vertices = mean + np.tensordot(coefficients, change, axes=1)
        faces = np.array([[0, 1, 2]], dtype=np.int32)
        again = pca_prior(CATEGORY, data, basis=3, symmetric=False, surface=SurfaceSamples(vertices, faces))
        assert again.surface.mean == pytest.approx(mean)
        assert again.surface.basis == pytest.approx(change)

    def test_express(self):
        prior = load_prior("car14")
        rng = np.random.default_rng(10)
        truth = rng.normal(size=(6, 5))
        drawn = prior.mean + np.tensordot(truth, prior.basis, axes=1)
        drawn[2, [0, 5, 7]] = np.nan
        coefficients, residual = express(prior, drawn)
        assert coefficients == pytest.approx(truth)
        assert np.nanmax(np.abs(residual)) < 1e-9
        assert (np.isnan(residual) == np.isnan(drawn)).all()
        assert express(prior.truncated(0), drawn)[0].shape == (6, 0)

    def test_a_category_with_points_on_the_medial_plane(self):
        content = CATEGORY.to_dict()
        names = [*content["keypoints"][:4], "front", "top", "back", "left_lamp", "right_lamp"]
        wheels = names[:4]
        content = {
            "name": "vehicle",
            "keypoints": names,
            "symmetric_pairs": [names[:2], names[2:4], names[7:]],
            "faces": [],
            "edges": [names[:2]],
            "dimensions": {
                "length": {"plus": ["front"], "minus": ["back"], "ratio": 1.0},
                "width": {"plus": wheels[::2], "minus": wheels[1::2], "ratio": 1.0},
                "height": {"plus": ["top"], "minus": wheels, "ratio": 0.8},
            },
            "ground": {"keypoints": wheels, "ratio": 0.2},
        }
        category = type(CATEGORY).from_dict(content)
        rng = np.random.default_rng(11)
        medial = [[2.0, -0.8, 0.0], [0.0, -1.5, 0.0], [-2.0, -0.9, 0.0]]
        mean = np.vstack([MEAN[:4], medial, MEAN[4:6]])
        data = mean + 0.1 * rng.normal(size=(20, 9, 3))
        prior = pca_prior(category, data, basis=4)
        assert prior.is_symmetric
        assert (prior.keypoints(rng.normal(size=4))[4:7, 2] == 0).all()
        assert prior.mean[4, :2] == pytest.approx(data[:, 4, :2].mean(axis=0))

    def test_errors(self):
        data = shapes(10, 12)
        with pytest.raises(InvalidInputError, match="shapes"):
            pca_prior(CATEGORY, data[:, :13])
        with pytest.raises(DegenerateProblemError, match="0 to 9 directions"):
            pca_prior(CATEGORY, data, basis=10)
        with pytest.raises(InvalidInputError, match=r"surface\.mirror"):
            pca_prior(CATEGORY, data, surface=SurfaceSamples(np.zeros((10, 3, 3)), np.zeros((0, 3), np.int32)))
        with pytest.raises(InvalidInputError, match=r"surface\.vertices"):
            pca_prior(CATEGORY, data, surface=SurfaceSamples(np.zeros((9, 3, 3)), np.zeros((0, 3), np.int32)))
        with pytest.raises(InvalidInputError, match="weights"):
            pca_prior(CATEGORY, data, weights=np.ones(9))
