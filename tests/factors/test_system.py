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
from factors.system import System
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


@pytest.fixture(params=[True, False], ids=["dense", "sparse"])
def dense(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr("factors.system._DENSE", 0)
    return request.param


@pytest.mark.parametrize("apart", [0.0, 1e-8, 1e-3, 0.1, 0.6])
@pytest.mark.usefixtures("dense")
def test_information_step_and_energy_are_gtsams(apart):
    for seed in range(5):
        factors, values = case(seed, apart)
        graph, system = graph_of(*factors), System(factors, values)
        ordering = gtsam.Ordering()
        for key in values.keys():  # noqa: SIM118  # a key vector
            ordering.push_back(key)
        linear = graph.linearize(values)
        theirs = linear.hessian(ordering)[0]
        np.testing.assert_allclose(system.information(values), theirs, atol=1e-11 * np.abs(theirs).max())
        step, energy = system.step(values)
        solution = linear.optimize()
        np.testing.assert_allclose(step, solution.vector(), rtol=1e-5, atol=1e-7 * np.abs(step).max())
        assert energy + system.rest_error(values) == pytest.approx(graph.error(values), rel=1e-11)
        assert system.error(values) == pytest.approx(graph.error(values), rel=1e-11)
        after = system.moved(values, solution.vector())
        assert after.equals(values.retract(solution), 1e-12)
        assert system.error(after) == pytest.approx(graph.error(after), rel=1e-11)


@pytest.mark.usefixtures("dense")
def test_another_graph_of_the_same_variables_has_its_own_factors():
    factors, values = case(2)
    others = [*factors[:5], coefficients_prior(L(), 4, 0.3), offsets_prior(O(), [0.2, 0.2, 0.2])]
    system = System(factors, values, others)
    for second, some in ((True, others), (False, factors)):
        alone = System(some, values).information(values)
        np.testing.assert_allclose(system.information(values, second=second), alone, rtol=1e-12, atol=1e-9)


@compiled
def test_nothing_that_is_compiled_calls_python(dense, monkeypatch):
    """Of the factors above only GTSAM's own are not compiled, and one of the caller's own is called back."""
    factors, values = case(0)
    calls = []

    def callback(values, want_jacobian):
        calls.append(want_jacobian)
        return values.atVector(L()), np.eye(4) if want_jacobian else None

    system = System([*factors, guarded_factor("mine", 1.0, [L()], [4], 4, callback)], values)
    for name in ("factors.motion._Motion", "factors.motion._Drive", "factors.contact._Contact"):
        monkeypatch.delattr(f"{name}.__call__")
    linear, _ = system.linearise(values)
    assert np.isfinite(system.error(values))
    assert calls == [True, False]
    kinds = [type(linear.at(i)).__name__ for i in range(linear.size())]
    # A walk to elsewhere, a prior on the ground and the caller's own are not; two are of motion, two are contacts.
    assert (kinds.count("JacobianFactor"), kinds.count("HessianFactor")) == ((0, 1) if dense else (3, 7))


@compiled
def test_factors_of_the_same_variables_are_one(monkeypatch):
    monkeypatch.setattr("factors.system._DENSE", 0)
    noise = gtsam.noiseModel.Unit.Create(3)
    motion = motion_factor(X(0, 0), V(0, 0), X(0, 1), 0.1, 1.0)
    _, values = case(1)
    factors = [drive_factor(V(0, 0), noise), motion, drive_factor(V(0, 0), 0.3, 4.0)]
    linear, _ = System(factors, values).linearise(values)
    assert linear.size() == 1
    assert sorted(linear.at(0).keys()) == sorted(motion.keys())


@compiled
def test_what_does_not_fit_is_refused_at_the_border():
    drive, group = KERNEL.Drive(np.nan, 1.0), [(3, {0: 0})]
    with pytest.raises(ValueError, match="3 numbers"):
        KERNEL.Rows([(4, 4)], [(4, {0: 0})], [(drive, 1, 0, (0,), None, None)])
    with pytest.raises(ValueError, match="missing"):
        KERNEL.Rows([(3, 3)], group, [(drive, 1, 0, (None,), None, None)])
    with pytest.raises(ValueError, match="whitener"):
        KERNEL.Rows([(3, 3)], group, [(drive, 1, 0, (0,), np.eye(4), None)])
    rows = KERNEL.Rows([(3, 3)], group, [(drive, 1, 0, (0,), np.eye(3), None)])
    with pytest.raises(ValueError, match="another size"):
        rows.load([np.zeros(2)])
    with pytest.raises(ValueError, match="directions"):
        KERNEL.Contact(np.zeros(3), 1.0, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="motion"):
        KERNEL.Motion(0.1, np.eye(3))
    for one in (drive, KERNEL.Motion(0.1, np.eye(4))):
        with pytest.raises(TypeError, match="cannot be copied"):
            copy.deepcopy(one)
