"""What an observation accepts, what it makes of gaps, and what it refuses by name."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation

PIXELS = np.array([[100.0, 50.0], [140.0, 70.0], [np.nan, 60.0], [90.0, 55.0]])


def test_a_missing_coordinate_makes_a_missing_keypoint():
    covariance = np.array([np.diag([4.0, 9.0])] * 4)
    covariance[2] = np.nan  # nobody knows it
    observation = Observation(PIXELS, [0.9, 0.8, 0.7, 0.6], [80, 40, 150, 90], covariance)
    assert observation.measured.tolist() == [True, True, False, True]
    assert np.isnan(observation.keypoints[2]).all()
    assert observation.confidence.tolist() == [0.9, 0.8, 0.0, 0.6]
    np.testing.assert_array_equal(observation.covariance[2], np.eye(2))
    np.testing.assert_array_equal(observation.covariance[0], np.diag([4.0, 9.0]))


def test_extent_of_box_or_points():
    assert Observation(PIXELS, np.ones(4), [80, 40, 150, 130]).extent == 90.0
    assert Observation(PIXELS, np.ones(4)).extent == 50.0
    assert Observation(np.full((4, 2), np.nan), np.ones(4)).extent == 0.0


@given(arrays(np.float64, (5, 2), elements=st.floats(-1e7, 1e7) | st.just(np.nan)), st.integers(0, 1))
@settings(deadline=None, derandomize=True, max_examples=80)
def test_any_pixels_are_kept_or_missing(pixels, one):
    observation = Observation(pixels, np.full(5, float(one)))
    whole = ~np.isnan(pixels).any(axis=1)
    np.testing.assert_array_equal(observation.measured, whole)
    np.testing.assert_array_equal(observation.keypoints[whole], pixels[whole])
    assert (observation.confidence == np.where(whole, one, 0)).all()


def test_the_caller_keeps_his_arrays():
    pixels, confidence = PIXELS.copy(), np.full(4, 0.5)
    Observation(pixels, confidence)
    np.testing.assert_array_equal(pixels, PIXELS)
    assert (confidence == 0.5).all()


def spoiled(covariance):
    result = np.array([np.eye(2)] * 4)
    result[1] = covariance
    return result


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("keypoints", {"keypoints": np.zeros((4, 3))}),
        ("keypoints", {"keypoints": "pixels"}),
        ("keypoints", {"keypoints": np.where(np.isnan(PIXELS), np.inf, PIXELS)}),
        ("keypoints", {"keypoints": np.where(np.isnan(PIXELS), PIXELS, 2e7)}),
        ("box", {"box": [80.0, 40.0, 1e8, 90.0]}),
        ("covariance", {"covariance": spoiled(1e20 * np.eye(2))}),
        ("confidence", {"confidence": np.ones(3)}),
        ("confidence", {"confidence": [1.0, 1.1, 0.0, 1.0]}),
        ("confidence", {"confidence": [1.0, -0.1, 0.0, 1.0]}),
        ("confidence", {"confidence": [1.0, np.nan, 0.0, 1.0]}),
        ("box", {"box": np.ones(3)}),
        ("box", {"box": [80.0, 40.0, 80.0, 90.0]}),
        ("box", {"box": [150.0, 40.0, 80.0, 90.0]}),
        ("box", {"box": [80.0, 40.0, 150.0, 40.5]}),
        ("box[2]", {"box": [80.0, 40.0, np.nan, 90.0]}),
        ("covariance", {"covariance": np.eye(2)}),
        ("covariance", {"covariance": spoiled([[1.0, 0.5], [0.0, 1.0]])}),
        ("covariance", {"covariance": spoiled([[1.0, 2.0], [2.0, 1.0]])}),
        ("covariance", {"covariance": spoiled(np.zeros((2, 2)))}),
        ("covariance", {"covariance": spoiled(np.full((2, 2), np.nan))}),
    ],
)
def test_refusals_name_the_field(field, change):
    arguments = {"keypoints": PIXELS, "confidence": np.ones(4), **change}
    with pytest.raises(InvalidInputError) as caught:
        Observation(**arguments)
    assert caught.value.field == field
    assert caught.value.fix


def test_a_confidence_of_a_missing_keypoint_is_not_judged():
    assert Observation(PIXELS, [1.0, 1.0, np.nan, 1.0]).confidence[2] == 0.0


def test_a_covariance_that_is_symmetric_but_for_rounding_is_kept_symmetric():
    rng = np.random.default_rng(0)
    jacobian, root = rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
    covariance = jacobian @ (root @ root.T) @ jacobian.T + np.array([[0.0, 3e-16], [0.0, 0.0]])
    seen = Observation.of(np.zeros((3, 2)), covariance=np.tile(covariance, (3, 1, 1)))
    np.testing.assert_array_equal(seen.covariance, seen.covariance.swapaxes(1, 2))
    np.testing.assert_allclose(seen.covariance[0], covariance, rtol=1e-12)
