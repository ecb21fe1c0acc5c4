"""Factors linearised together: GTSAM's own linearisation of the same factors is the oracle."""

import copy

import gtsam
import numpy as np
import pytest

from factors import (
    G,
    L,
    Loss,
    O,
    RobustLoss,
    V,
    X,
    coefficients_prior,
    contact_factor,
    drive_factor,
    guarded_factor,
    motion_factor,
    offsets_prior,
)
from factors.contact import GroundFrame
from factors.linear import Walk, ZeroPrior
from factors.motion import moved
from factors.native import native
from factors.noise import full_noise
from factors.shape_prior import spread_prior
from factors.system import CompiledSystem, MixedSystem, packed_plane, packed_pose, system_of
from tests.factors.support import graph_of, random_pose

KERNEL = native("factors._rows")
compiled = pytest.mark.skipif(KERNEL is None, reason="no compiled kernel")
CAMERA = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.05, 0.02), np.array([0.1, 0.02, 1.3]))


def spread(rng, size):
    root = rng.normal(size=(size, size))
    return full_noise("spread", 0.01 * (root @ root.T + np.eye(size)))


def case(seed, apart=0.1):
    """Factors of every kind on two poses, velocities, a shape and a ground; and values."""
    rng = np.random.default_rng(seed)
    values, velocity = gtsam.Values(), rng.normal(size=3) * [10.0, 1.0, 0.5]
    first = random_pose(rng)
    values.insert(X(0, 0), first)
    values.insert(X(0, 1), moved(first, velocity, 0.1, CAMERA).retract(apart * rng.normal(size=6)))
    values.insert(V(0, 0), velocity)
    values.insert(V(0, 1), velocity + rng.normal(size=3))
    values.insert(G(), 0.1 * rng.normal(size=3))
    values.insert(L(), rng.normal(size=4))
    values.insert(O(), 0.1 * rng.normal(size=9))
    frame = GroundFrame.of([0.05, 1.0, -0.1], 1.7)
    robust = [RobustLoss.of(loss).wrap(spread(rng, 4)) for loss in (Loss.CAUCHY, Loss.HUBER)]
    factors = [
        motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, spread(rng, 6), CAMERA),
        motion_factor(X(0, 1), V(0, 1), X(0, 0), 0.3, 0.2),
        drive_factor(V(0, 0), 0.5, 5.0),
        drive_factor(V(0, 1), spread(rng, 3)),
        *(contact_factor(X(0, i), G(), frame, noise) for i, noise in enumerate(robust)),
        coefficients_prior(L(), 4),
        spread_prior(V(0, 1), spread(rng, 3).covariance()),
        offsets_prior(O(), [0.1, 0.2, 0.3]),
        gtsam.BetweenFactorVector(V(0, 0), V(0, 1), np.ones(3), spread(rng, 3)),
        Walk(V(0, 0), V(0, 1), spread(rng, 3)),
        ZeroPrior(V(0, 0), RobustLoss.of(Loss.CAUCHY, 0.5).wrap(spread(rng, 3))),
        gtsam.PriorFactorVector(G(), np.ones(3), spread(rng, 3)),
    ]
    return factors, values


def ours(factors):
    """Those that can be compiled, and priors on what GTSAM's own are about."""
    some = [one for one in factors if type(one) not in (gtsam.BetweenFactorVector, gtsam.PriorFactorVector)]
    return [*some, *(ZeroPrior(key, gtsam.noiseModel.Isotropic.Sigma(3, 0.5)) for key in (G(), V(0, 1)))]


@pytest.fixture(params=[True, False], ids=["compiled", "mixed"])
def some(request):
    """A choice of the factors of a case, and the kind of system that they make."""
    return (ours, MixedSystem if KERNEL is None else CompiledSystem) if request.param else (list, MixedSystem)


@pytest.mark.parametrize("apart", [0.0, 1e-8, 1e-3, 0.1, 0.6])
def test_information_step_and_energy_are_gtsams(apart, some):
    choose, kind = some
    for seed in range(5):
        factors, values = case(seed, apart)
        factors = choose(factors)
        graph, system = graph_of(*factors), system_of(factors, values)
        assert isinstance(system, kind)
        linear, point = graph.linearize(values), system.point(values)
        ordering = gtsam.Ordering()
        for key in system.places:
            ordering.push_back(key)
        theirs = linear.hessian(ordering)[0]
        np.testing.assert_allclose(system.information(point), theirs, atol=1e-11 * np.abs(theirs).max())
        step, energy = system.step(point)
        solution = linear.optimize()
        expected = solution.vector(gtsam.KeyVector([*system.places]))
        np.testing.assert_allclose(step, expected, rtol=1e-5, atol=1e-7 * np.abs(step).max())
        assert energy() == pytest.approx(graph.error(values), rel=1e-11)
        assert system.error(point) == pytest.approx(graph.error(values), rel=1e-11)
        every_third = factors[::3]
        expected_energy = sum(factor.error(values) for factor in every_third)
        assert system.error_of(every_third, point) == pytest.approx(expected_energy, rel=1e-11)
        moved = system.moved(point, expected)
        after = system.values(moved)
        assert after.equals(values.retract(solution), 1e-12)
        assert system.error(moved) == pytest.approx(graph.error(after), rel=1e-11)


@compiled
def test_nothing_that_is_compiled_calls_python(monkeypatch):
    """Of the factors above only GTSAM's own are not compiled, and one of the caller's own is called back."""
    factors, values = case(0)
    calls = []

    def callback(values, want_jacobian):
        calls.append(want_jacobian)
        return values.atVector(L()), np.eye(4) if want_jacobian else None

    system = system_of([*factors, guarded_factor("mine", 1.0, [L()], [4], 4, callback)], values)
    for name in ("factors.motion._Motion", "factors.motion._Drive", "factors.contact._Contact"):
        monkeypatch.delattr(f"{name}.__call__")
    linear, _ = system.linear(values)
    assert np.isfinite(system.error(values))
    assert calls == [True, False]
    kinds = [type(linear.at(i)).__name__ for i in range(linear.size())]
    # A walk to elsewhere, a prior on the ground and the caller's own are not; two are of motion, two are contacts.
    assert (kinds.count("JacobianFactor"), kinds.count("HessianFactor")) == (3, 7)


@compiled
def test_factors_of_the_same_variables_are_one():
    noise = gtsam.noiseModel.Unit.Create(3)
    motion = motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, 1.0)
    _, values = case(1)
    factors = [drive_factor(V(0, 0), noise), motion, drive_factor(V(0, 0), 0.3, 4.0)]
    linear, _ = system_of(factors, values).linear(values)  # of others nothing is known
    assert linear.size() == 1
    assert sorted(linear.at(0).keys()) == sorted(motion.keys())


@compiled
@pytest.mark.parametrize("seed", range(5))
def test_covariances_are_gtsams(seed):
    """Of all variables or of some; only where elimination leaves something about both there are those of two."""
    factors, values = case(seed)
    factors = ours(factors)
    system, marginals = system_of(factors, values), gtsam.Marginals(graph_of(*factors), values)
    assert isinstance(system, CompiledSystem)
    point = system.point(values)
    for keys in (None, [O(), G()]):
        found = system.covariance(point, 1e-12, keys)
        for key in system.places if keys is None else keys:
            theirs = marginals.marginalCovariance(key)
            indices = np.arange(system.places[key].start, system.places[key].stop)
            np.testing.assert_allclose(found(indices), theirs, rtol=1e-6, atol=1e-8 * np.abs(theirs).max())
    pose, shape, ground = (system.places[key].start for key in (X(0, 0), L(), G()))
    assert np.isfinite(system.covariance(point, 1e-12)(np.array([ground, pose]))).all()
    for wrong, some in ((pose, None), (pose, [O(), G()]), (system.size, None), (-1, None)):
        with pytest.raises(KeyError):
            system.covariance(point, 1e-12, some)(np.array([shape, wrong]))
    assert system.covariance(point, 1.1) is None


@compiled
def test_a_direction_that_nothing_determines_has_no_step():
    values = gtsam.Values()
    values.insert(V(0, 0), np.ones(3))
    values.insert(V(0, 1), np.zeros(3))
    system = system_of([Walk(V(0, 0), V(0, 1), gtsam.noiseModel.Unit.Create(3))], values)
    assert isinstance(system, CompiledSystem)
    with pytest.raises(RuntimeError, match="indeterminate"):
        system.step(system.point(values))
    assert system.covariance(system.point(values), 1e-12) is None


@compiled
@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.5, 3.0])
def test_where_a_step_leads_is_where_gtsams_does(size):
    """Wherever a normal points, and with the tangent basis of the next step."""
    rng = np.random.default_rng(0)
    rows = KERNEL.Rows([(10, 3), (12, 6), (2, 2)], [])
    for _ in range(20):
        plane, pose = gtsam.OrientedPlane3(np.append(rng.normal(size=3), 1.0)), random_pose(rng)
        step = size * rng.normal(size=11)
        found = rows.moved(rows.point([packed_plane(plane), pose.matrix(), np.ones(2)]), step)
        np.testing.assert_allclose(found[:10], packed_plane(plane.retract(step[:3])), atol=1e-14)
        np.testing.assert_allclose(found[10:22], packed_pose(pose.retract(step[3:9]).matrix()), atol=1e-14)
        np.testing.assert_array_equal(found[22:], 1.0 + step[9:])


@compiled
def test_what_does_not_fit_is_refused_at_the_border():
    drive = KERNEL.Drive(np.nan, 1.0)
    with pytest.raises(ValueError, match="3 numbers"):
        KERNEL.Rows([(4, 4)], [(drive, (0,), None, None)])
    with pytest.raises(ValueError, match="missing"):
        KERNEL.Rows([(3, 3)], [(drive, (None,), None, None)])
    with pytest.raises(ValueError, match="whitener"):
        KERNEL.Rows([(3, 3)], [(drive, (0,), np.eye(4), None)])
    rows = KERNEL.Rows([(3, 3)], [(drive, (0,), np.eye(3), None)])
    for wrong in ([np.zeros(2)], [np.eye(4)]):
        with pytest.raises(ValueError, match="another size"):
            rows.point(wrong)
    with pytest.raises(ValueError, match="1 variables"):
        rows.point([])
    for call in (rows.error, rows.linearise):
        with pytest.raises(ValueError, match="a point"):
            call(np.zeros(4))
    with pytest.raises(ValueError, match="a step"):
        rows.moved(np.zeros(3), np.zeros(4))
    with pytest.raises(ValueError, match="a place"):
        rows.covariance(4, 0.0)
    with pytest.raises(ValueError, match="directions"):
        KERNEL.Contact(np.zeros(3), 1.0, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="motion"):
        KERNEL.Motion(0.1, np.eye(3))
    for one in (drive, KERNEL.Motion(0.1, np.eye(4))):
        with pytest.raises(TypeError, match="cannot be copied"):
            copy.deepcopy(one)
