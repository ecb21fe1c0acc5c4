"""What only the factor graph can find: end to end, results that the pose search alone does not give."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Status
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.pipeline import reconstruct
from tests.cars import CAMERA, observe, project, rotation_angle, yaw_pose
from tests.settings import options as make_options

COEFFICIENTS = np.array([0.9, -0.8, 0.6, 0.5, -0.4])
QUIET = {"keep_history": False}
SHARP = {"sigma_relative": 0.003, "sigma_pixels": 0.1, "box_model": "off"}


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


def pose_of(degrees):
    return yaw_pose(np.radians(degrees))


@pytest.mark.parametrize("degrees", [25, 140, -70])
def test_the_shape_that_algorithm_1_leaves_out_is_found(prior, degrees):
    """The paper's search keeps the mean shape: every coefficient comes from the graph."""
    truth = pose_of(degrees)
    seen = observe(prior, truth, COEFFICIENTS, box=False)
    seen = replace(seen, confidence=np.full(14, 0.9))
    result = reconstruct(seen, CAMERA, options=make_options(strategy="paper", free_offsets=False, **SHARP, **QUIET))
    np.testing.assert_allclose(result.shape.coefficients, COEFFICIENTS, atol=0.25)
    assert np.linalg.norm(result.wireframe - prior.keypoints(COEFFICIENTS), axis=1).max() < 0.03
    assert np.degrees(rotation_angle(result.camera_T_object, truth)) < 0.5
    assert np.linalg.norm(result.location - truth[:3, 3]) < 0.1


@pytest.mark.parametrize("degrees", [40, -130])
def test_a_keypoint_off_the_subspace_is_found(prior, degrees):
    """Free offsets are the graph's alone: a lamp 20 cm further forward than any car of the prior has it."""
    truth, shape = pose_of(degrees), prior.keypoints(COEFFICIENTS)
    lamp = 4 if degrees > 0 else 6
    shape[lamp, 0] += 0.2 if degrees > 0 else -0.2
    loose = replace(prior, offset_sigma=np.full(14, 0.1))
    seen = replace(observe(prior, truth, COEFFICIENTS, box=False), keypoints=project(shape, truth))
    seen = replace(seen, confidence=np.full(14, 0.9))
    off = {"planarity", "rectangularity", "symmetry", "laplacian"}
    settings = {"strategy": "cauchy", **SHARP, **QUIET, "disabled_terms": off, "search": {"basis_vectors": 5}}
    bound, free = (
        reconstruct(seen, CAMERA, prior=loose, options=make_options(free_offsets=free, **settings))
        for free in (False, True)
    )
    assert (bound.shape.offsets == 0).all()
    away = [np.abs(result.pose.wireframe_uv[lamp] - seen.keypoints[lamp]).max() for result in (bound, free)]
    assert away[0] > 3.0
    assert away[1] < 0.5
    assert np.linalg.norm(free.shape.offsets[lamp]) > 0.08
    assert np.linalg.norm(free.shape.offsets, axis=1).argmax() == lamp


def test_offsets_stay_near_zero_where_their_prior_says_so(prior):
    """The same car with keypoints whose places the prior knows to a millimetre: hardly an offset is taken."""
    truth = pose_of(40)
    seen = observe(prior, truth, COEFFICIENTS, noise=4.0)
    tight, loose = (
        reconstruct(
            seen,
            CAMERA,
            prior=replace(prior, offset_sigma=np.full(14, sigma)),
            options=make_options(free_offsets=True, **QUIET),
        )
        for sigma in (1e-3, 0.2)
    )
    assert 0 < np.abs(tight.shape.offsets).max() < 1e-3
    assert np.abs(loose.shape.offsets).max() > 0.01


@pytest.mark.parametrize("seed", [0, 1])
def test_the_laplacian_pulls_to_the_means_form(prior, seed):
    """It is a term of the graph alone; the tighter, the nearer the mean every keypoint lies among its neighbours."""
    seen = observe(prior, pose_of(50), COEFFICIENTS, noise=1.0, seed=seed)
    away = []
    for sigma in (10.0, 0.05, 0.005):
        result = reconstruct(
            seen, CAMERA, options=make_options(laplacian_sigma=sigma, disabled_terms=(), free_offsets=False, **QUIET)
        )
        away.append(np.abs(result.wireframe - prior.mean).max())
    assert away[0] > 1.3 * away[1] > 1.3 * 1.3 * away[2]
    assert away[2] < 0.05


def test_symmetry_is_restored(prior):
    """A prior whose left and right differ by noise: the graph's symmetry term makes the result nearly symmetric."""
    rng = np.random.default_rng(0)
    skewed = replace(
        prior, mean=prior.mean + rng.normal(0.0, 0.03, (14, 3)), offset_sigma=np.full(14, 0.05), surface=None
    )
    seen = observe(prior, pose_of(30))
    gaps = []
    for disabled in ({"symmetry"}, set()):
        options = make_options(free_offsets=True, disabled_terms=disabled, symmetry_sigma=0.005, **QUIET)
        shape = reconstruct(seen, CAMERA, prior=skewed, options=options).wireframe
        gaps.append(np.abs(shape[prior.category.mirror] * [1, 1, -1] - shape).max())
    assert gaps[0] > 0.05
    assert gaps[1] < 0.5 * gaps[0]


def test_the_joint_stage_moves_the_pose(prior):
    """Without it the pose stays where the search has put it, with it the keypoints are met better."""
    truth = pose_of(65)
    seen = replace(observe(prior, truth, COEFFICIENTS, box=False), confidence=np.full(14, 0.9))
    fixed, joint = (
        reconstruct(seen, CAMERA, options=make_options(strategy="paper", joint=joint, free_offsets=False, **SHARP))
        for joint in (False, True)
    )
    searched = [step for step in fixed.diagnostics.history if step.stage == "pose"][-1]
    np.testing.assert_allclose(fixed.camera_T_object, searched.camera_T_object, atol=1e-12)
    errors = [np.linalg.norm(r.camera_T_object[:3, 3] - truth[:3, 3]) for r in (fixed, joint)]
    assert errors[1] < 0.5 * errors[0]
    away = [np.abs(r.pose.wireframe_uv - seen.keypoints).max() for r in (fixed, joint)]
    assert away[1] < 0.5 * away[0]


EXPECTED = {
    -140: (-139.9969, [1.3281, 1.4738, 10.6904], [3.8496, 1.6429, 1.5777], 8.0844, 27.4108),
    20: (19.5985, [1.3286, 1.4808, 10.67], [3.8686, 1.6336, 1.5726], 7.0448, 30.0522),
    95: (94.4811, [1.3293, 1.463, 10.8113], [3.8825, 1.6252, 1.563], 6.0730, 40.0271),
}
"""By direction: rotation_y in degrees, location and box size in metres, sum of the weights, of the energies in nats."""


@pytest.mark.parametrize("degrees", EXPECTED)
def test_the_numbers_of_the_default_settings(prior, degrees):
    """Noisy cars as they came out when this was written: a change of any default shows here first."""
    seen = observe(prior, pose_of(degrees), COEFFICIENTS, noise=3.0, seed=degrees % 7)
    result = reconstruct(seen, CAMERA, ground=1.65, size_prior="kitti", options=Options(**QUIET))
    assert result.status is Status.CONVERGED
    turn, location, size, weights, energy = EXPECTED[degrees]
    assert np.degrees(result.rotation_y) == pytest.approx(turn, abs=1e-3)
    np.testing.assert_allclose(result.location, location, atol=1e-3)
    np.testing.assert_allclose(result.box_size, size, atol=1e-3)
    assert result.diagnostics.weights.sum() == pytest.approx(weights, abs=1e-3)
    assert sum(result.diagnostics.energies.values()) == pytest.approx(energy, abs=1e-3)
