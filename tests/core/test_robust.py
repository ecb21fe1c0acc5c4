"""The weights of every strategy: their energies' derivatives, the paper's equations by hand, and their bounds."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import factors
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.robust import Evidence, RobustStrategy, StrategyName, strategy

PAPERS = (StrategyName.PAPER, StrategyName.PAPER_LITERAL)
M_ESTIMATORS = (StrategyName.HUBER, StrategyName.CAUCHY, StrategyName.GEMAN_MCCLURE, StrategyName.TUKEY)
WITH_ENERGY = [name for name in StrategyName if name not in PAPERS]

shared = settings(deadline=None, derandomize=True, max_examples=60)
probabilities = arrays(np.float64, 6, elements=st.floats(0.01, 0.99))
squared_distances = arrays(np.float64, 6, elements=st.floats(0.0, 1e4))
masks = arrays(np.bool_, 6)


def evidence(right, outlier=0.05, measured=None):
    right = np.asarray(right, dtype=float)
    measured = np.ones(len(right), dtype=bool) if measured is None else measured
    return Evidence(np.where(measured, right, 0.0), np.full(len(right), outlier), measured)


@pytest.mark.parametrize("name", WITH_ENERGY)
@given(d2=arrays(np.float64, 6, elements=st.floats(0.05, 60.0)), right=probabilities, visible=probabilities)
@shared
def test_weight_is_the_derivative_of_the_energy(name, d2, right, visible):
    """w = 2 dE / d(d^2): a weighted least-squares step goes down the energy's gradient."""
    robust = strategy(name)
    # Tukey's and Huber's second derivative jumps at their constant: a difference across it is not a derivative.
    d2 = np.where(np.abs(np.sqrt(d2) - robust.robust_loss.constant) < 1e-3, d2 + 0.1, d2)
    seen, step = evidence(right), 1e-5
    weights, _ = robust.evaluate(d2, seen, visible)
    for i in range(len(d2)):
        up, down = (robust.evaluate(d2 + s * step * np.eye(6)[i], seen, visible)[1] for s in (1, -1))
        assert weights[i] == pytest.approx((up - down) / step, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("name", M_ESTIMATORS)
def test_m_estimators_are_those_of_the_factor_graph(name):
    """The pose search and the graph must minimise the same energy."""
    robust, d2 = strategy(name), np.linspace(0.0, 50.0, 101)
    seen, visible = evidence(np.full(101, 0.7)), np.full(101, 0.4)
    initial = robust.initial_weights(seen, visible)
    np.testing.assert_allclose(initial, 0.5 * 0.7 + 0.5 * 0.4)
    theirs = factors.RobustLoss.of(robust.loss).estimator()
    weights, _ = robust.evaluate(d2, seen, visible)
    np.testing.assert_allclose(weights, initial * [theirs.weight(d) for d in np.sqrt(d2)], rtol=1e-12)
    energies = robust.evaluate(d2[:, None], evidence([0.7]), np.array([0.4]))[1]
    np.testing.assert_allclose(energies, initial * [theirs.loss(d) for d in np.sqrt(d2)], rtol=1e-9, atol=1e-15)


def test_mixture_by_bayes():
    """Each cell of the table (visible or not) x (sure or not) written out."""
    robust = RobustStrategy(gross=0.1, missed=0.2, false_alarm=0.03)
    right, visible, outlier, d2 = 0.8, 0.6, 0.04, 2.5
    inlier = visible * right * 0.9 * np.exp(-d2 / 2)
    other = visible * right * 0.1 + visible * 0.2 * (1 - right)
    other += (1 - visible) * (0.97 * (1 - right) + 0.03 * right)
    weights, energy = robust.evaluate(np.array([d2]), evidence([right], outlier), np.array([visible]))
    assert weights[0] == pytest.approx(inlier / (inlier + outlier * other))
    assert energy == pytest.approx(-np.log(inlier + outlier * other))


def test_mixture_speaks_against_a_pose_that_hides_confident_points():
    robust, near = strategy("mixture"), np.full(4, 0.5)
    sure, shown, hidden = evidence(np.full(4, 0.95)), np.full(4, 0.95), np.full(4, 0.05)
    assert robust.evaluate(near, sure, shown)[1] < robust.evaluate(near, sure, hidden)[1]
    unsure = evidence(np.full(4, 0.02))
    assert robust.evaluate(near, unsure, hidden)[1] < robust.evaluate(near, unsure, shown)[1]


D2 = np.array([0.0, 4.0, 16.0])
RIGHT, VISIBLE = np.array([0.9, 0.5, 0.1]), np.array([1.0, 0.5, 0.0])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # mu0 = 0.5, mu1 = 0.5, mu2 = 0.7; errors 0, 2, 4. w(0) = (0.95, 0.5, 0.05).
        # s = exp(-e) of the errors divided by their mean for `paper`, the errors divided by the largest for
        # `paper_literal`: w(1) = 0.5 w(0) + 0.5 (0.7 s + 0.3 w_vis)
        ("paper", [0.475 + 0.5, 0.25 + 0.5 * (0.7 * np.exp(-1) + 0.15), 0.025 + 0.5 * 0.7 * np.exp(-2)]),
        ("paper_literal", [0.475 + 0.5 * 0.3, 0.25 + 0.5 * (0.35 + 0.15), 0.025 + 0.5 * 0.7]),
    ],
)
def test_equations_4_and_5_by_hand(name, expected):
    robust = strategy(name)
    initial = robust.initial_weights(evidence(RIGHT), VISIBLE)
    np.testing.assert_allclose(initial, [0.95, 0.5, 0.05])
    np.testing.assert_allclose(robust.evaluate(D2, evidence(RIGHT), VISIBLE, previous=initial)[0], expected)
    np.testing.assert_allclose(
        robust.evaluate(D2, evidence(RIGHT), VISIBLE)[0], expected
    )  # from Eq. 4 without a previous
    again = robust.evaluate(D2, evidence(RIGHT), VISIBLE, previous=np.array(expected))[0]
    np.testing.assert_allclose(again - expected, 0.5 * (np.array(expected) - initial), atol=1e-15)  # mu1 = 0.5


def test_the_readings_of_the_paper_differ_where_it_matters():
    """The worst point loses weight by the text and gains weight by the printed formula."""
    d2, even = np.array([0.0, 0.0, 0.0, 25.0]), np.full(4, 0.8)  # three points fit, one is wrong
    for name, favoured in (("paper", 0), ("paper_literal", 3)):
        robust = strategy(name)
        after = robust.evaluate(d2, evidence(even), even, previous=robust.initial_weights(evidence(even), even))[0]
        assert after[favoured] > after[3 - favoured] + 0.3


@pytest.mark.parametrize("name", StrategyName)
@given(d2=squared_distances, right=probabilities, visible=probabilities, measured=masks, progress=st.floats(0, 1))
@shared
def test_weights_are_probabilities_and_zero_without_a_measurement(name, d2, right, visible, measured, progress):
    robust, seen = strategy(name), evidence(right, measured=measured)
    initial = robust.initial_weights(seen, visible)
    weights, energy = robust.evaluate(d2, seen, visible, progress=progress)
    assert np.isfinite(energy)
    for array in (initial, weights):
        assert ((array >= 0) & (array <= 1)).all()
        assert (array[~measured] == 0).all()


@pytest.mark.parametrize("name", StrategyName)
@given(d2=squared_distances, right=probabilities, visible=probabilities, measured=masks)
@shared
def test_what_is_not_measured_has_no_say(name, d2, right, visible, measured):
    """Neither weights nor energy depend on the residuals of keypoints that were not measured."""
    robust, seen = strategy(name), evidence(right, measured=measured)
    other = np.where(measured, d2, 7.0 + d2[::-1])
    for mine, theirs in zip(robust.evaluate(d2, seen, visible), robust.evaluate(other, seen, visible), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("name", [name for name in StrategyName if name is not StrategyName.PAPER_LITERAL])
@pytest.mark.parametrize("progress", [0.0, 0.5, 1.0])
def test_weights_fall_with_the_distance(name, progress):
    d2 = np.linspace(0.0, 400.0, 401)
    seen, visible = evidence(np.full(401, 0.8)), np.full(401, 0.8)
    weights = strategy(name).evaluate(d2, seen, visible, progress=progress)[0]
    assert (np.diff(weights) <= 0).all()
    assert weights[0] > 1.4 * weights[-1]


def test_gnc_starts_convex_and_ends_at_geman_mcclure():
    d2, seen, visible = np.linspace(0, 30, 31), evidence(np.full(31, 0.8)), np.full(31, 0.8)
    gnc, geman = strategy("gnc"), strategy("geman_mcclure")
    trail = [gnc.evaluate(d2, seen, visible, progress=p)[0] for p in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert all((later <= earlier).all() for earlier, later in pairwise(trail))
    np.testing.assert_allclose(trail[-1], geman.evaluate(d2, seen, visible)[0])
    # At the start, with control 64 and k = 2, the loss is convex up to d = 16 / sqrt(3): all count about alike.
    assert trail[0].min() > 0.75 * trail[0].max()


@pytest.mark.parametrize("name", StrategyName)
def test_a_batch_is_its_rows(name):
    rng = np.random.default_rng(0)
    d2, visible, seen = rng.gamma(2.0, size=(5, 6)), rng.random((5, 6)), evidence(rng.random(6))
    robust = strategy(name)
    weights, energy = robust.evaluate(d2, seen, visible)
    for i in range(5):
        one = robust.evaluate(d2[i], seen, visible[i])
        np.testing.assert_array_equal(weights[i], one[0])
        np.testing.assert_allclose(energy[i], one[1], rtol=1e-14)


def test_names_and_tuning():
    for name in M_ESTIMATORS:
        robust = RobustStrategy(name)
        assert robust == strategy(name) == RobustStrategy(str(name)) == strategy(str(name))
        assert robust.robust_loss == factors.RobustLoss.of(robust.loss)
    own = RobustStrategy(StrategyName.HUBER, tuning=3.0)
    assert own.robust_loss == factors.RobustLoss.of("huber", 3.0)
    assert strategy(own) is own
    assert [name for name in StrategyName if strategy(name).is_paper] == list(PAPERS)
    assert [name for name in StrategyName if strategy(name).loss is not None] == list(M_ESTIMATORS)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("updates", -1),
        ("updates", 1001),
        ("updates", 2.5),
        ("name", "nonsense"),
        ("tuning", "wide"),
        ("mu0", 1.1),
        ("mu1", -0.1),
        ("mu2", np.nan),
        ("gross", 2.0),
        ("missed", -1.0),
        ("false_alarm", np.inf),
        ("tuning", 0.0),
        ("tuning", np.nan),
        ("gnc_start", 0.5),
        ("gnc_start", np.inf),
    ],
)
def test_errors_name_the_parameter(field, value):
    with pytest.raises(InvalidInputError) as caught:
        RobustStrategy(**{field: value})
    assert caught.value.field == f"strategy.{field}"


def test_an_unknown_name_is_refused():
    with pytest.raises(InvalidInputError, match="mixture, paper"):
        strategy("l2")


@pytest.mark.parametrize("setting", [{"tuning": 1e300}, {"gnc_start": 1e300}, {"updates": 101}])
@pytest.mark.parametrize("name", StrategyName)
def test_settings_that_no_float_or_no_patience_holds_are_refused(name, setting):
    (field,) = setting
    with pytest.raises(InvalidInputError, match=f"strategy.{field}"):
        RobustStrategy(name, **setting)


@pytest.mark.parametrize("name", StrategyName)
def test_the_largest_settings_give_weights(name):
    """Warnings are errors here."""
    robust = RobustStrategy(name, tuning=1e6, gnc_start=1e6, updates=100)
    evidence = Evidence(np.full(3, 0.9), np.full(3, 0.1), np.ones(3, bool))
    weights, energy = robust.evaluate(np.array([0.0, 1.0, 1e12]), evidence, np.ones(3), progress=0.0)
    assert ((weights >= 0) & (weights <= 1)).all()
    assert np.isfinite(energy)


@pytest.mark.parametrize("constant", [1e300, 1e-300, 0.0, np.nan])
def test_constants_of_losses_have_squares(constant):
    with pytest.raises(InvalidInputError, match="constant"):
        factors.RobustLoss.of("huber", constant)
