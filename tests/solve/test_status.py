"""How far to trust a result: each status, on either side of its limit."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgrecon.core.detection import calibrated_facing
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.reconstruction import Alternative, Reconstruction, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.covariance import Covariances
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.result import results, with_facing_over_time
from tests.cars import CAMERA, observe, yaw_pose
from tests.settings import options as make_options
from tests.solve.graph.support import problem_of, solve

FACING = KeypointOptions().facing_bias, KeypointOptions().facing_slope
TIGHT = Covariances(np.radians(0.1) ** 2 * np.eye(6), np.eye(5), np.tile(np.eye(3), (14, 1, 1)), np.eye(3))
"""The pose is known to a tenth of a degree."""


@pytest.fixture(scope="module")
def solved():
    """A problem from its best proposal alone to the minimum."""
    problem, start = problem_of(0)
    return solve(problem, replace(start, alternatives=()))


@pytest.fixture
def status_of(solved, monkeypatch):
    """Status and message of the result with a covariance, alternatives, options or an end of one's own."""

    def judged(covariance=TIGHT, *, alternatives=(), options=None, **ending):
        problem = solved.problem if options is None else replace(solved.problem, options=options)
        adjusted = replace(
            solved.adjusted, alternatives=(alternatives,), optimum=replace(solved.adjusted.optimum, **ending)
        )
        part = adjusted.graph.observations[0]
        monkeypatch.setattr("fgrecon.solve.result.read_covariances", lambda *_: covariance)
        monkeypatch.setattr(part, "problem", problem)
        (result,) = results([GraphObservation(problem)], [solved.start], adjusted, {})
        assert [other.excess for other in result.uncertainty.alternatives] == [other.excess for other in alternatives]
        return result.status, result.message

    return judged


def test_a_clear_result(status_of):
    assert status_of()[0] is Status.CONVERGED


@pytest.mark.parametrize("axis", range(3))
def test_an_orientation_known_to_30_degrees_is_determined(status_of, axis):
    for degrees, status in ((29.0, Status.CONVERGED), (31.0, Status.DEGENERATE)):
        pose = TIGHT.pose.copy()
        pose[axis, axis] = np.radians(degrees) ** 2
        assert status_of(replace(TIGHT, pose=pose))[0] is status
    far = TIGHT.pose.copy()
    far[3 + axis, 3 + axis] = 1e4  # metres are another matter
    assert status_of(replace(TIGHT, pose=far))[0] is Status.CONVERGED


def test_what_went_wrong_comes_first(status_of):
    assert status_of(None) == (
        Status.DEGENERATE,
        "The keypoints with any weight leave pose or shape undetermined.",
    )
    status, message = status_of(unfinished="after 60 iterations")
    assert (status, "after 60 iterations" in message) == (Status.DEGENERATE, True)
    status, message = status_of(None, failure="a singular system")
    assert (status, "a singular system" in message) == (Status.FAILED, True)


@pytest.mark.parametrize("margin", [0.5, 3.0, 6.0])
def test_another_pose_within_the_margin_is_ambiguous(solved, status_of, margin):
    turned = solved.pose.matrix()
    turned[:3, :3] = turned[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    for excess, expected in ((margin - 0.1, Status.AMBIGUOUS), (margin + 0.1, Status.CONVERGED)):
        others = (Alternative(turned, solved.coefficients, excess),)
        status, message = status_of(alternatives=others, options=Options(ambiguity_margin=margin))
        assert status is expected
        assert ("turned by 180 degrees" in message) == (expected is Status.AMBIGUOUS)


def test_a_pose_that_is_hardly_turned_is_judged_by_its_distance(solved, status_of):
    for degrees, words in (
        (0.0, "A pose 0.23 m and 0 degrees away is"),
        (1.0, "0.23 m and 1 degree away"),
        (20, "turned by 20 d"),
    ):
        other = solved.pose.matrix() @ yaw_pose(np.radians(degrees), (0.0, 0.0, 0.0))
        other[:3, 3] += [0.0, 0.0, 0.23]
        _, message = status_of(alternatives=(Alternative(other, solved.coefficients, 0.8),))
        assert words in message


def test_whole_cars_and_halves():
    """Five points of one side of a car seen from behind leave front and back open; a whole car is clear."""
    observation = observe(load_prior("car14"), yaw_pose(np.radians(90)))
    pixels = observation.keypoints.copy()
    pixels[np.setdiff1d(np.arange(14), [0, 2, 4, 10, 12])] = np.nan
    two = reconstruct(pixels, CAMERA, confidence=np.full(14, 0.9), ground=1.65)
    assert two.status is Status.AMBIGUOUS
    assert two.uncertainty.alternatives[0].excess <= Options().ambiguity_margin
    assert "nats worse" in two.message
    assert reconstruct(observation, CAMERA).status is Status.CONVERGED
    for sigma, known in ((150.0, "degrees only (1 sigma)"), (500.0, "not known at all")):
        options = make_options(sigma_pixels=sigma, box_model="off")
        loose = reconstruct(observation.keypoints, CAMERA, options=options)
        assert loose.status is Status.DEGENERATE
        assert known in loose.message


def test_what_no_vehicle_is_does_not_converge(status_of, solved):
    """A length that is negative, or a seventh of a car's; an origin behind the camera."""
    optimum = solved.adjusted.optimum
    prior = solved.problem.model.prior
    operator = np.array([np.tensordot(prior.category.dimension_operator[0], vector, axes=2) for vector in prior.basis])
    inside_out = -operator * 2.0 * prior.box_size(np.zeros(len(operator)))[0] / (operator @ operator)
    (number,) = optimum.state.shapes
    shapes = {number: (inside_out, np.zeros((14, 3)))}
    status, message = status_of(state=replace(optimum.state, shapes=shapes))
    assert status is Status.DEGENERATE
    assert message.startswith("No vehicle measures -")
    shapes = {number: (0.43 * inside_out, np.zeros((14, 3)))}  # 0.6 m long
    status, message = status_of(state=replace(optimum.state, shapes=shapes))
    assert status is Status.DEGENERATE
    assert message.startswith("No vehicle measures 0.")
    behind = optimum.state.poses[0].matrix()
    behind[:3, 3] *= -1.0
    status, message = status_of(state=replace(optimum.state, poses=[gtsam.Pose3(behind)]))
    assert status is Status.DEGENERATE
    assert "behind the camera" in message


@pytest.mark.parametrize(
    ("behind", "status"), [(0.0, Status.CONVERGED), (0.1, Status.CONVERGED), (0.3, Status.AMBIGUOUS)]
)
def test_directions_that_leave_the_other_facing_open_are_ambiguous(behind, status):
    """The network gives the true side of the car 1 - behind, and the other the rest."""
    prior, pose = load_prior("car14"), yaw_pose(0.6)
    seen = observe(prior, pose)
    bin_ = round(float(view_azimuth(pose[:3, :3], pose[:3, 3])) / (2 * np.pi) * 36) % 36
    directions = np.zeros(36)
    directions[bin_], directions[(bin_ + 18) % 36] = 1.0 - behind, behind
    result = reconstruct(replace(seen, azimuth=directions), CAMERA, ground=1.65)
    assert result.status is status
    assert result.facing_probability == pytest.approx(calibrated_facing(1.0 - behind, *FACING), abs=1e-6)
    assert reconstruct(seen, CAMERA, ground=1.65).facing_probability > 0.95  # by the energies
    assert np.isnan(reconstruct(seen, CAMERA, options=make_options(strategy="paper")).facing_probability)
    back = Reconstruction.from_dict(result.to_dict(compact=True))
    assert back.facing_probability == pytest.approx(result.facing_probability, abs=1e-9)  # digits of small JSON
    if status is Status.AMBIGUOUS:
        assert "for the other facing" in result.message


def test_the_calibration_keeps_the_order_and_is_less_sure():
    probabilities = np.linspace(0.0, 1.0, 101)
    calibrated = [calibrated_facing(p, *FACING) for p in probabilities.tolist()]
    assert (np.diff(calibrated) > 0.0).all()
    assert all(c < p for c, p in zip(calibrated[50:], probabilities[50:], strict=True))
    assert 0.0 < calibrated[0] < calibrated[-1] < 1.0


@pytest.mark.parametrize(
    ("behind", "facing", "status"), [(0.0, 0.9, "converged"), (0.4, 0.9, "ambiguous"), (0.4, 0.97, "converged")]
)
def test_a_facing_over_time_is_sure_or_its_image_alone_says_the_same(behind, facing, status):
    prior, pose = load_prior("car14"), yaw_pose(0.6)
    bin_ = round(float(view_azimuth(pose[:3, :3], pose[:3, 3])) / (2 * np.pi) * 36) % 36
    directions = np.zeros(36)
    directions[bin_], directions[(bin_ + 18) % 36] = 1.0 - behind, behind
    problem, _ = problem_of(0)
    problem = problem.showing(replace(observe(prior, pose), azimuth=directions))
    alone = reconstruct(observe(prior, pose), CAMERA, ground=1.65)
    assert alone.status is Status.CONVERGED
    over_time = replace(alone, uncertainty=replace(alone.uncertainty, facing_probability=facing))
    result = with_facing_over_time(over_time, problem)
    assert result.status == status
    assert ("10 % for the other facing" in result.message) == (status == "ambiguous")
