"""Algorithm 1 with the global solver first and last against the global solver every time, on random cars.

Run from the repository root, on one core:
    OMP_NUM_THREADS=1 python -m benchmarks.bench_irls [--problems 10000] [--seed 0]
Prints how often the short way ends with a larger cost, by how much, and what both take.

"Cost" is the weighted squared reprojection error that the last pose minimises, each with its own last weights, so the
two are not quite one function; so the angle between the two last poses and their errors against the truth stand beside.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import FgreconError
from fgrecon.core.options import Options
from fgrecon.core.robust import StrategyName, strategy
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, kitti_like_pose, simulate
from fgrecon.solve.proposals.irls import Algorithm1Result, algorithm1
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.vehicle.model import prepare
from tests.solve.proposals.problems import aspnp_cost

WORSE = 1e-6  # relative: below, both have found the same minimum


def turn(a: Array, b: Array) -> float:
    """Angle between two poses' rotations, degrees."""
    chord = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(8.0)
    return float(np.degrees(2.0 * np.arcsin(min(chord, 1.0))))


def compare(count: int, seed: int) -> None:
    """Print the comparison on `count` simulated observations."""
    rng = np.random.default_rng(seed)
    prior = load_prior("car14")
    model, options = prepare(prior), Options(strategy=strategy(StrategyName.PAPER))
    rows: list[tuple[float, float, float, float, float]] = []
    clocks = np.zeros(2)
    refused = [0, 0]
    while len(rows) + max(refused) < count:
        pose = kitti_like_pose(rng)
        try:
            observation, _ = simulate(Vehicle.sample(prior, rng), KITTI_CAMERA, pose, rng)
        except FgreconError:
            continue  # outside the image
        problem = Problem.of(observation, KITTI_CAMERA, model, None, options)
        used = observation.measured
        rays = KITTI_CAMERA.rays(observation.keypoints[used])[:, :2]
        results: list[Algorithm1Result | None] = []
        for i, every in enumerate((False, True)):
            start = time.process_time()
            try:
                results.append(algorithm1(problem, every_solve_global=every))
            except FgreconError:
                results.append(None)
                refused[i] += 1
            clocks[i] += time.process_time() - start
        warm, cold = results
        if warm is None or cold is None:
            continue
        costs = [
            aspnp_cost(prior.mean[used], rays, r.weights[-1][used], r.poses[-1]) / r.weights[-1].sum()
            for r in (warm, cold)
        ]
        own = [aspnp_cost(prior.mean[used], rays, cold.weights[-1][used], r.poses[-1]) for r in (warm, cold)]
        errors = [turn(r.poses[-1], pose) for r in (warm, cold)]
        rows.append((costs[0] / costs[1], own[0] / own[1], turn(warm.poses[-1], cold.poses[-1]), *errors))
    table = np.array(rows)
    ratio, same_weights, between, warm_error, cold_error = table.T
    print(f"{len(table)} simulated cars, 14 keypoints, 5 updates; refused: {refused[0]} short, {refused[1]} global")
    worse = ratio > 1.0 + WORSE
    print(f"  final weighted cost larger than that of solving globally each time: {worse.mean():.2%} of the cars")
    if worse.any():
        print(f"    there by (median, 95th percentile, largest): {percent(ratio[worse] - 1.0)}")
    same = np.abs(ratio - 1.0) <= WORSE
    print(f"  smaller on {(ratio < 1.0 - WORSE).mean():.2%}, the same to {WORSE:g} on {same.mean():.2%}")
    print(f"  with the weights of the global way: larger by over 1 % on {(same_weights > 1.01).mean():.2%}")
    far = between > 1.0
    print(f"  poses more than 1 degree apart: {far.mean():.2%}, more than 10 degrees: {(between > 10).mean():.2%}")
    if far.any():
        closer = (warm_error < cold_error)[far].mean()
        print(f"    of those over 1 degree the short way is closer to the truth on {closer:.0%}")
    for name, error in (("global first and last", warm_error), ("global every time", cold_error)):
        print(f"  {name:22s} rotation error: median {np.median(error):.3f}, mean {error.mean():.3f} degrees")
    milliseconds = 1e3 * clocks / max(len(table), 1)
    print(f"  CPU time a car: {milliseconds[0]:.2f} ms, global every time {milliseconds[1]:.2f} ms")


def percent(values: Array) -> str:
    """Median, 95th percentile and maximum as percentages."""
    return ", ".join(f"{100 * v:.3g} %" for v in (*np.percentile(values, [50, 95]), values.max()))


def main() -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    compare(arguments.problems, arguments.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
