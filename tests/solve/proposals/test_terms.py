"""Each energy term: gradient and Gauss-Newton matrix against numbers, energies against plain loops."""

import numpy as np
import pytest

from factors.box import BoxRows
from factors.keypoint_rows import KeypointRows, whiteners
from fgrecon.core.camera import MIN_DEPTH, Ground
from fgrecon.core.geometry import cross, exponential, pixel_jacobian
from fgrecon.core.robust import Evidence, strategy
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.terms import (
    BoxTerm,
    CoefficientTerm,
    GroundTerm,
    Hypotheses,
    KeypointTerm,
    Quadratic,
    SizeTerm,
)
from tests.cars import MATRIX, project, yaw_pose

COUNT = 3


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def hypotheses(prior, seed=0):
    """Some cars in front of the camera, none upright."""
    rng = np.random.default_rng(seed)
    rotation = np.array([yaw_pose(yaw)[:3, :3] for yaw in rng.uniform(-3, 3, COUNT)])
    rotation = rotation @ exponential(rng.normal(size=(COUNT, 3)) * 0.1)
    translation = np.array([1.0, 1.6, 11.0]) + rng.normal(size=(COUNT, 3)) * [0.5, 0.1, 1.0]
    return Hypotheses(rotation, translation, rng.normal(size=(COUNT, prior.dimension)))


def moved(h, step):
    """The hypotheses after a step in the local coordinates that the module defines."""
    return Hypotheses(h.rotation @ exponential(step[:3]), h.translation + step[3:6], h.coefficients + step[6:])


def assembled(add, h):
    total = Quadratic(len(h), 6 + h.coefficients.shape[1])
    add(total, h)
    return total


def numeric_gradient(add, h, step=1e-5):
    columns = []
    for axis in np.eye(6 + h.coefficients.shape[1]):
        up, down = (assembled(add, moved(h, s * step * axis)).energy for s in (1, -1))
        columns.append((up - down) / (2 * step))
    return np.array(columns).T


def numeric_gauss_newton(residual, h, step=1e-5):
    """J'J of whitened residuals (H, R) whose weights and scales are held."""
    columns = []
    for axis in np.eye(6 + h.coefficients.shape[1]):
        up, down = (residual(moved(h, s * step * axis)) for s in (1, -1))
        columns.append((up - down) / (2 * step))
    jacobian = np.stack(columns, axis=-1)
    return jacobian.transpose(0, 2, 1) @ jacobian


def assert_close(actual, expected, relative=1e-6):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=relative * max(np.abs(expected).max(), 1e-9))


def keypoint_term(prior, name, seed=1):
    rng = np.random.default_rng(seed)
    covariance = np.array([[9.0, 2.0], [2.0, 6.0]]) * rng.uniform(0.5, 2.0, (14, 1, 1))
    measured = rng.random(14) > 0.2
    h = hypotheses(prior)
    pixels = project(prior.keypoints(h.coefficients[0]), h.matrices()[0]) + rng.normal(size=(14, 2)) * 3
    evidence = Evidence(np.where(measured, rng.uniform(0.1, 0.95, 14), 0.0), rng.uniform(0.01, 0.1, 14), measured)
    rows = KeypointRows(np.where(measured[:, None], pixels, 0.0), whiteners(covariance))
    visibility = rng.uniform(0.05, 0.95, (COUNT, 14))
    term = KeypointTerm(prior.mean, prior.basis, MATRIX, rows, evidence, strategy(name))
    return term, h, visibility, covariance


@pytest.mark.parametrize("name", ["mixture", "huber", "cauchy", "geman_mcclure", "tukey", "gnc"])
def test_keypoint_term(prior, name):
    term, h, visibility, _ = keypoint_term(prior, name)

    def add(total, at):
        term.add(total, at, visibility, 1.0)

    total = assembled(add, h)
    assert_close(total.gradient, numeric_gradient(add, h))
    weights = term.add(Quadratic(COUNT, 11), h, visibility, 1.0)
    scale = np.sqrt(weights)[..., None]
    assert_close(total.matrix, numeric_gauss_newton(lambda at: (term.residuals(at)[0] * scale).reshape(COUNT, -1), h))


def test_keypoint_energy_by_a_plain_loop(prior):
    term, h, visibility, covariance = keypoint_term(prior, "mixture")
    total = assembled(lambda t, at: term.add(t, at, visibility, 1.0), h)
    for i, pose in enumerate(h.matrices()):
        pixels = project(prior.keypoints(h.coefficients[i]), pose)
        energy = 0.0
        for k in np.flatnonzero(term.evidence.measured):
            d = pixels[k] - term.rows.pixels[k]
            d2 = d @ np.linalg.solve(covariance[k], d)
            seen = Evidence(term.evidence.right[k : k + 1], term.evidence.outlier[k : k + 1], np.array([True]))
            energy += term.strategy.evaluate(np.array([d2]), seen, visibility[i, k : k + 1])[1]
        assert total.energy[i] == pytest.approx(energy, rel=1e-10)


def box_term(prior, used=(True, True, True, True)):
    vertices = prior.surface.mean[::9], prior.surface.basis[:, ::9]
    h = hypotheses(prior)
    pixels = project(vertices[0], h.matrices()[0])
    edges = np.concatenate([pixels.min(axis=0) - 3.0, pixels.max(axis=0) + 4.0])
    return BoxTerm(*vertices, MATRIX, BoxRows(edges, np.array(used), 4.0, 0.01, 2.0)), h


@pytest.mark.parametrize("used", [(True, True, True, True), (True, False, True, False)])
def test_box_term(prior, used):
    term, h = box_term(prior, used)
    total = assembled(term.add, h)
    assert_close(total.gradient, numeric_gradient(term.add, h))
    scale = np.sqrt(term.rows.assess(term.residuals(h))[0])
    assert (scale[:, ~np.array(used)] == 0).all()
    assert_close(total.matrix, numeric_gauss_newton(lambda at: term.residuals(at) * scale, h))


def test_box_residuals_are_near_the_hard_extents(prior):
    """The soft extent lies inside the hard one, by less than the softness."""
    term, h = box_term(prior)
    residual = term.residuals(h) * term.rows.sigma
    for i, pose in enumerate(h.matrices()):
        points = term.mean + np.tensordot(h.coefficients[i], term.basis, axes=1)
        pixels = project(points, pose)
        inside = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]) - term.rows.edges - residual[i]
        inside *= [-1, -1, 1, 1]
        assert (inside >= -1e-9).all()
        assert (inside < term.rows.softness).all()


def test_size_term(prior):
    size = SIZE_PRIORS["kitti"]
    basis = np.tensordot(prior.category.dimension_operator, prior.basis, axes=((1, 2), (1, 2)))
    term = SizeTerm(prior.box_size(np.zeros(5)), basis, size)
    h = hypotheses(prior)
    total = assembled(term.add, h)
    for i in range(COUNT):
        deviation = (prior.box_size(h.coefficients[i]) - size.mean) / size.assumed_sigma
        assert total.energy[i] == pytest.approx(0.5 * deviation @ deviation)
    assert_close(total.gradient, numeric_gradient(term.add, h))

    def residual(at):
        return np.array([(prior.box_size(c) - size.mean) / size.assumed_sigma for c in at.coefficients])

    assert_close(total.matrix, numeric_gauss_newton(residual, h))


def test_ground_term(prior):
    """With a slope of no uncertainty the gradient is that of the energy."""
    ground = Ground(np.array([0.05, 1.0, -0.03]), 1.6, slope_sigma=1e-9)
    term, h = GroundTerm(ground), hypotheses(prior)
    total = assembled(term.add, h)
    assert_close(total.gradient, numeric_gradient(term.add, h))

    def residual(at):
        height = (at.translation @ ground.normal - ground.distance) / ground.height_sigma
        lean = (at.rotation[:, :, 1] - ground.normal) / ground.tilt_sigma
        return np.column_stack([height, lean])

    assert_close(total.matrix, numeric_gauss_newton(residual, h))


def test_ground_energy_is_a_density(prior):
    """Comparable between depths: 0.5 r^2 + log sigma with the uncertainty of each depth."""
    ground = Ground.level(1.65)
    h = hypotheses(prior)
    far = Hypotheses(h.rotation, h.translation + np.array([0.0, 0.0, 30.0]), h.coefficients)
    for at in (h, far):
        energy = assembled(GroundTerm(ground).add, at).energy
        for i in range(COUNT):
            sigma = np.hypot(0.1, 0.0125 * at.translation[i, 2])
            height = (at.translation[i, 1] - 1.65) / sigma
            lean = np.linalg.norm(at.rotation[i, :, 1] - [0, 1, 0]) / 0.03
            assert energy[i] == pytest.approx(0.5 * height**2 + np.log(sigma) + 0.5 * lean**2)


def test_coefficient_term(prior):
    h = hypotheses(prior)
    total = assembled(CoefficientTerm().add, h)
    np.testing.assert_allclose(total.energy, 0.5 * (h.coefficients**2).sum(axis=1))
    assert_close(total.gradient, numeric_gradient(CoefficientTerm().add, h))
    np.testing.assert_array_equal(total.matrix[0], np.diag([0] * 6 + [1] * 5))


def test_terms_add_up(prior):
    """Every term adds to what is there, and to its own columns alone."""
    h = hypotheses(prior)
    ground, (box, _) = GroundTerm(Ground.level(1.65)), box_term(prior)
    both = assembled(lambda t, at: (ground.add(t, at), box.add(t, at)), h)
    alone = [assembled(term.add, h) for term in (ground, box)]
    for name in ("energy", "gradient", "matrix"):
        np.testing.assert_allclose(getattr(both, name), sum(getattr(part, name) for part in alone), rtol=1e-12)
    assert (alone[0].gradient[:, 6:] == 0).all()


def test_too_near_is_infinitely_bad(prior):
    term, h, visibility, _ = keypoint_term(prior, "mixture")
    near = Hypotheses(h.rotation, np.tile([0.0, 0.0, MIN_DEPTH], (COUNT, 1)), h.coefficients)
    assert (assembled(lambda t, at: term.add(t, at, visibility, 1.0), near).energy == np.inf).all()
    box, _ = box_term(prior)
    total = assembled(box.add, near)
    assert (total.energy == np.inf).all()
    assert np.isfinite(total.matrix).all()


def test_selection_of_hypotheses(prior):
    h = hypotheses(prior)
    other = hypotheses(prior, seed=5)
    mask = np.array([True, False, True])
    mixed = h.where(mask, other)
    for i in range(COUNT):
        chosen = h if mask[i] else other
        np.testing.assert_array_equal(mixed.matrices()[i], chosen.matrices()[i])
        np.testing.assert_array_equal(mixed.coefficients[i], chosen.coefficients[i])
    taken = h.take(np.array([2, 0]))
    np.testing.assert_array_equal(taken.matrices(), h.matrices()[[2, 0]])
    total, second = (assembled(CoefficientTerm().add, at) for at in (h, other))
    total.update(mask, second)
    np.testing.assert_array_equal(
        total.energy, np.where(mask, second.energy, assembled(CoefficientTerm().add, h).energy)
    )


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, 1.0, np.pi, 6.0])
def test_exponential_is_a_rotation_about_its_axis(angle):
    from scipy.spatial.transform import Rotation

    vectors = np.random.default_rng(0).normal(size=(5, 3))
    vectors *= angle / np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(exponential(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14)


def test_small_geometry():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(4, 1, 3)), rng.normal(size=(4, 5, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))
    matrix = MATRIX.copy()
    matrix[0, 1] = 2.5
    points = rng.normal(size=(6, 3)) + np.array([0, 0, 8])

    def pixels(at):
        q = at @ matrix.T
        return q[:, :2] / q[:, 2:]

    numeric = np.stack([(pixels(points + d) - pixels(points - d)) / 2e-6 for d in 1e-6 * np.eye(3)], axis=-1)
    assert_close(pixel_jacobian(matrix, points), numeric)
