"""A car with noisy keypoints, and `reconstruct` on an observation's arrays."""

import pytest

from fgrecon.io.catalogue import load_prior
from fgrecon.solve.pipeline import reconstruct
from tests.cars import CAMERA, observe, yaw_pose


@pytest.fixture(scope="module")
def prior():
    return load_prior("car14")


@pytest.fixture(scope="module")
def seen(prior):
    """A car with 2 px of noise and its true pose."""
    truth = yaw_pose(0.7)
    return observe(prior, truth, [0.4, -0.8, 0.2, 0.5, -0.3], noise=2.0), truth


def solve(observation, intrinsics=CAMERA, **more):
    arguments = {"confidence": observation.confidence, "box": observation.box, **more}
    return reconstruct(observation.keypoints, intrinsics, **arguments)
