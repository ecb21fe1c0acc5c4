"""All terms together: the optimum of an independent solver on the same energy, several frames, no leak."""

import gc
import weakref

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares

import factors
from factors import L, M, O, P, X
from tests.factors.support import CAMERA, car_like, graph_of, optimize, project

PAIRS = [(0, 1), (2, 3), (4, 5), (6, 7)]
FACE = [0, 1, 3, 2]
NEAR = [[(i + 1) % 14, (i + 2) % 14] for i in range(14)]
SIGMA = {
    "pixel": 2.0,
    "planar": 0.02,
    "parallel": 0.05,
    "rectangle": 0.05,
    "symmetry": 0.03,
    "size": np.array([0.4, 0.1, 0.1]),
    "laplacian": 0.3,
    "height": 0.1,
    "upright": 0.03,
    "offset": 0.03,
}
GROUND = np.array([0.02, 1.0, -0.03]) / np.linalg.norm([0.02, 1.0, -0.03])


def seen_factor(kernel, pixels, sigma, ground):
    """All of an image: keypoints of weight 1, and a ground 1.65 m below."""
    normal, height_sigma, tilt_sigma = ground
    rows = factors.ObservationRows(
        kernel,
        factors.KeypointRows(pixels, np.tile([1.0 / sigma, 0.0, 1.0 / sigma], (len(pixels), 1))),
        ground=factors.GroundRows(normal, 1.65, tilt_sigma),
        form=factors.Form.WEIGHTED,
        height_sigma=height_sigma,
    )
    rows.right = np.ones(len(pixels))
    return factors.observation_factor(rows)


class Problem:
    """A noisy observation of a shape that is roughly symmetric, with the whole energy on it."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.mean, self.basis = car_like(rng)
        for left, right in PAIRS:
            self.mean[left] = self.mean[right] * [1, 1, -1] + 0.03 * rng.normal(size=3)
        self.mean[FACE, 1] = 0.02 * rng.normal(size=4)
        self.operator = rng.normal(size=(3, 14, 3)) / 14
        self.size = np.tensordot(self.operator, self.mean, axes=2) + 0.05
        self.truth = rng.normal(size=5)
        X_true = self.mean + np.tensordot(self.truth, self.basis, axes=1)
        self.pose = gtsam.Pose3(gtsam.Rot3.Ry(0.5), np.array([1.0, 1.65, 9.0]))
        self.pixels = project(X_true, self.pose) + rng.normal(size=(14, 2))
        self.shape = factors.LinearShape(self.mean, self.basis, L(), O())
        self.kernel = factors.ProjectionKernel(self.shape, CAMERA, X())

    def graph(self):
        shape = self.shape
        return graph_of(
            seen_factor(self.kernel, self.pixels, SIGMA["pixel"], (GROUND, SIGMA["height"], SIGMA["upright"])),
            factors.coefficients_prior(L(), 5),
            factors.offsets_prior(O(), np.full(14, SIGMA["offset"])),
            factors.planarity_factor(shape, FACE, P(), SIGMA["planar"]),
            factors.ground_parallel_factor(P(), SIGMA["parallel"]),
            factors.rectangularity_factor(shape, FACE, SIGMA["rectangle"]),
            factors.symmetry_factor(shape, PAIRS, M(), SIGMA["symmetry"]),
            factors.dimensions_factor(shape, self.operator, self.size, SIGMA["size"]),
            factors.laplacian_factor(shape, NEAR, SIGMA["laplacian"]),
        )

    def start(self):
        values = gtsam.Values()
        values.insert(L(), np.zeros(5))
        values.insert(O(), np.zeros(42))
        values.insert(P(), factors.fit_plane(self.mean[FACE]))
        values.insert(M(), factors.make_plane([0, 0, 1], 0))
        values.insert(X(), self.pose.retract(np.array([0.02, 0.05, -0.02, 0.2, 0.1, 0.5])))
        return values

    def residual(self, x):
        """The energy, written out independently: rotation vector, translation, lambda, offsets, planes."""
        pose = gtsam.Pose3(gtsam.Rot3.Expmap(x[:3]), x[3:6])
        R = pose.rotation().matrix()
        lam, off = x[6:11], x[11:53]
        face, medial = x[53:57], x[57:61]
        pts = self.mean + np.tensordot(lam, self.basis, axes=1) + off.reshape(14, 3)
        n, d = face[:3] / np.linalg.norm(face[:3]), face[3]
        m, e = medial[:3] / np.linalg.norm(medial[:3]), medial[3]
        a, b, c, q = pts[FACE]
        left, right = np.array(PAIRS).T

        def delta(points):
            rows = []
            for i, near in enumerate(NEAR):
                w = np.exp(-np.sum((points[i] - points[near]) ** 2, axis=1))
                rows.append(points[i] - w @ points[near] / w.sum())
            return np.array(rows)

        return np.concatenate(
            [
                (project(pts, pose) - self.pixels).ravel() / SIGMA["pixel"],
                lam,
                off / SIGMA["offset"],
                (pts[FACE] @ n + d) / SIGMA["planar"],
                n[[0, 2]] / SIGMA["parallel"],
                (a - b + c - q) / SIGMA["rectangle"],
                [(np.linalg.norm(a - c) - np.linalg.norm(b - q)) / SIGMA["rectangle"]],
                (pts[right] - 2 * (pts[right] @ m + e)[:, None] * m - pts[left]).ravel() / SIGMA["symmetry"],
                (np.tensordot(self.operator, pts, axes=2) - self.size) / SIGMA["size"],
                (delta(pts) - delta(self.mean)).ravel() / SIGMA["laplacian"],
                [(GROUND @ x[3:6] - 1.65) / SIGMA["height"]],
                (R[:, 1] - GROUND) / SIGMA["upright"],
                # The length of a normal is free in this parametrisation; fix it.
                [np.linalg.norm(face[:3]) - 1, np.linalg.norm(medial[:3]) - 1],
            ]
        )

    def vector(self, values):
        pose = values.atPose3(X())
        planes = [values.atOrientedPlane3(key).planeCoefficients() for key in (P(), M())]
        rotation = gtsam.Rot3.Logmap(pose.rotation())
        return np.concatenate([rotation, pose.translation(), values.atVector(L()), values.atVector(O()), *planes])


@pytest.mark.parametrize("seed", range(3))
def test_same_optimum_as_scipy(seed):
    problem = Problem(seed)
    graph, start = problem.graph(), problem.start()
    assert graph.error(start) == pytest.approx(0.5 * np.sum(problem.residual(problem.vector(start)) ** 2), rel=1e-9)
    found = problem.vector(optimize(graph, start))
    oracle = least_squares(problem.residual, problem.vector(start), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    np.testing.assert_allclose(found, oracle.x, atol=1e-6)
    assert 0.5 * np.sum(problem.residual(found) ** 2) == pytest.approx(oracle.cost, rel=1e-9)


def drive(frames):
    """One vehicle in several frames, without noise: factors and start of each frame, and the truth."""
    rng = np.random.default_rng(0)
    mean, basis = car_like(rng)
    truth = rng.normal(size=5)
    shape = factors.LinearShape(mean, basis, L())
    X_true = shape.mean + np.tensordot(truth, basis, axes=1)
    per_frame = []
    for t in range(frames):
        pose = gtsam.Pose3(gtsam.Rot3.Ry(0.5 + 0.3 * t), np.array([1.0 + t, 1.65, 9.0 - t]))
        kernel = factors.ProjectionKernel(shape, CAMERA, X(0, t))
        graph = graph_of(
            seen_factor(kernel, project(X_true, pose), 0.01, (np.array([0.0, 1.0, 0.0]), 0.01, 0.01)),
        )
        start = gtsam.Values()
        start.insert(X(0, t), pose.retract(np.array([0.02, 0.05, -0.02, 0.2, 0.1, 0.3])))
        per_frame.append((graph, start, pose))
    return per_frame, truth


def assert_recovers(values, per_frame, truth):
    np.testing.assert_allclose(values.atVector(L()), truth, atol=1e-4)
    for t, (_, _, pose) in enumerate(per_frame):
        assert values.atPose3(X(0, t)).equals(pose, 1e-4)


def test_frames_share_one_shape():
    per_frame, truth = drive(4)
    graph = graph_of(factors.coefficients_prior(L(), 5))
    values = gtsam.Values()
    values.insert(L(), np.zeros(5))
    for frame_graph, start, _ in per_frame:
        graph.push_back(frame_graph)
        values.insert(start)
    assert_recovers(optimize(graph, values), per_frame, truth)


def test_incremental_smoothing():
    """The same factors in ISAM2, a frame at a time."""
    per_frame, truth = drive(4)
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(0.0)
    params.relinearizeSkip = 1
    isam = gtsam.ISAM2(params)
    first = gtsam.Values()
    first.insert(L(), np.zeros(5))
    isam.update(graph_of(factors.coefficients_prior(L(), 5)), first)
    for graph, start, _ in per_frame:
        isam.update(graph, start)
        for _ in range(10):
            isam.update()
    assert_recovers(isam.calculateEstimate(), per_frame, truth)


def test_marginals():
    problem = Problem()
    result = optimize(problem.graph(), problem.start())
    marginals = gtsam.Marginals(problem.graph(), result)
    for key, size in ((X(), 6), (L(), 5), (O(), 42), (P(), 3), (M(), 3)):
        covariance = marginals.marginalCovariance(key)
        assert covariance.shape == (size, size)
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert (np.diag(marginals.marginalCovariance(L())) < 1).all()


def test_no_leak():
    """Graphs of 800 factors in all leave nothing behind, without help of the garbage collector."""
    gc.collect()
    gc.disable()
    try:
        alive = []
        for _ in range(80):
            problem = Problem()
            graph, values = problem.graph(), problem.start()
            graph.linearize(values)
            params = gtsam.LevenbergMarquardtParams()
            params.setMaxIterations(1)
            gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
            alive.append(weakref.ref(problem))
            sizes = graph.size()
            del problem, graph
        assert sizes >= 9
        assert not any(ref() is not None for ref in alive)
    finally:
        gc.enable()
