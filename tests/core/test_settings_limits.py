"""The largest and smallest numbers that settings take still give a result, or a typed error."""

from dataclasses import fields

import numpy as np
import pytest

from fgrecon import (
    BoxErrors,
    BoxOptions,
    DetectorCalibration,
    KeypointOptions,
    MotionModel,
    Options,
    ShapeOptions,
    reconstruct,
)
from fgrecon.core.detector_calibration import BoxSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from tests.cars import CAMERA, observe, yaw_pose

SETTINGS = [
    (kind, entry.name)
    for kind in (BoxErrors, BoxOptions, BoxSource, DetectorCalibration, KeypointOptions, MotionModel, ShapeOptions)
    for entry in fields(kind)
    if "float" in str(entry.type)
]


@pytest.mark.parametrize(("kind", "name"), SETTINGS)
def test_no_setting_is_without_an_upper_limit(kind, name):
    with pytest.raises(InvalidInputError) as error:
        kind(**{name: 1e300})
    assert error.value.field.endswith(f".{name}")


@pytest.mark.parametrize(
    "options",
    [
        {"keypoints": KeypointOptions(sigma_relative=10.0, sigma_pixels=1e5)},
        {"box": BoxOptions(sigma_relative=10.0, sigma_pixels=1e5)},
        {"shape": ShapeOptions(symmetry_sigma=1e3, rectangularity_sigma=1e3)},
    ],
)
def test_the_widest_noise_gives_a_result(options):
    result = reconstruct(observe(load_prior("car14"), yaw_pose(0.5)), CAMERA, options=Options(**options))
    assert not result.status.determined or np.isfinite(result.camera_T_object).all()
