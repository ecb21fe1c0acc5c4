"""Regions of a detector whose errors go together."""

from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.io.catalogue import load_prior
from tests.cars import CAMERA, observe, yaw_pose


def test_errors_that_go_together_widen_the_region_and_move_nothing():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    detected = replace(given, covariance=np.tile(4.0 * np.eye(2), (14, 1, 1)))
    narrow, wide = (
        fgrecon.reconstruct(detected, CAMERA, options=Options(keypoints=KeypointOptions(common_factor=factor)))
        for factor in (1.0, 4.0)
    )
    np.testing.assert_array_equal(narrow.camera_T_object, wide.camera_T_object)
    np.testing.assert_array_equal(narrow.weights, wide.weights)
    grown = np.diag(wide.pose_covariance) / np.diag(narrow.pose_covariance)
    assert ((grown > 1.0) & (grown <= 4.0 + 1e-6)).all()  # size and shape have a prior, which says as much as before
    assert grown[1] > 2.0  # yaw is by keypoints and box alone
    assert np.trace(wide.coefficients_covariance) > np.trace(narrow.coefficients_covariance)


def test_the_default_is_for_detectors_that_give_covariances():
    given = observe(load_prior("car14"), yaw_pose(0.6), noise=0.5)
    apart = Options(keypoints=KeypointOptions(common_factor=1.0))
    plain, asked = fgrecon.reconstruct(given, CAMERA), fgrecon.reconstruct(given, CAMERA, options=apart)
    np.testing.assert_array_equal(plain.pose_covariance, asked.pose_covariance)
    scene = fgrecon.reconstruct_scene([given, given], CAMERA, ground=1.65, options=apart)
    np.testing.assert_array_equal(
        scene.vehicles[0].pose_covariance,
        fgrecon.reconstruct_scene([given, given], CAMERA, ground=1.65).vehicles[0].pose_covariance,
    )
    with pytest.raises(InvalidInputError, match="common_factor"):
        KeypointOptions(common_factor=0.5)
