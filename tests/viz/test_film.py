"""What is written beside the vehicles of a video and plotted of them. No solver is asked."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.reconstruction import Status
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.video.follow import TrackedFrame
from fgrecon.viz.film import Showing, values_of
from tests.results import changed
from tests.viz.made_up import make_example

EXAMPLE = make_example()
SIZES = np.diag([0.04, 0.0025, 0.01])


def frame(number, **changes):
    """Vehicle 5, a metre further to the right in each frame."""
    pose = EXAMPLE.reconstruction.camera_T_object.copy()
    pose[0, 3] += number
    result = changed(EXAMPLE.reconstruction, camera_T_object=pose, size_covariance=SIZES, **changes)
    estimate = VehicleEstimate(5, 0.1 * number, result, np.array([10.0, 0.0, 0.0]), 0.0, 0.99, pose)
    boxes = {5: EXAMPLE.observation.box}
    return TrackedFrame(number, 0.1 * number, f"{number}", None, np.eye(4), boxes, estimates={5: estimate})


def test_words_have_commas_and_tell_nothing_that_the_table_does():
    words = [Showing(beside_table=beside).vehicles(frame(0))[0].words for beside in (False, True)]
    assert words == [f"{np.linalg.norm(EXAMPLE.reconstruction.location):.0f} m, 36 km/h", "36 km/h"]
    lost = frame(0, status=Status.DEGENERATE)
    assert [Showing(beside_table=beside).vehicles(lost)[0].words for beside in (False, True)] == ["degenerate", ""]


def test_a_speed_that_may_as_well_be_none_is_not_written():
    def words(speed, sigma, status=Status.CONVERGED):
        velocity, covariance = np.array([0.0, 0.0, speed]), np.diag([1e4, 1e4, sigma**2])
        shown = replace(frame(0, status=status).estimates[5], velocity=velocity, velocity_covariance=covariance)
        return Showing(beside_table=True).vehicles(replace(frame(0), estimates={5: shown}))[0].words

    assert words(68.0, 70.0) == ""
    assert words(68.0, 40.0) == ""  # 95 % reach zero
    assert words(68.0, 2.0, Status.AMBIGUOUS) == ""
    assert words(68.0, 2.0) == "245 km/h"
    assert words(0.1, 0.5) == "0 km/h"  # it stands


def test_places_that_are_not_known_are_no_part_of_a_path():
    showing = Showing()
    trails = [
        showing.vehicles(frame(n, status=Status.DEGENERATE if n == 1 else Status.WEAK))[0].trail for n in range(3)
    ]
    assert [len(trail) for trail in trails] == [1, 1, 2]
    np.testing.assert_allclose(trails[2][1] - trails[2][0], [2.0, 0.0, 0.0])


def test_sizes_and_yaw_are_plotted_with_their_bands():
    values = Showing().frame(frame(0), None).values[5]
    for name, value, sigma in zip(
        ("length", "width", "height"), EXAMPLE.reconstruction.box_size, (0.2, 0.05, 0.1), strict=True
    ):
        assert values[name] == pytest.approx((value, value - 1.96 * sigma, value + 1.96 * sigma))
    assert values["yaw"][1] <= values["yaw"][0] <= values["yaw"][2]
    assert values["speed"][0] == 10.0
    assert np.isnan(values["speed"][1:]).all()
    moving = replace(frame(0).estimates[5], velocity_covariance=np.diag([0.04, 9.0, 9.0]))
    assert values_of(moving)["speed"] == pytest.approx((10.0, 10.0 - 1.96 * 0.2, 10.0 + 1.96 * 0.2))
    unknown = Showing().frame(frame(0, pose_covariance=None), None).values[5]["yaw"]
    assert unknown[0] == values["yaw"][0]
    assert np.isnan(unknown[1:]).all()
    assert Showing().frame(frame(0, status=Status.DEGENERATE), None).values == {5: {}}
