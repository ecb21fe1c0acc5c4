"""Many simulated vehicles, worse networks, and the fit of the noise model to real tracks."""

from __future__ import annotations

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.simulation.keypoint_noise import HOURGLASS, OUTLIER
from fgrecon.simulation.vehicles import Vehicle, yaw_pose
from fgrecon_research.paper.keypoint_noise_fit import fit_noise_model, read_vehicle
from fgrecon_research.simulation import HARD, harder, simulate_many
from tests.simulation.test_simulate import POSE, PRIOR, draw, errors


def test_harder_is_worse():
    assert harder(HOURGLASS, 0.0) == HOURGLASS
    shares = []
    for noise in (HOURGLASS, harder(HOURGLASS, 0.5), HARD):
        observations, truths = draw(noise, 200)
        trusted = np.array([o.confidence for o in observations]) > 0.3
        shares.append((errors(observations, truths) > OUTLIER)[trusted].mean())
    assert shares[0] < shares[1] < shares[2]
    with pytest.raises(InvalidInputError, match="severity"):
        harder(HOURGLASS, -1.0)


@pytest.mark.data
def test_the_constants_are_what_the_fit_gives(data):
    paths = sorted((data / "kitti_tracking_keypoints14").glob("*.json"))
    fitted = fit_noise_model([read_vehicle(path, PRIOR.category) for path in paths], PRIOR)
    for name in ("found_visible", "found_hidden", "sigma_visible", "sigma_hidden", "confident_lost"):
        assert getattr(fitted, name) == pytest.approx(getattr(HOURGLASS, name), rel=0.02)
    for name in ("lost_to", "confidence_visible", "confidence_hidden", "confidence_lost"):
        assert getattr(fitted, name) == pytest.approx(getattr(HOURGLASS, name), rel=0.05, abs=0.01)


def test_many_draws_shapes_and_poses():
    rng = np.random.default_rng(0)
    vehicles = [Vehicle.sample(PRIOR, rng) for _ in range(3)]
    poses = np.array([POSE, yaw_pose(0.0, np.array([500.0, 1.65, 20.0]))])  # the second is outside the image
    drawn = simulate_many(vehicles, 30, rng, poses=poses)
    assert len(drawn) == 30
    assert {id(t.vehicle) for _, t in drawn} == {id(v) for v in vehicles}
    assert all((t.camera_T_object == POSE).all() for _, t in drawn)
    with pytest.raises(InvalidInputError, match="poses"):
        simulate_many(vehicles, 1, rng, poses=poses[1:])
    sampled = simulate_many(PRIOR, 5, np.random.default_rng(1))
    assert len({t.camera_T_object[2, 3] for _, t in sampled}) == 5
