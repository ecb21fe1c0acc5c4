"""Scans that are not where the image shows the vehicles are warned of, by all vehicles together; right ones are not."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from fgrecon import DepthMap, Observation, Points, Tracker, reconstruct, reconstruct_scene, reconstruct_track
from fgrecon.core.depth_map import middle_of
from fgrecon.core.geometry import yaw_rotation
from fgrecon.errors import ContradictoryInputWarning
from tests.solve.test_depth import CAMERA, HOW, street_of

SAID = "The scan is not where the image shows the vehicles"
BESIDE = np.array([1.0, 0.0, 0.0])


@pytest.fixture(name="street", scope="module")
def _street() -> tuple[list[Observation], np.ndarray]:
    """What a network says of three cars, and points (N, 3) of them, the road and a wall."""
    seen, depth = street_of()
    row, column = (each.ravel() for each in np.mgrid[: depth.shape[0] : 2, : depth.shape[1] : 2])
    return seen, CAMERA.rays(np.stack([column, row], axis=1).astype(float)) * depth[row, column, None]


def said(found: list[warnings.WarningMessage]) -> int:
    return sum(SAID in str(one.message) for one in found)


@pytest.mark.parametrize("every", [1, 4, 16])
def test_right_scans_are_the_vehicles_in_the_middle_of_their_boxes(
    street: tuple[list[Observation], np.ndarray], every: int
) -> None:
    seen, points = street
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(points[::every])]).vehicles
    assert said(warned) == 0
    shares = [one.diagnostics.own_shares["points"] for one in found if one.diagnostics.own_shares]
    assert min(shares) > 0.8
    assert len(shares) >= 2


@pytest.mark.parametrize(
    "move",
    [
        lambda points: points - BESIDE,
        lambda points: points - np.array([0.0, 1.0, 0.0]),
        lambda points: points @ yaw_rotation(np.radians(-3.0)).T,
    ],
)
def test_scans_in_a_wrong_place_are_named(street: tuple[list[Observation], np.ndarray], move: Any) -> None:
    seen, points = street
    with pytest.warns(ContradictoryInputWarning, match=SAID):
        found = reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(move(points))]).vehicles
    assert np.median([one.diagnostics.own_shares["points"] for one in found]) < 0.5


def test_a_vehicle_alone_may_be_hidden(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, points = street
    low, high = np.split(middle_of(seen[0].box), 2)
    pixels = CAMERA.project(points)
    behind = ((pixels > low) & (pixels < high)).all(axis=1)
    points = np.where(behind[:, None], points * (9.0 / points[:, 2:]), points)  # a board at 9 m
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = reconstruct_scene(seen, CAMERA, **HOW, evidence=[Points(points)]).vehicles
        reconstruct(seen[0], CAMERA, **HOW, evidence=[Points(points)])
        reconstruct_track([seen[0]] * 3, CAMERA, **HOW, evidence=[[Points(points + 1e-4 * i)] for i in range(3)])
    assert [one.diagnostics.own_shares["points"] > 0.5 for one in found] == [False, True, True]
    assert said(warned) == 0


@pytest.mark.parametrize(("shift", "times"), [(0.0, 0), (-1.0, 1)])
def test_a_tracker_says_it_once(street: tuple[list[Observation], np.ndarray], shift: float, times: int) -> None:
    seen, points = street
    tracker = Tracker(options=HOW["options"])
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        for i in range(4):  # the cars one after the other, which each alone tells nothing
            some = {n: one for n, one in enumerate(seen) if n <= i}
            scan = Points(points + shift * BESIDE)
            tracker.update(0.1 * i, some, camera=CAMERA, ground=HOW["ground"], evidence=[scan])
            assert said(warned) == (times if i else 0)


@pytest.mark.parametrize(("times", "named"), [(1.0, False), (2.0, True), (3.0, True)])
def test_depth_maps_in_another_unit_are_named(
    street: tuple[list[Observation], np.ndarray], times: float, named: bool
) -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        reconstruct_scene(street[0], CAMERA, **HOW, evidence=[DepthMap(times * street_of()[1], relative_sigma=0.01)])
    lines = [str(one.message) for one in warned if "depth map" in str(one.message)]
    assert len(lines) == named, lines
    assert all("metres along the camera's axis" in line for line in lines)


def test_pixels_of_a_depth_map_are_counted_apart(street: tuple[list[Observation], np.ndarray]) -> None:
    seen, points = street
    _, depth = street_of()
    given = [DepthMap(depth, relative_sigma=0.005), Points(points)]
    found = reconstruct_scene(seen, CAMERA, **HOW, evidence=given).vehicles[0]
    assert min(found.diagnostics.own_shares[name] for name in ("points", "depth")) > 0.8
    again = type(found).from_dict(found.to_dict(compact=True))
    assert again.diagnostics.own_shares == pytest.approx(found.diagnostics.own_shares)
    assert "own_shares" not in reconstruct(seen[0], CAMERA, **HOW).to_dict(compact=True)
