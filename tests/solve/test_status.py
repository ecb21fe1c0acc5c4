"""How far to trust a result: each status, on either side of its limit."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import adjust_shape
from fgrecon.solve.graph.covariance import Covariances
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.result import build_result
from tests.cars import CAMERA, observe, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.support import problem_of


@pytest.fixture(scope="module")
def solved():
    """A problem, its pose stage without alternatives, its shape stage, and a covariance of a tenth of a degree."""
    problem, start = problem_of(0)
    tight = Covariances(np.radians(0.1) ** 2 * np.eye(6), np.eye(5), np.tile(np.eye(3), (14, 1, 1)))
    return problem, replace(start, alternatives=()), adjust_shape(problem, start), tight


def status_of(solved, *, start=None, shape=None, covariance=None):
    problem, pose, estimate, sure = solved
    result = build_result(
        problem, start or pose, shape or estimate, sure if covariance is None else covariance[0], (), {}
    )
    return result.status, result.message


def test_a_clear_result(solved):
    assert status_of(solved)[0] is Status.CONVERGED


@pytest.mark.parametrize("axis", range(3))
def test_an_orientation_known_to_30_degrees_is_determined(solved, axis):
    for degrees, status in ((29.0, Status.CONVERGED), (31.0, Status.DEGENERATE)):
        pose = solved[3].pose.copy()
        pose[axis, axis] = np.radians(degrees) ** 2
        assert status_of(solved, covariance=(replace(solved[3], pose=pose),))[0] is status
    far = solved[3].pose.copy()
    far[3 + axis, 3 + axis] = 1e4  # metres are another matter
    assert status_of(solved, covariance=(replace(solved[3], pose=far),))[0] is Status.CONVERGED


def test_what_went_wrong_comes_first(solved):
    shape = solved[2]
    assert status_of(solved, covariance=(None,)) == (
        Status.DEGENERATE,
        "The keypoints with any weight leave pose or shape undetermined.",
    )
    status, message = status_of(solved, shape=replace(shape, unfinished="after 60 iterations"))
    assert (status, "after 60 iterations" in message) == (Status.DEGENERATE, True)
    status, message = status_of(solved, shape=replace(shape, failure="a singular system"), covariance=(None,))
    assert (status, "a singular system" in message) == (Status.FAILED, True)


@pytest.mark.parametrize("margin", [0.5, 3.0, 6.0])
def test_another_pose_within_the_margin_is_ambiguous(solved, margin):
    problem, pose, shape, sure = solved
    options = Options(ambiguity_margin=margin)
    turned = pose.camera_T_object.copy()
    turned[:3, :3] = turned[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    for excess, status in ((margin - 0.1, Status.AMBIGUOUS), (margin + 0.1, Status.CONVERGED)):
        start = replace(pose, alternatives=(Alternative(turned, shape.coefficients, excess),))
        result = build_result(replace(problem, options=options), start, shape, sure, (), {})
        assert result.status is status
        assert result.alternatives == start.alternatives
        assert ("turned by 180 degrees" in result.message) == (status is Status.AMBIGUOUS)


def test_whole_cars_and_halves():
    """Five points of one side of a car seen from behind leave front and back open; a whole car is clear."""
    observation = observe(load_prior("car14"), yaw_pose(np.radians(90)))
    pixels = observation.keypoints.copy()
    pixels[np.setdiff1d(np.arange(14), [0, 2, 4, 10, 12])] = np.nan
    two = reconstruct(pixels, CAMERA, confidence=np.full(14, 0.9), ground=1.65)
    assert two.status is Status.AMBIGUOUS
    assert two.alternatives[0].excess <= Options().ambiguity_margin
    assert "nats worse" in two.message
    assert reconstruct(observation, CAMERA).status is Status.CONVERGED
    loose = reconstruct(observation.keypoints, CAMERA, options=make_options(sigma_pixels=500.0, box_model="off"))
    assert loose.status is Status.DEGENERATE
    assert "degrees only" in loose.message
