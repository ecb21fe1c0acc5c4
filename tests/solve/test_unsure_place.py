"""A LiDAR whose place is wrong: the vehicles of an image tell by how much, and where it is known nothing changes."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgrecon import Observation, Points, reconstruct, reconstruct_scene
from fgrecon.errors import InvalidInputError
from tests.solve.test_depth import CAMERA, HOW, PLACES, street_of

ERROR = np.array([0.0, np.radians(1.6), np.radians(-0.8), 0.0, 0.0, 0.0])
PLACE = (0.02, 0.02)


@pytest.fixture(name="scene", scope="module")
def _scene() -> tuple[list[Observation], np.ndarray]:
    """What a network says of three cars, and points (N, 3) of them and the road by a sensor that is turned."""
    seen, depth = street_of()
    row, column = (each.ravel() for each in np.mgrid[: depth.shape[0] : 2, : depth.shape[1] : 2])
    points = CAMERA.rays(np.stack([column, row], axis=1).astype(float)) * depth[row, column, None]
    wrong = gtsam.Pose3.Expmap(ERROR).inverse().matrix()
    return seen, points @ wrong[:3, :3].T + wrong[:3, 3]


def _moved(points: np.ndarray) -> np.ndarray:
    """The points where they are."""
    error = gtsam.Pose3.Expmap(ERROR).matrix()
    return np.asarray(points @ error[:3, :3].T + error[:3, 3])


def off(vehicles: object) -> float:
    pairs = zip(vehicles, PLACES, strict=True)  # type: ignore[call-overload]
    return float(np.mean([np.linalg.norm(one.location - place) for one, place in pairs]))


def test_vehicles_tell_how_a_sensor_is_turned(scene: tuple[list[Observation], np.ndarray]) -> None:
    seen, points = scene
    believed = reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(points)])
    estimated = reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(points, place_sigma=PLACE)])
    least = off(reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(_moved(points))]).vehicles)
    assert off(estimated.vehicles) - least < 0.5 * (off(believed.vehicles) - least)
    found = estimated.vehicles[0].diagnostics
    sigma = np.sqrt(np.diag(found.place_covariances[0]))
    assert (sigma[:2] < 0.5 * PLACE[0]).all()
    assert (np.abs(found.place_errors[0] - ERROR)[:3] < 3.0 * sigma[:3]).all()
    assert np.abs(found.place_errors[0] - ERROR)[1] < 0.4 * abs(ERROR[1])
    for one in estimated.vehicles:
        assert one.diagnostics.place_errors == pytest.approx(found.place_errors), "one sensor of one image"
    assert len(believed.vehicles[0].diagnostics.place_errors) == 0


def test_one_vehicle_is_less_sure_by_it(scene: tuple[list[Observation], np.ndarray]) -> None:
    (one, *_), wrong = scene
    points = _moved(wrong)
    sure, unsure = (
        reconstruct(one, CAMERA, **HOW, evidence=[Points(points, place_sigma=place)]) for place in ((0.0, 0.0), PLACE)
    )
    first, other = (np.trace(found.uncertainty.pose_covariance[3:, 3:]) for found in (sure, unsure))
    assert other > first
    assert "sensor_place" in unsure.diagnostics.energies
    again = type(unsure).from_dict(unsure.to_dict())
    assert again.diagnostics.place_errors == pytest.approx(unsure.diagnostics.place_errors)


@pytest.mark.parametrize("place", [(-0.1, 0.0), (1.0, 0.0), (0.1, 5.0), (0.1,), ("a", "b")])
def test_a_place_that_is_none_is_refused(place: tuple[float, ...]) -> None:
    with pytest.raises(InvalidInputError, match="place_sigma"):
        Points(np.zeros((1, 3)), place_sigma=place)  # type: ignore[arg-type]
