"""Plane variables: convention, tangent space, initial fit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors.errors import DegenerateProblemError, InvalidInputError
from factors.planes import fit_plane, make_plane


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_fit_and_sign(seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    d = rng.normal()
    points = rng.normal(size=(5, 3))
    points -= np.outer(points @ normal + d, normal)
    fitted = fit_plane(points).planeCoefficients()
    assert np.abs(points @ fitted[:3] + fitted[3]).max() < 1e-12
    assert fitted[:3][np.argmax(np.abs(fitted[:3]))] > 0
    np.testing.assert_array_equal(fit_plane(points[::-1] + 0.0).planeCoefficients().round(9), fitted.round(9))


def test_fit_minimises_the_distances():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(8, 3)) * [2, 1, 0.1]
    best = fit_plane(points)

    def energy(plane):
        n = plane.planeCoefficients()
        return np.sum((points @ n[:3] + n[3]) ** 2)

    for _ in range(20):
        assert energy(best.retract(0.01 * rng.normal(size=3))) > energy(best)


def test_tangent_space():
    plane = make_plane([1.0, -2.0, 0.5], 0.7)
    normal, d = np.split(plane.planeCoefficients(), [3])
    basis = plane.normal().basis()
    np.testing.assert_allclose(basis.T @ normal, 0, atol=1e-15)
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-15)
    xi = 1e-6 * np.array([1.0, -2.0, 3.0])
    moved = plane.retract(xi).planeCoefficients()
    np.testing.assert_allclose(moved[:3] - normal, basis @ xi[:2], atol=1e-11)
    assert moved[3] - d[0] == pytest.approx(xi[2], abs=1e-15)


def test_make_plane_scales_d_with_the_normal():
    np.testing.assert_allclose(make_plane([0, 0, 2], 3).planeCoefficients(), [0, 0, 1, 1.5])


def test_bad_input():
    with pytest.raises(DegenerateProblemError):
        fit_plane(np.outer(np.arange(4.0), [1, 2, 3]))
    with pytest.raises(DegenerateProblemError):
        fit_plane(np.eye(3)[:2])
    with pytest.raises(DegenerateProblemError):
        fit_plane(np.ones((4, 3)))
    with pytest.raises(InvalidInputError):
        fit_plane([[0, 0, np.nan]] * 3)
    with pytest.raises(InvalidInputError):
        make_plane([0, 0, 0], 1)
    with pytest.raises(InvalidInputError):
        make_plane([0, 0, 1], np.inf)
