"""The factor of a whole observation: compiled as in numpy, as its terms' factors, and with numeric derivatives."""

import copy

import gtsam
import numpy as np
import pytest

from factors import (
    F,
    L,
    LinearShape,
    O,
    ProjectionKernel,
    X,
    reprojection_factor,
    term_factor,
)
from factors.box import BoxRows
from factors.ground import GroundRows
from factors.keypoint_rows import KeypointRows
from factors.mixture import Form
from factors.native import native
from factors.observation_rows import ObservationRows, observation_factor
from tests.factors.support import CAMERA, assert_jacobian, car_like, graph_of, project, random_pose

KERNEL = native("factors._energy")
BOTH = pytest.mark.parametrize(
    "compiled", [False, pytest.param(True, marks=pytest.mark.skipif(KERNEL is None, reason="no compiled kernel"))]
)
SIZE, VECTORS = 14, 5
NORMAL = np.array([0.02, 1.0, -0.03]) / np.linalg.norm([0.02, 1.0, -0.03])


class Case:
    """A random observation; some points are not seen, some far off."""

    def __init__(
        self, seed, *, compiled, offsets=True, pose_free=True, shape_free=True, box=True, ground=True, zoom=None
    ):
        rng = np.random.default_rng(seed)
        mean, basis = car_like(rng, SIZE, VECTORS)
        x, o = rng.normal(size=VECTORS), 0.05 * rng.normal(size=3 * SIZE)
        self.pose = random_pose(rng)
        bound = (L(), O() if offsets else None) if shape_free else (x, o.reshape(-1, 3) if offsets else None)
        self.shape = LinearShape(mean, basis, *bound)
        nominal, focal = CAMERA.copy(), None
        if zoom is not None:
            nominal[:2, :2] *= np.exp(-zoom)
            focal = F()
        self.kernel = ProjectionKernel(self.shape, nominal, X() if pose_free else self.pose, focal)
        self.values = gtsam.Values()
        if pose_free:
            self.values.insert(X(), self.pose)
        if shape_free:
            self.values.insert(L(), x)
        if shape_free and offsets:
            self.values.insert(O(), o)
        if zoom is not None:
            self.values.insert(F(), np.array([zoom]))
        truth = mean + np.tensordot(x, basis, axes=1)
        scale = 700.0 / self.pose.z()
        self.pixels = project(truth, self.pose) + 0.04 * scale * rng.normal(size=(SIZE, 2))
        self.pixels[[3, 7]] += 0.5 * scale
        sigma = 0.03 * scale
        self.sigma = sigma
        self.whitener = np.tile([1.0 / sigma, 0.0, 1.0 / sigma], (SIZE, 1))
        self.right = np.where(rng.random(SIZE) < 0.8, rng.uniform(0.2, 0.9, SIZE), 0.0)
        self.wrong = rng.uniform(0.001, 0.05, SIZE)
        self.weights = rng.uniform(0, 1, SIZE) * (self.right > 0)
        self.edge_weights = rng.uniform(0.1, 1, 4)
        self.used = np.array([True, True, False, True])
        outline, outline_basis = car_like(rng, 30, VECTORS)
        low, high = np.min(project(outline, self.pose), axis=0), np.max(project(outline, self.pose), axis=0)
        self.edges = np.concatenate([low, high]) + 0.5 * sigma * rng.normal(size=4)
        outline_shape = LinearShape(outline, outline_basis, L() if shape_free else x)
        self.outline = ProjectionKernel(outline_shape, nominal, X() if pose_free else self.pose, focal)
        self.box = BoxRows(self.edges, self.used, sigma, 0.02, sigma / 2) if box else None
        self.ground = GroundRows(NORMAL, 1.6, 0.03) if ground and pose_free else None
        rows = self._compiled(mean, basis, outline, outline_basis, ground=ground) if compiled else None
        self.rows = ObservationRows(
            self.kernel,
            KeypointRows(self.pixels, self.whitener),
            self.box,
            self.outline,
            self.ground,
            None if rows is None else KERNEL.ImageRows(rows, 0.7, pose_free),
            share=0.7,
            height_sigma=0.12,
        )

    def _compiled(self, mean, basis, outline, outline_basis, *, ground):
        extent = None
        if self.box is not None:
            extent = (
                outline,
                np.ascontiguousarray(outline_basis).reshape(VECTORS, -1),
                np.ascontiguousarray(outline_basis.transpose(1, 2, 0)),
                self.edges,
                self.used.view(np.uint8),
                self.sigma,
                0.02,
                self.sigma / 2,
            )
        return KERNEL.Observation(
            CAMERA,
            mean,
            np.ascontiguousarray(basis).reshape(VECTORS, -1),
            self.pixels,
            self.whitener,
            extent,
            (NORMAL, 1.6, 0.1, 0.0, 0.03) if ground else None,
        )

    def tell(self, form):
        self.rows.form, self.rows.edge_weights = form, self.edge_weights
        self.rows.right = self.weights if form is Form.WEIGHTED else self.right
        self.rows.wrong = self.wrong
        return self.rows


VARIANTS = {
    "all": {},
    "no offsets": {"offsets": False},
    "fixed pose": {"pose_free": False},
    "fixed shape": {"shape_free": False},
    "fixed shape without offsets": {"shape_free": False, "offsets": False},
    "no box": {"box": False},
    "no ground": {"ground": False},
}


@pytest.mark.skipif(KERNEL is None, reason="no compiled kernel")
@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("name", VARIANTS)
def test_the_compiled_rows_are_numpys(name, form):
    for seed in range(6):
        one, other = (Case(seed, compiled=compiled, **VARIANTS[name]).tell(form) for compiled in (True, False))
        values = Case(seed, compiled=False, **VARIANTS[name]).values
        for want in (False, True):
            (residual, jacobian), (residual_too, jacobian_too) = one(values, want), other(values, want)
            np.testing.assert_allclose(residual, residual_too, atol=1e-12 * max(1.0, np.abs(residual).max()))
            if want:
                np.testing.assert_allclose(jacobian, jacobian_too, atol=1e-12 * np.abs(jacobian).max())
            else:
                assert jacobian is jacobian_too is None


FOCAL = {name: {**variant, "zoom": 0.2} for name, variant in VARIANTS.items()}
"""The same where the focal length is a variable, which is that of the others at exp(0.2) times the nominal one."""


@pytest.mark.parametrize("name", FOCAL)
def test_a_focal_length_that_is_a_variable_is_that_of_the_camera(name):
    fixed, free = (Case(3, compiled=False, **kind[name]) for kind in (VARIANTS, FOCAL))
    for form, want in ((Form.LOSS, False), (Form.NEWTON, True)):
        (rows, jacobian), (fewer, wider) = (case.tell(form)(case.values, want) for case in (fixed, free))
        np.testing.assert_allclose(fewer, rows, rtol=1e-9, atol=1e-9)
        if want:
            np.testing.assert_allclose(wider[:, :-1], jacobian, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("name", FOCAL)
def test_rows_have_the_numeric_jacobian_by_the_focal_length(name):
    case = Case(1, compiled=False, **FOCAL[name])
    assert_jacobian(observation_factor(case.tell(Form.WEIGHTED)), case.values, step=1e-4, relative=1e-5)


def test_terms_have_the_numeric_jacobian_by_the_focal_length():
    case = Case(1, compiled=False, zoom=-0.3)
    for name in ("reprojection", "box"):
        assert_jacobian(term_factor(case.tell(Form.WEIGHTED), name), case.values, step=1e-4, relative=1e-5)


@BOTH
@pytest.mark.parametrize("name", VARIANTS)
def test_weighted_rows_have_the_numeric_jacobian(name, compiled):
    case = Case(1, compiled=compiled, **VARIANTS[name])
    assert_jacobian(observation_factor(case.tell(Form.WEIGHTED)), case.values, step=1e-4, relative=1e-5)


@BOTH
@pytest.mark.parametrize("name", VARIANTS)
def test_newtons_gradient_is_that_of_the_loss(name, compiled):
    case = Case(2, compiled=compiled, **VARIANTS[name])
    factor = observation_factor(case.tell(Form.NEWTON))
    gradient = graph_of(factor).linearize(case.values).gradientAtZero()
    zero, step = case.values.zeroVectors(), 1e-6
    for key in list(factor.keys()):
        for axis, analytic in zip(np.eye(len(zero.at(key))), gradient.at(key), strict=True):
            errors = []
            for sign in (step, -step):
                change = gtsam.VectorValues()
                change.insert(key, sign * axis)
                errors.append(factor.error(case.values.retract(change)))
            scale = max(1.0, np.abs(gradient.vector()).max())
            assert (errors[0] - errors[1]) / (2 * step) == pytest.approx(analytic, abs=2e-5 * scale)


@BOTH
def test_all_rows_are_those_of_the_terms(compiled):
    """Error and linear system, whichever factors they come from; and the terms on their own variables."""
    case = Case(3, compiled=compiled)
    rows = case.tell(Form.WEIGHTED)
    alone = {name: term_factor(rows, name) for name in rows.terms}
    keys = {name: set(factor.keys()) for name, factor in alone.items()}
    assert keys == {"reprojection": {X(), L(), O()}, "box": {X(), L()}, "ground": {X()}, "cheirality": {X(), L(), O()}}
    assert alone["cheirality"].error(case.values) == 0.0
    together, apart = graph_of(observation_factor(rows)), graph_of(*alone.values())
    assert together.error(case.values) == pytest.approx(apart.error(case.values), rel=1e-12)
    ordering = gtsam.Ordering()
    for key in (X(), L(), O()):
        ordering.push_back(key)
    mine, theirs = (graph.linearize(case.values).augmentedHessian(ordering) for graph in (together, apart))
    np.testing.assert_allclose(mine, theirs, atol=1e-11 * np.abs(theirs).max())
    sigma = np.tile(case.sigma**2 * np.eye(2), (SIZE, 1, 1))
    own = reprojection_factor(case.kernel, case.pixels, case.weights, sigma)
    assert alone["reprojection"].error(case.values) == pytest.approx(rows.share * own.error(case.values), rel=1e-9)


@BOTH
def test_behind_the_camera_the_energy_is_infinite(compiled):
    case = Case(4, compiled=compiled)
    case.values.update(X(), gtsam.Pose3(case.pose.rotation(), np.array([0.0, 1.0, 0.5])))
    assert observation_factor(case.tell(Form.NEWTON)).error(case.values) == np.inf


@BOTH
def test_infinitely_far_the_energy_is_infinite(compiled):
    """A step that overflows is one to refuse, not a fault of the factor."""
    case = Case(4, compiled=compiled)
    case.values.update(X(), gtsam.Pose3(case.pose.rotation(), np.array([0.0, 1.0, np.inf])))
    assert observation_factor(case.tell(Form.NEWTON)).error(case.values) == np.inf


@pytest.mark.skipif(KERNEL is None, reason="no compiled kernel")
def test_arrays_that_do_not_fit_are_refused_at_the_border():
    rng = np.random.default_rng(0)
    mean, basis = rng.normal(size=(4, 3)), rng.normal(size=(2, 12))
    pixels, whitener = rng.normal(size=(4, 2)), np.ones((4, 3))
    with pytest.raises(ValueError, match="do not belong together"):
        KERNEL.Observation(CAMERA, mean, basis[:, :9].copy(), pixels, whitener, None, None)
    with pytest.raises(ValueError, match="do not belong together"):
        KERNEL.Observation(CAMERA, mean, basis, pixels[:3], whitener, None, None)
    seen = KERNEL.Observation(CAMERA, mean, basis, pixels, whitener, None, None)
    rows = KERNEL.ImageRows(seen, 1.0, True)  # noqa: FBT003  # a kernel takes no keywords
    variables, residual = [np.zeros(12), np.zeros(2), np.zeros(12)], np.empty(20)
    rows.evaluate(variables, residual, None)
    rows.evaluate([*variables[:2], None], residual, None)
    for place, wrong in [(0, np.zeros(9)), (1, np.zeros(3)), (2, np.zeros(9)), (0, None)]:
        with pytest.raises((ValueError, TypeError), match=r"expected|None"):
            rows.evaluate([*variables[:place], wrong, *variables[place + 1 :]], residual, None)
    with pytest.raises(ValueError, match="Jacobian"):
        rows.evaluate(variables, residual, np.empty((20, 5)))
    with pytest.raises(ValueError, match="residual"):
        rows.evaluate(variables, residual[:8], None)
    with pytest.raises(ValueError, match="expected"):
        rows.tell(np.ones(3), np.ones(4), np.ones(4), 1.0)
    with pytest.raises(ValueError, match="search_by"):
        rows.see(np.ones(4), np.ones(4), 1.0)
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.copy(rows)
