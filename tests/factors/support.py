"""Random problems and numeric Jacobians for the tests of factors."""

from types import SimpleNamespace

import gtsam
import numpy as np

from factors.keys import L, O
from factors.shape import LinearShape
from factors.shape_factor import ShapeContext

CAMERA = np.array([[721.5, 1.7, 609.6], [0.0, 718.9, 172.9], [0.0, 0.0, 1.0]])


def car_like(rng, keypoints=14, vectors=5):
    """Mean (K, 3) and basis (N, K, 3) of the size of a car."""
    mean = rng.uniform(-1, 1, (keypoints, 3)) * [2.0, 0.75, 0.8] + [0.0, -0.75, 0.0]
    return mean, rng.normal(size=(vectors, keypoints, 3)) * 0.2 / np.sqrt(vectors)


def random_pose(rng, depth=(8.0, 40.0)):
    """A pose in front of the camera with any rotation."""
    rotation = gtsam.Rot3.Expmap(rng.uniform(-2, 2, 3))
    return gtsam.Pose3(rotation, np.array([rng.uniform(-4, 4), rng.uniform(-1, 2), rng.uniform(*depth)]))


def bound_shape(rng, keypoints=14, vectors=5, with_offsets=False):
    """A shape on L() and, where wanted, O(), with values at a random state."""
    mean, basis = car_like(rng, keypoints, vectors)
    shape = LinearShape(mean, basis, L(), O() if with_offsets else None)
    values = gtsam.Values()
    values.insert(L(), rng.normal(size=vectors))
    if with_offsets:
        values.insert(O(), 0.05 * rng.normal(size=3 * keypoints))
    return shape, values


def context_of(shape, pairs=(), middle=(), quads=(), operator=None, size=None):
    """A vehicle as the shape's terms see it, with symmetry of 2 cm and rectangles of 5 cm."""
    mirror = (np.arange(shape.size) + 1) % shape.size
    mirror[list(middle)] = middle
    return ShapeContext(
        shape=shape,
        number=0,
        faces=[SimpleNamespace(keypoints=quad, rectangular=True, ground_parallel=False) for quad in quads],
        pairs=pairs,
        mirror=mirror,
        neighbours=[()] * shape.size,
        mirrored_prior=False,
        dimension_operator=np.zeros((3, shape.size, 3)) if operator is None else operator,
        size=size,
        offset_sigma=np.full(shape.size, 0.03),
        spread=None,
        by_size=None,
        settings=SimpleNamespace(symmetry_sigma=0.02, rectangularity_sigma=0.05),
        disabled=(),
    )


def random_plane(rng):
    """A plane in any direction."""
    return gtsam.OrientedPlane3(np.append(rng.normal(size=3), rng.normal()))


def project(points, pose, camera=CAMERA):
    """Pixels of object points, written out the plain way."""
    q = (points @ pose.rotation().matrix().T + pose.translation()) @ camera.T
    return q[:, :2] / q[:, 2:]


def jacobian(factor, values):
    """Analytic Jacobian of a factor, whitened by its noise, its columns following the factor's keys."""
    return factor.linearize(values).jacobian()[0]


def numeric_jacobian(factor, values, step=1e-3):
    """The same by fourth-order central differences on the manifold, for any type of variable."""
    zero = values.zeroVectors()
    columns = []

    def residual(key, delta):
        change = gtsam.VectorValues()
        change.insert(key, delta)
        return factor.noiseModel().whiten(factor.unwhitenedError(values.retract(change)))

    for key in list(factor.keys()):
        for axis in np.eye(len(zero.at(key))):
            near, far = (residual(key, h * axis) - residual(key, -h * axis) for h in (step, 2 * step))
            columns.append((8 * near - far) / (12 * step))
    return np.array(columns).T


def assert_jacobian(factor, values, step=1e-3, relative=1e-6):
    """The analytic Jacobian agrees with the numeric one to 1e-6 of its largest entry."""
    analytic, numeric = jacobian(factor, values), numeric_jacobian(factor, values, step)
    assert analytic.shape == numeric.shape
    scale = max(np.abs(numeric).max(), 1e-3)
    np.testing.assert_allclose(analytic, numeric, rtol=0, atol=relative * scale)


def optimize(graph, values, **settings):
    """Levenberg-Marquardt to convergence."""
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(0.0)
    params.setAbsoluteErrorTol(1e-15)
    params.setMaxIterations(settings.get("iterations", 200))
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def quad_at(corners, vectors=3, seed=0, with_offsets=True):
    """A shape whose first four mean keypoints are the corners, on L() and, where wanted, O(), at lambda = 0."""
    rng = np.random.default_rng(seed)
    mean = np.vstack([corners, rng.normal(size=(2, 3))])
    shape = LinearShape(mean, 0.1 * rng.normal(size=(vectors, 6, 3)), L(), O() if with_offsets else None)
    values = gtsam.Values()
    values.insert(L(), np.zeros(vectors))
    if with_offsets:
        values.insert(O(), np.zeros(18))
    return shape, values


def graph_of(*factors):
    """A graph of the factors."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph
