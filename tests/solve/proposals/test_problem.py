"""From an observation to noise models, probabilities and terms."""

import numpy as np
import pytest

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.geometry import box_around, transform
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, BoxOptions, KeypointOptions, Options
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.proposals.problem import Problem, box_term, keypoint_covariances
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.vehicle.model import prepare
from tests.cars import CAMERA, MATRIX, observe, yaw_pose

OPTIONS = Options()


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


@pytest.fixture(scope="module")
def seen(prior):
    return observe(prior, yaw_pose(0.6))


def build(prior, observation, *, ground=None, size=None, options=OPTIONS, camera=CAMERA):
    return Problem.of(observation, camera, prepare(prior, size), ground, options).energy


def test_noise_scales_with_the_box(seen):
    options = Options(keypoints=KeypointOptions(sigma_relative=0.04, sigma_pixels=1.5))
    covariance = keypoint_covariances(seen, options.keypoints)
    assert covariance.shape == (14, 2, 2)
    extent = max(seen.box[2] - seen.box[0], seen.box[3] - seen.box[1])
    np.testing.assert_allclose(covariance[3], ((0.04 * extent) ** 2 + 1.5**2) * np.eye(2))


def test_a_detectors_covariance_gets_the_rest_added(seen):
    own = np.array([[[25.0, 5.0], [5.0, 16.0]]] * 14)
    observation = Observation(seen.keypoints, seen.confidence, seen.box, own)
    added = keypoint_covariances(observation, OPTIONS.keypoints) - own
    expected = 0.1 * (OPTIONS.keypoints.sigma_relative * observation.extent) ** 2 + OPTIONS.keypoints.sigma_pixels**2
    np.testing.assert_allclose(added, np.broadcast_to(expected * np.eye(2), (14, 2, 2)))


def test_whitened_residuals_are_mahalanobis_distances(prior, seen):
    rng = np.random.default_rng(0)
    own = np.array([[25.0, 5.0], [5.0, 16.0]]) * rng.uniform(0.5, 3, (14, 1, 1))
    term = build(prior, Observation(seen.keypoints, seen.confidence, seen.box, own)).keypoints
    covariance = keypoint_covariances(Observation(seen.keypoints, seen.confidence, seen.box, own), OPTIONS.keypoints)
    d = rng.normal(size=(14, 2)) * 5
    whitened = term.rows.whiten(d[..., None])[..., 0]
    expected = [x @ np.linalg.inv(S) @ x for x, S in zip(d, covariance, strict=True)]
    np.testing.assert_allclose(np.square(whitened).sum(axis=1), expected)


def test_probability_of_being_right(prior, seen):
    confidence = np.linspace(0.0, 1.0, 14)
    pixels = seen.keypoints.copy()
    pixels[3] = np.nan
    observation = Observation(pixels, confidence, seen.box, confidence_midpoint=0.3)
    evidence = build(prior, observation).keypoints.evidence
    expected = np.clip(confidence**2 / (confidence**2 + 0.3**2), 0.01, 0.99)
    expected[3] = 0.0
    np.testing.assert_allclose(evidence.right, expected)
    assert (np.diff(np.delete(evidence.right, 3)) >= 0).all()
    np.testing.assert_array_equal(evidence.measured, np.arange(14) != 3)
    half = build(
        prior, Observation(pixels, np.full(14, 0.3), seen.box, confidence_midpoint=0.3)
    ).keypoints.evidence.right
    np.testing.assert_allclose(half[0], 0.5)


def test_density_of_wrong_points(prior, seen):
    evidence = build(prior, seen).keypoints.evidence
    sigma2 = keypoint_covariances(seen, OPTIONS.keypoints)[0, 0, 0]
    width, height = seen.box[2:] - seen.box[:2]
    np.testing.assert_allclose(evidence.outlier, 2 * np.pi * sigma2 / (width * height))
    vague = build(prior, seen, options=Options(keypoints=KeypointOptions(sigma_relative=3.0))).keypoints.evidence
    assert (vague.outlier == 0.5).all()  # never likelier than a right point


def test_unmeasured_pixels_are_finite(prior, seen):
    pixels = seen.keypoints.copy()
    pixels[5] = np.nan
    assert np.isfinite(build(prior, Observation(pixels, seen.confidence, seen.box)).keypoints.rows.pixels).all()


def test_terms_that_apply(prior, seen):
    size, ground = SIZE_PRIORS["kitti"], Ground.level(1.65)
    everything = build(prior, seen, ground=ground, size=size)
    assert everything.box is not None
    assert everything.size is not None
    assert everything.ground is not None
    assert everything.size.prior is size
    nothing = build(prior, Observation(seen.keypoints, seen.confidence))
    assert (nothing.box, nothing.size, nothing.ground) == (None, None, None)
    off = Options(disabled_terms={"box", "dimensions", "ground"})
    ablated = build(prior, seen, ground=ground, size=size, options=off)
    assert (ablated.box, ablated.size, ablated.ground) == (None, None, None)


def test_box_models(prior, seen):
    model = prepare(prior)
    assert box_term(seen, CAMERA, model, BoxOptions(BoxModel.OFF)) is None
    assert len(box_term(seen, CAMERA, model, BoxOptions(BoxModel.CUBOID)).mean) == 8
    term = box_term(seen, CAMERA, model, OPTIONS.box)
    assert len(term.mean) == len(model.outline.mean)
    assert term.rows.used.all()
    assert term.rows.sigma == pytest.approx(np.hypot(0.02 * seen.extent, 1.5))


def test_an_outline_as_the_detector_draws_it_reaches_further_than_it_is(prior, seen):
    model = prepare(prior)
    exact = box_term(seen, CAMERA, model, BoxOptions(BoxModel.SURFACE))
    drawn = box_term(seen, CAMERA, model, BoxOptions(BoxModel.DETECTED))
    np.testing.assert_array_equal(drawn.mean, exact.mean)
    width, height = seen.box[2:] - seen.box[:2]
    left, top, right, bottom = drawn.rows.edges - exact.rows.edges
    assert left == pytest.approx(-right) == pytest.approx(0.034 * width)
    assert (top, bottom) == (pytest.approx(-0.014 * height), pytest.approx(-0.01 * height))
    np.testing.assert_array_equal(drawn.rows.used, exact.rows.used)


@pytest.mark.parametrize(
    ("box", "used"),
    [
        ([0.0, 100.0, 300.0, 300.0], [False, True, True, True]),
        ([10.0, 1.0, 300.0, 374.0], [True, False, True, False]),
        ([10.0, 100.0, 1241.0, 300.0], [True, True, False, True]),
        ([10.0, 100.0, 1230.0, 360.0], [True, True, True, True]),
    ],
)
def test_edges_on_the_images_border_say_nothing(prior, seen, box, used):
    camera = Camera(MATRIX, image_size=(1242, 375))
    observation = Observation(seen.keypoints, seen.confidence, box)
    assert build(prior, observation, camera=camera).box.rows.used.tolist() == used
    assert build(prior, observation).box.rows.used.all()  # of an unknown size nothing is known


@pytest.mark.parametrize("model", [BoxModel.SURFACE, BoxModel.CUBOID])
def test_exact_boxes_of_shapes_from_all_round_are_met_in_the_mean(prior, model):
    """Soft extents lie inside hard ones by 0.4 standard deviations: made up for, or cars would be 1.5 % too near."""
    rng, car, camera = np.random.default_rng(2), prepare(prior, SIZE_PRIORS["kitti"]), Camera(MATRIX)
    off = []
    for azimuth in np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False):
        shape = rng.normal(size=car.prior.dimension)
        pose = yaw_pose(azimuth, (rng.uniform(-4.0, 4.0), 1.65, rng.uniform(8.0, 40.0)))
        points = car.prior.surface.vertices(shape) if model is BoxModel.SURFACE else car.corners.at(shape)
        box = box_around(camera.project(transform(pose, points)))
        observed = Observation(camera.project(transform(pose, car.prior.keypoints(shape))), np.ones(14), box)
        term = box_term(observed, camera, car, BoxOptions(model=model))
        h = Hypotheses(pose[None, :3, :3], pose[None, :3, 3], shape[None])
        off.append(term.residuals(h)[0])
    assert (np.abs(np.mean(off, axis=0)) < 0.1).all()
    assert (np.std(off, axis=0) < 0.15).all()


def test_one_place_is_degenerate(prior):
    with pytest.raises(DegenerateProblemError) as caught:
        build(prior, Observation(np.full((14, 2), 7.0), np.ones(14)))
    assert caught.value.field == "keypoints"


@pytest.mark.parametrize("model", [*BoxModel])
@pytest.mark.parametrize("size", [None, SIZE_PRIORS["kitti"]])
def test_another_vehicle_shares_what_is_about_the_image(prior, seen, model, size):
    options, ground = Options(box=BoxOptions(model=model)), Ground.level(1.65)
    car, other = prepare(prior, SIZE_PRIORS["apollo79"]), prepare(prior, size)
    found = Problem.of(seen, CAMERA, car, ground, options).as_vehicle(other)
    expected = Problem.of(seen, CAMERA, other, ground, options)
    assert found.model is other
    h = Hypotheses.at_poses(yaw_pose(0.5)[None], prior.dimension)
    ours, theirs = found.energy.energies(h), expected.energy.energies(h)
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)
