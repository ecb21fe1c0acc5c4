"""What one car costs, stage by stage, beside other solvers in the same run.

Run from the repository root, on one core:
    OMP_NUM_THREADS=1 python -m benchmarks.bench_pipeline [--repeats 7] [--cars 24] [--profile]

Cars are frames of the real tracks where the data is (FGRECON_DATA or ../shared/data), else simulated; the 36-point row
needs the authors' release from the same place. Every number is the median over the cars of the least of the repeats,
which a busy machine disturbs least. "CPU" is the time of this process alone, "wall" what a clock shows. Ratios are of
CPU times, to one call of OpenCV's SQPnP on the same points.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import platform
import pstats
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import cv2
import gtsam
import numpy as np
import poselib
import scipy
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.evaluation.methods import METHODS, SceneKnowledge
from fgrecon.io.catalogue import load_prior
from fgrecon.io.track_file import read_track
from fgrecon.paper.icra2017_release import import_icra2017, load_icra2017_example
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, kitti_like_pose, simulate
from fgrecon.solve.graph.adjust import Adjusted, adjust, start_state
from fgrecon.solve.graph.covariance import factorise, read_covariances
from fgrecon.solve.graph.graph import Graph, Seen
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals.adjust import PoseEstimate, adjust_pose
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.vehicle.model import VehicleModel, prepare
from tests.conftest import data_root
from tests.solve.graph.energy import Energy, minimise_by_ceres

Array = NDArray[np.float64]
GROUND, SIZE = Ground.level(1.65), SIZE_PRIORS["kitti"]


@dataclass(frozen=True)
class Car:
    """One observation with everything prepared that is not timed."""

    observation: Observation
    camera: Camera
    model: VehicleModel
    options: Options
    guess: float | None
    problem: Problem
    pose: PoseEstimate
    adjusted: Adjusted

    @classmethod
    def of(
        cls,
        observation: Observation,
        camera: Camera,
        model: VehicleModel,
        options: Options,
        guess: float | None = None,
    ) -> Car:
        """Solve it once, which also warms every cache."""
        problem = Problem.of(observation, camera, model, GROUND, options)
        pose = adjust_pose(problem, guess)
        return cls(observation, camera, model, options, guess, problem, pose, adjust([Seen(problem)], [pose]))

    def adjust_pose(self) -> object:
        """The proposals."""
        problem = Problem.of(self.observation, self.camera, self.model, GROUND, self.options)
        return adjust_pose(problem, self.guess)

    def adjust(self, *, joint: bool = True, keep_history: bool = False, alternatives: bool = True) -> object:
        """The graph's stage, from every proposal that matters or from the best alone."""
        shape = replace(self.options.shape, joint=joint)
        options = replace(self.options, shape=shape, keep_history=keep_history)
        start = self.pose if alternatives else replace(self.pose, alternatives=())
        return adjust([Seen(replace(self.problem, options=options))], [start])

    def covariance(self) -> object:
        """Covariances at the result."""
        graph, state = self.adjusted.graph, self.adjusted.optimum.state
        values = graph.values(state)
        marginals = factorise(graph.build(state.weights), values)
        return read_covariances(graph.observations[0], state.weights[0], values, marginals)

    def reconstruct(self) -> object:
        """Everything."""
        observation = self.observation
        return reconstruct(
            observation,
            self.camera,
            ground=GROUND,
            prior=PRIORS[self.model.prior.category.name],
            size_prior=SIZE,
            initial=self.guess,
            options=self.options,
        )

    def one_solve(self) -> object:
        """One joint minimisation with the final weights, from the best proposal."""
        seen = [Seen(self.problem)]
        start = start_state(seen, [self.pose])
        graph = Graph(seen, start, pose_free=True)
        return minimise(graph.build(self.adjusted.optimum.state.weights), graph.values(start))

    def energy(self) -> tuple[Energy, Array]:
        """The same energy in plain numpy, and its start."""
        covariance = keypoint_covariances(self.observation, self.options.keypoints)
        (weights,) = self.adjusted.optimum.state.weights
        energy = Energy(self.problem, covariance, weights, self.pose.camera_T_object, joint=True)
        return energy, energy.start(self.pose.coefficients, np.zeros((len(weights.keypoints), 3)))

    def scipy_solve(self) -> object:
        """The same by scipy, numeric derivatives."""
        energy, start = self.energy()
        return least_squares(energy.residual, start, x_scale="jac")

    def ceres_solve(self) -> object:
        """The same by Ceres, the residual and its numeric derivatives from Python."""
        return minimise_by_ceres(*self.energy())


PRIORS = {"car14": load_prior("car14")}


def observations(count: int) -> tuple[str, Iterator[tuple[Observation, Camera]]]:
    """Where the cars come from, and the cars: evenly spaced real frames, or simulated ones."""
    folder, prior = data_root(), PRIORS["car14"]
    files = [] if folder is None else sorted(folder.glob("kitti_tracking_keypoints14/*.json"))
    if files:
        tracks = [read_track(file, prior.category) for file in files]
        frames = [(f.observation, t.camera) for t in tracks for f in t.frames if f.observation is not None]
        step = max(1, len(frames) // count)
        return "real frames with network keypoints", iter(frames[::step][:count])
    return "SIMULATED cars", _simulated(count)


def _simulated(count: int) -> Iterator[tuple[Observation, Camera]]:
    rng, fleet = np.random.default_rng(0), PRIORS["car14"].for_fleet(SIZE)
    while count:
        try:
            observation, _ = simulate(Vehicle.sample(fleet, rng), KITTI_CAMERA, kitti_like_pose(rng), rng)
        except FgreconError:
            continue  # outside the image
        count -= 1
        yield observation, KITTI_CAMERA


def clock(calls: Sequence[Callable[[], object]], repeats: int) -> tuple[float, float]:
    """Median over the calls of the least CPU and wall milliseconds of the repeats."""
    best = np.full((len(calls), 2), np.inf)
    for _ in range(repeats):
        for i, call in enumerate(calls):
            wall, cpu = time.perf_counter(), time.process_time()
            call()
            took = time.process_time() - cpu, time.perf_counter() - wall
            best[i] = np.minimum(best[i], took)
    cpu_ms, wall_ms = 1e3 * np.median(best, axis=0)
    return float(cpu_ms), float(wall_ms)


def table(title: str, rows: dict[str, Sequence[Callable[[], object]]], repeats: int) -> None:
    """Clock the rows; the first is what the others are compared with."""
    print(f"\n{title}\n  {'':44s}{'CPU ms':>9s}{'wall ms':>9s}{'ratio':>9s}")
    unit = None
    for name, calls in rows.items():
        cpu, wall = clock(calls, repeats)
        unit = cpu if unit is None else unit
        print(f"  {name:44s}{cpu:9.3f}{wall:9.3f}{cpu / unit:9.1f}", flush=True)


def baseline(name: str, car: Car) -> Callable[[], object]:
    """A method of the evaluation, bound."""
    solver = METHODS[name].bind(SceneKnowledge(PRIORS[car.model.prior.category.name], GROUND, SIZE))
    return lambda: solver(car.observation, car.camera)


def stages(cars: Sequence[Car]) -> dict[str, Sequence[Callable[[], object]]]:
    """Rows that every category has."""
    return {
        "proposals": [car.adjust_pose for car in cars],
        "graph, pose fixed": [lambda car=car: car.adjust(joint=False) for car in cars],
        "graph, from the best proposal alone": [lambda car=car: car.adjust(alternatives=False) for car in cars],
        "graph, from every proposal that matters": [car.adjust for car in cars],
        "the same, recording every iteration": [lambda car=car: car.adjust(keep_history=True) for car in cars],
        "covariances": [car.covariance for car in cars],
        "reconstruct()": [car.reconstruct for car in cars],
        "one joint solve, weights fixed: GTSAM": [car.one_solve for car in cars],
    }


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--cars", type=int, default=24)
    parser.add_argument("--profile", action="store_true", help="list what proposals and graph spend time on")
    arguments = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; Python "
        f"{platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}, OpenCV {cv2.__version__}, "
        f"gtsam {gtsam.__version__ if hasattr(gtsam, '__version__') else '4.3'}"
    )
    origin, found = observations(arguments.cars)
    options = Options(box=BoxModel.CUBOID, keep_history=False)
    model = prepare(PRIORS["car14"], SIZE)
    cars = [Car.of(observation, camera, model, options) for observation, camera in found]
    peers = {
        "OpenCV SQPnP, confident points": [baseline("sqpnp_confident", car) for car in cars],
        "PoseLib LO-RANSAC, all points": [baseline("poselib_ransac", car) for car in cars],
        "ASPnP, all points": [baseline("aspnp", car) for car in cars],
    }
    solvers = {"  the same energy: scipy": [car.scipy_solve for car in cars]}
    try:
        import pyceres
    except ImportError:
        print("pyceres is not installed: no Ceres row")
    else:
        solvers[f"  the same energy: pyceres {pyceres.__version__}"] = [car.ceres_solve for car in cars]
    title = f"14 points, 5 vectors: {len(cars)} {origin} (PoseLib {poselib.__version__})"
    table(title, peers | stages(cars), arguments.repeats)
    table("the same joint solve by others", {"GTSAM": [car.one_solve for car in cars]} | solvers, 2)
    release = data_root()
    if release is not None and (release / "icra2017").is_dir():
        large = icra2017(release / "icra2017")
        rows = {"OpenCV SQPnP": [baseline("sqpnp", car) for car in large]}
        table(
            "36 points, 42 vectors: the two photographs of the authors' release",
            rows | stages(large),
            arguments.repeats,
        )
    if arguments.profile:
        for name, calls in {"proposals": [c.adjust_pose for c in cars], "graph": [c.adjust for c in cars]}.items():
            profile(name, calls)
    return 0


def icra2017(folder: Path) -> list[Car]:
    """The two cars of the release, with its first guess of the azimuth."""
    PRIORS["car36"] = import_icra2017(folder)
    model = prepare(PRIORS["car36"], SIZE)
    options = Options(box=BoxModel.CUBOID, keep_history=False)
    examples = [load_icra2017_example(folder, name) for name in ("01", "02")]
    return [Car.of(e.observation, e.camera, model, options, e.azimuth) for e in examples]


def profile(name: str, calls: Sequence[Callable[[], object]]) -> None:
    """Print the functions that take most time themselves."""
    profiler = cProfile.Profile()
    profiler.enable()
    for call in calls:
        call()
    profiler.disable()
    print(f"\n{name}, {len(calls)} cars")
    pstats.Stats(profiler).sort_stats("tottime").print_stats(15)


if __name__ == "__main__":
    sys.exit(main())
