"""Constant errors of sensors over time: simulated offsets, and the graph's minimum by a grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgrecon import DepthMap, Observation, Points, Tracker
from fgrecon.errors import InvalidInputError
from fgrecon.solve.sensor_filter import ErrorEstimate, SensorFilter, SharedError
from fgrecon.solve.solve_settings import SENSOR_FILTER
from tests.solve.test_depth import CAMERA, OPTIONS, PLACES, street_of

MAP = DepthMap(np.full((4, 5), 9.0), relative_sigma=0.01, shared_sigma=0.005, sensor="rig")


def estimates(means: np.ndarray, sigma: float, time: float = 0.0, first: int = 0) -> dict[int, ErrorEstimate]:
    return {first + i: ErrorEstimate(float(mean), sigma**2, time) for i, mean in enumerate(means)}


def test_the_belief_is_the_minimum_of_prior_and_robust_vehicles() -> None:
    means = np.array([0.003, 0.0045, 0.004, 0.0035, 0.03])  # the last one is no car
    known = SharedError(0.0, 0.005, estimates(means, 0.002))
    grid = np.linspace(-0.01, 0.01, 200_001)
    k = SENSOR_FILTER.loss_sigmas
    off = ((means[:, None] - grid) / 0.002) ** 2
    energy = 0.5 * (grid / 0.005) ** 2 + 0.5 * k**2 * np.log1p(off / k**2).sum(axis=0)
    assert known.at(0.0)[0] == pytest.approx(grid[energy.argmin()], abs=1e-6)


@pytest.mark.parametrize("offset", [-0.006, 0.0, 0.004])
def test_it_comes_to_the_offset_and_is_as_sure_as_right(offset: float) -> None:
    """A hundred rigs that see so many vehicles, of which each tenth is of another kind."""
    rng, found = np.random.default_rng(0), []
    for count in (0, 5, 40):
        normalised = []
        for _ in range(100):
            means = offset + 0.006 * rng.normal(size=count) + 0.05 * (rng.random(count) < 0.1)
            mean, sigma = SharedError(0.0, 0.005, estimates(means, 0.006)).at(0.0)
            normalised.append((mean - offset) / sigma)
        found.append((sigma, np.sqrt(np.square(normalised).mean())))
    sigmas, errors = zip(*found, strict=True)
    assert 0.005 == sigmas[0] > sigmas[1] > sigmas[2] > SENSOR_FILTER.least_share * 0.005
    assert max(errors[1:]) < 1.35


def test_a_vehicle_speaks_once() -> None:
    once = SharedError(0.0, 0.005, estimates(np.array([0.004]), 0.003))
    often = once
    for time in (0.1, 0.2):
        often = often.updated(0, ErrorEstimate(0.0041, 0.0031**2, time))
    assert often.at(0.0) == once.at(0.0)
    surer = often.updated(0, ErrorEstimate(0.002, 0.001**2, 0.3))
    assert surer.at(0.3) == SharedError(0.0, 0.005, estimates(np.array([0.002]), 0.001, 0.3)).at(0.3)


def test_it_drifts_and_a_sensor_that_was_moved_is_learnt_anew() -> None:
    before = SharedError(0.0, 0.005, estimates(np.full(60, 0.004), 0.004))
    mean, sigma = before.at(0.0)
    later = [before.at(time) for time in (60.0, 600.0, 60_000.0)]
    assert mean == pytest.approx(0.004, rel=0.1)
    assert mean > later[0][0] > later[1][0] > later[2][0] > 0.0
    assert sigma < later[0][1] < later[1][1] <= later[2][1] <= 0.005
    assert later[2][0] < 0.5 * mean
    moved = before
    for i in range(SENSOR_FILTER.most_vehicles):
        moved = moved.updated(100 + i, ErrorEstimate(-0.004, 0.004**2, 10.0))
    assert len(moved.vehicles) == SENSOR_FILTER.most_vehicles
    assert moved.at(10.0)[0] == pytest.approx(-mean, rel=0.1)


def test_sensors_are_known_apart() -> None:
    known = SensorFilter({"rig": SharedError(0.0, 0.005, estimates(np.full(9, 0.004), 0.002))})
    scan = Points(np.ones((3, 3)))
    others = [replace(MAP, sensor="other"), replace(MAP, sensor=""), replace(MAP, shared_sigma=0.0), scan]
    learnt, *rest = known.applied([MAP, *others], 0.0)
    assert isinstance(learnt, DepthMap)
    assert learnt.shared_mean == pytest.approx(0.004, rel=0.1)
    assert learnt.shared_sigma < 0.005
    assert all(a is b for a, b in zip(rest, others, strict=True))


STREETS = 8


@pytest.fixture(name="streets", scope="module")
def _streets() -> list[tuple[list[Observation], np.ndarray]]:
    """Three new cars each, whose sizes are as the prior's."""
    return [street_of(np.random.default_rng(number).normal(size=(3, 5)), number) for number in range(STREETS)]


def follow(streets: list[tuple[list[Observation], np.ndarray]], sensor: str) -> tuple[Tracker, list[float]]:
    """A tracker after the streets, by depth maps with an offset, and how far off the cars of each were."""
    tracker, off = Tracker(options=OPTIONS), []
    for number, (seen, depth) in enumerate(streets):
        one = DepthMap(1.0 / (1.0 / depth - 0.005), relative_sigma=0.02, shared_sigma=0.005, sensor=sensor)
        found = tracker.update(
            0.5 * number,
            {3 * number + i: car for i, car in enumerate(seen)},
            camera=CAMERA,
            ground=1.65,
            evidence=[one],
        )
        places = [one.reconstruction.location for one in found.values()]
        off.append(float(np.mean([min(np.linalg.norm(place - one) for one in PLACES) for place in places])))
    return tracker, off


def test_a_tracker_learns_the_offset_of_a_rig(streets: list[tuple[list[Observation], np.ndarray]]) -> None:
    tracker, off = follow(streets, "rig")
    (known,) = tracker._sensors.known.values()
    assert len(known.vehicles) == 3 * STREETS
    mean, sigma = known.at(0.5 * STREETS)
    assert sigma < 0.8 * 0.005
    assert abs(mean - 0.005) < 2.0 * sigma
    other, alone = follow(streets, "")
    assert not other._sensors.known
    assert np.mean(off[STREETS // 2 :]) < 0.9 * np.mean(alone[STREETS // 2 :])
    before = tracker._sensors
    with pytest.raises(InvalidInputError, match="time"):
        tracker.update(0.0, {}, camera=CAMERA)
    assert tracker._sensors is before
