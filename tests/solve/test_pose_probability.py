"""The probabilities of a result's pose and of the others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fgrecon import reconstruct
from fgrecon.core.coverage import reliability
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import Alternative, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import KITTI_CAMERA, yaw_pose
from fgrecon.solve.pose_probability import facing_by_energies, with_probabilities
from fgrecon_research.simulation import HARD, simulate_many

POSE = yaw_pose(0.3, np.array([1.0, 1.65, 12.0]))
SHAPE = np.zeros(5)


def other(degrees, excess):
    return Alternative(yaw_pose(0.3 + np.radians(degrees), np.array([1.0, 1.65, 12.0])), SHAPE, excess)


@given(
    st.lists(st.tuples(st.floats(-180, 180), st.floats(0, 500)), max_size=5),
    st.floats(1e-6, 1.0 - 1e-6),
)
def test_they_add_up_and_the_lower_energy_is_more_probable(given_, facing):
    others = with_probabilities(POSE, SHAPE, [other(*one) for one in given_], facing)
    probabilities = np.array([one.probability for one in others])
    assert (probabilities >= 0.0).all()
    assert probabilities.sum() <= 1.0 + 1e-12
    turned = np.array(
        [abs(wrap_angle(np.arctan2(-o.camera_T_object[2, 0], o.camera_T_object[0, 0]) - 0.3)) for o in others]
    )
    behind = probabilities[turned > np.pi / 2].sum()
    if 1.0 - facing >= 0.01 and np.all(np.abs(turned - np.pi / 2) > 1e-6):
        assert behind == pytest.approx(1.0 - facing)  # some pose faces the other way
    for here, one in zip(turned, others, strict=True):
        for there, two in zip(turned, others, strict=True):
            if (here > np.pi / 2) == (there > np.pi / 2) and one.excess < two.excess:
                assert one.probability >= two.probability


def test_a_facing_without_a_pose_gets_one():
    (turned,) = with_probabilities(POSE, SHAPE, [], 0.7)
    assert turned.probability == pytest.approx(0.3)
    np.testing.assert_allclose(turned.camera_T_object[:3, 0], -POSE[:3, 0])
    assert with_probabilities(POSE, SHAPE, [], 0.995) == ()


def test_nothing_is_reported_where_nothing_is_known():
    unknown = [other(180.0, float("nan"))]
    assert np.isnan(facing_by_energies(POSE, unknown))
    assert np.isnan(with_probabilities(POSE, SHAPE, unknown, 0.9)[0].probability)
    assert np.isnan(with_probabilities(POSE, SHAPE, [other(180.0, 3.0)], float("nan"))[0].probability)


def test_margins_make_a_facing_surer():
    margins = [facing_by_energies(POSE, [other(10.0, 0.1), other(175.0, e)]) for e in (0.0, 3.0, 10.0, 50.0)]
    assert margins == sorted(margins)
    assert margins[-1] == facing_by_energies(POSE, [other(10.0, 0.1)])


def test_results_of_keypoints_alone_say_it():
    """On simulated keypoints of difficult cars what is said is so; and it survives JSON."""
    prior, said, right = load_prior("car14"), [], []
    for seen, truth in simulate_many(prior, 150, np.random.default_rng(5), HARD):
        found = reconstruct(seen, KITTI_CAMERA, prior=prior, ground=1.65)
        assert 0.0 < found.facing_probability < 1.0
        assert found.uncertainty.pose_probability + sum(
            o.probability for o in found.uncertainty.alternatives
        ) == pytest.approx(1.0)
        if found.status is Status.CONVERGED:
            assert all(o.probability <= found.uncertainty.pose_probability for o in found.uncertainty.alternatives)
        again = type(found).from_dict(found.to_dict(compact=True))
        assert again.uncertainty.pose_probability == pytest.approx(found.uncertainty.pose_probability, abs=1e-5)
        said.append(found.facing_probability)
        right.append(found.camera_T_object[:3, 0] @ truth.camera_T_object[:3, 0] > 0.0)
    assert reliability(said, right).error < 0.05
