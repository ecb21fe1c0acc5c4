"""Better minima that a solve misses: `python -m benchmarks.bench_minima [--problems N] [--first 0] [--starts 1000]`.

Each problem is a simulated car, solved as `fgrecon.reconstruct` solves it, and again from the minima of a search with
many starts: every yaw, tilts, depths from half to twice the box's, shapes from the prior, 20 iterations, none dropped.
Missed is a minimum of the graph's energy that is lower by more than 0.5 nats, and whose pose is turned by more than 5
degrees or moved by more than 0.2 m; energies are those at the visibility of the ends' own poses, since with that of
another pose an end can look better than it is. By number of keypoints and what is given, for each strategy with an
energy; of all results, and of those that say `converged`. Goes on where it was with the same `--out`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.errors import FgreconError
from fgrecon.core.geometry import turn_between
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.io.files import write_text
from fgrecon.simulation.keypoint_noise import HOURGLASS
from fgrecon.simulation.vehicles import KITTI_CAMERA
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.inputs import SolveSetup, observe
from fgrecon.solve.proposals.pose_search import search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.search import search
from fgrecon.solve.proposals.starts import at_azimuths, view_box
from fgrecon.solve.proposals.terms import Hypotheses
from fgrecon.solve.result import results
from fgrecon_research.simulation import HARD, simulate_many

POINTS = (14, 10, 7, 5)
GIVEN: dict[str, dict[str, Any]] = {
    "nothing": {},
    "ground": {"ground": 1.65},
    "ground and size": {"ground": 1.65, "size": "kitti"},
}
_LOWER, _TURNED, _MOVED = 0.5, np.radians(5.0), 0.2  # nats, radians, metres: a minimum of its own
_REFINED = 12  # best distinct ends of the wide search that are refined in the graph
_ALIKE = np.radians(10.0)
_ITERATIONS = 20


@dataclass(frozen=True)
class Case:
    """A problem's kind."""

    strategy: str
    points: int
    given: str
    noise: str

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.strategy}, {self.points} points, {self.given} given, {self.noise}"


def cases(strategies: list[str]) -> list[Case]:
    """All kinds of problems."""
    return [
        Case(strategy, points, given, noise)
        for strategy in strategies
        for points in POINTS
        for given in GIVEN
        for noise in ("hourglass", "hard")
    ]


def problem(case: Case, number: int) -> Problem:
    """A random problem of a kind."""
    rng = np.random.default_rng(
        [number, POINTS.index(case.points), list(GIVEN).index(case.given), case.noise == "hard"]
    )
    prior = load_prior("car14")
    ((seen, _),) = simulate_many(prior, 1, rng, HARD if case.noise == "hard" else HOURGLASS)
    pixels = seen.keypoints.copy()
    pixels[rng.permutation(len(pixels))[case.points :]] = np.nan
    observation = Observation(pixels, np.where(np.isnan(pixels[:, 0]), 0.0, seen.confidence), seen.box)
    given = GIVEN[case.given]
    options = Options(strategy=case.strategy, keep_history=False)
    setup = SolveSetup.of(prior, given.get("size"), options, given.get("ground"))
    observed, _ = observe(observation, KITTI_CAMERA, setup)
    return Problem.of(observed, KITTI_CAMERA, setup.model, setup.ground, setup.options)


def wide_search(one: Problem, starts: int, rng: np.random.Generator) -> list[Alternative]:
    """The best distinct minima of the pose energy from many starts."""
    box = view_box(one.observation)
    h = at_azimuths(box, one.camera, one.model, one.ground, rng.uniform(-np.pi, np.pi, starts), relative=True)
    axis = rng.normal(0.0, 0.15, (starts, 3)) * [1.0, 0.0, 1.0]
    half = 0.5 * axis
    skew = np.zeros((starts, 3, 3))
    skew[:, 2, 1], skew[:, 1, 2] = half[:, 0], -half[:, 0]
    skew[:, 1, 0], skew[:, 0, 1] = half[:, 2], -half[:, 2]
    tilt = np.linalg.solve(np.eye(3) - skew, np.eye(3) + skew)  # Cayley's rotation
    depth = np.exp(rng.uniform(-np.log(2.0), np.log(2.0), (starts, 1)))
    shapes = 0.7 * rng.standard_normal(h.coefficients.shape)
    moved = Hypotheses(h.rotation @ tilt, h.translation * depth, shapes)
    found = search(one.energy, moved, _ITERATIONS, {})
    poses, kept = found.hypotheses.matrices(), []
    for i in range(len(poses)):
        if np.isfinite(found.energy[i]) and all(turn_between(poses[i], poses[k]) > _ALIKE for k in kept):
            kept.append(i)
            if len(kept) == _REFINED:
                break
    return [Alternative(poses[i], found.hypotheses.coefficients[i], 0.0) for i in kept]


def missed(one: Problem, starts: int, rng: np.random.Generator) -> dict[str, Any]:
    """How much lower the wide search ends, nats, and how far off, radians and metres.

    Raises:
        FgreconError: The problem determines no pose.
    """
    estimate = search_pose(one)
    found = minimise_from_proposals([GraphObservation(one)], [estimate])
    (result,) = results([GraphObservation(one)], [estimate], found, {})
    outcome = {"status": result.status.value}
    if found.optimum.failure is not None:
        return outcome
    others = wide_search(one, starts, rng)
    if not others:
        return outcome
    ends = []
    for other in others:
        start = replace(
            estimate,
            camera_T_object=other.camera_T_object,
            coefficients=other.coefficients,
            alternatives=(),
            everywhere=False,
        )
        ends.append(minimise_from_proposals([GraphObservation(one)], [start]))
    solved = [end for end in ends if end.optimum.failure is None]
    if not solved:
        return outcome
    wide = min(solved, key=lambda end: end.settled_energy)
    here, there = found.optimum.state.poses[0].matrix(), wide.optimum.state.poses[0].matrix()
    return {
        **outcome,
        "lower": found.settled_energy - wide.settled_energy,
        "turned": turn_between(here, there),
        "moved": float(np.linalg.norm(here[:3, 3] - there[:3, 3])),
    }


def is_missed(row: dict[str, Any]) -> bool:
    """Whether the wide search found a better minimum elsewhere."""
    if not row.get("lower", 0.0) > _LOWER:
        return False
    return bool(row["turned"] > _TURNED or row["moved"] > _MOVED)


def rows(given: argparse.Namespace, done: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What is not done yet, a problem of every kind in turn."""
    kinds = cases(given.strategy)
    for number in range(given.first, given.first + given.problems):
        case = kinds[number % len(kinds)]
        key = f"{case.name} #{number // len(kinds)}"
        if key in done:
            continue
        try:
            row = missed(problem(case, number // len(kinds)), given.starts, np.random.default_rng([number, 7]))
        except FgreconError as error:
            row = {"status": type(error).__name__}
        yield key, row


def table(done: dict[str, Any]) -> str:
    """Markdown: share of missed minima by kind."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for key, row in done.items():
        case = key.rpartition(" #")[0]
        for kind in (", ".join(case.split(", ")[:2]), case.split(", ", 2)[2], "all"):
            kinds.setdefault(kind, []).append(row)
    lines = ["| problems | number | missed | % | `converged` | missed | % |", "|---|---:|---:|---:|---:|---:|---:|"]
    for kind, some in sorted(kinds.items()):
        cells = []
        for solved in (some, [row for row in some if row["status"] == Status.CONVERGED.value]):
            count = sum(map(is_missed, solved))
            cells += [str(len(solved)), str(count), f"{100.0 * count / max(len(solved), 1):.2f}"]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    """Solve them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem")
    parser.add_argument("--starts", type=int, default=1000)
    parser.add_argument("--strategy", nargs="+", default=["mixture"])
    parser.add_argument("--out", type=Path, help="file to go on from (JSON)")
    given = parser.parse_args()
    done: dict[str, Any] = json.loads(given.out.read_text()) if given.out and given.out.exists() else {}
    began = time.perf_counter()
    for count, (key, row) in enumerate(rows(given, done), 1):
        done[key] = row
        if given.out and count % 200 == 0:
            write_text(given.out, json.dumps(done))
        if count % 200 == 0:
            print(f"{len(done)} of {given.problems}, {count / (time.perf_counter() - began):.1f}/s", file=sys.stderr)
    if given.out:
        write_text(given.out, json.dumps(done))
    print(table(done))
    return 0


if __name__ == "__main__":
    sys.exit(main())
