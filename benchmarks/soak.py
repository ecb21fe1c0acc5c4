"""Random problems, most of them nonsense: `python -m benchmarks.soak --problems N [--seed S]`.

Cars, scenes and tracks with missing images: 0 to 14 points, 0 to 100 % outliers, all depths, views, intrinsics and
kinds of evidence. Counts what they come to and prints what must not be: an error that fgrecon does not raise on
purpose, a number that is not finite, an absurd size or a place behind the camera in a result that is not flagged, other
bits for the same input, more than five seconds. Exit code 1 says that there was something.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import fgrecon
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import yaw_pose

_SIZES = (0.3, 30.0)  # metres: what a car can measure
_SLOW = 5.0  # seconds for one car, or for a car of a scene or an image of a track
_AGAIN = 20  # every so many-th problem is solved twice

Array = np.ndarray[Any, np.dtype[np.float64]]


def random_camera(rng: np.random.Generator) -> fgrecon.Camera:
    """Focal lengths from 1 to 100,000 pixels, most of them sensible."""
    focal = 10 ** rng.uniform(0, 5) if rng.random() < 0.2 else rng.uniform(300, 3000)
    camera = fgrecon.Camera.of([focal, focal * rng.uniform(0.5, 2.0), *rng.uniform(0, 1200, 2)])
    if rng.random() < 0.1:
        return fgrecon.Camera.of(camera, rng.normal(0, 0.1, 5))
    return camera


def random_observation(rng: np.random.Generator, camera: fgrecon.Camera) -> Observation:
    """A car with outliers, or pixels without any."""
    prior = load_prior("car14")
    if rng.random() < 0.6:
        location = np.array([rng.uniform(-20, 20), rng.uniform(-3, 3), 10 ** rng.uniform(0, 2.3)])
        pose = yaw_pose(rng.uniform(-np.pi, np.pi), location)
        points = prior.mean @ pose[:3, :3].T + pose[:3, 3]
        pixels = camera.project(np.maximum(points, [-np.inf, -np.inf, 0.1])) + rng.normal(0, 3, (14, 2))
        wrong = rng.random(14) < rng.random()
        pixels[wrong] += rng.normal(0, 200, (int(wrong.sum()), 2))
    else:
        pixels = rng.uniform(-1e4, 1e4, 2) + rng.normal(size=(14, 2)) * 10 ** rng.uniform(-2, 4)
    pixels = np.clip(pixels, -1e6, 1e6)
    pixels[rng.permutation(14)[rng.integers(0, 15) :]] = np.nan
    confidence = rng.uniform(0, 1, 14) if rng.random() < 0.8 else rng.integers(0, 2, 14).astype(float)
    box = None
    if rng.random() < 0.7:
        corner = rng.uniform(0, 1000, 2)
        box = np.concatenate([corner, corner + 10 ** rng.uniform(0.01, 3, 2)])
    covariance = np.tile(np.eye(2) * 10 ** rng.uniform(-8, 6), (14, 1, 1)) if rng.random() < 0.3 else None
    azimuth = rng.dirichlet(np.full(36, 0.05)) if rng.random() < 0.3 else None
    return Observation(pixels, confidence, box, covariance, azimuth=azimuth)


def problem(seed: Sequence[int]) -> tuple[str, int, Callable[[], Sequence[Reconstruction]]]:
    """A random problem: its kind, how many cars or images it has, and what solves it."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng)
    told: dict[str, Any] = {
        "options": fgrecon.Options(keep_history=False, box=("surface", "cuboid", "off")[seed[-1] % 3])
    }
    if rng.random() < 0.5:
        told["ground"] = float(10 ** rng.uniform(-2, 2))
    if rng.random() < 0.5:
        told["size_prior"] = "kitti"
    kind = ("car", "car", "car", "scene", "track")[int(rng.integers(5))]
    count = 1 if kind == "car" else int(rng.integers(1, 7))
    seen = [random_observation(rng, camera) for _ in range(count)]
    if kind == "car":
        return kind, count, lambda: [fgrecon.reconstruct(seen[0], camera, **told)]
    if kind == "scene":
        if rng.random() < 0.3 and camera.distortion is None:
            camera = fgrecon.Camera(camera.matrix, focal_sigma=0.5)
        return kind, count, lambda: fgrecon.reconstruct_scene(seen, camera, **told).vehicles
    gaps = [None if rng.random() < 0.3 else one for one in seen]
    return kind, count, lambda: fgrecon.reconstruct_track(gaps, camera, **told).frames


def faults(results: Sequence[Reconstruction]) -> list[str]:
    """What results that are not flagged must not be."""
    found = []
    for result in results:
        if not result.status.determined:
            continue
        numbers = (result.camera_T_object, result.wireframe, result.box_size, result.coefficients, result.weights)
        if not all(np.isfinite(array).all() for array in numbers):
            found.append("not finite")
        elif not (result.box_size > _SIZES[0]).all() or not (result.box_size < _SIZES[1]).all():
            found.append(f"size {result.box_size.round(2).tolist()}")
        elif result.location[2] <= 0.0:
            found.append(f"behind the camera: {result.location.round(2).tolist()}")
    return found


def main() -> int:
    """Solve them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    bad: list[str] = []
    slowest = (0.0, "")
    problem([0, 0])[2]  # loads what is loaded on use
    for number in range(given.problems):
        kind, size, solve = problem([given.seed, number])
        began = time.perf_counter()
        try:
            results: Sequence[Reconstruction] = solve()
            counts.update(f"{kind}: {result.status.value}" for result in results)
        except FgreconError as error:
            results = []
            counts[f"{kind}: {type(error).__name__}"] += 1
        except Exception as error:  # noqa: BLE001  # that is the question
            bad.append(f"{kind} {number}: {type(error).__name__}: {error}")
            continue
        each = (time.perf_counter() - began) / size
        slowest = max(slowest, (each, f"{kind} {number}"))
        bad += [f"{kind} {number}: {fault}" for fault in faults(results)]
        if each > _SLOW and number > 0:
            bad.append(f"{kind} {number}: {each:.2f} s each")
        if number % _AGAIN == 0 and results:
            same = [one.camera_T_object.tobytes() for one in problem([given.seed, number])[2]()]
            if same != [one.camera_T_object.tobytes() for one in results]:
                bad.append(f"{kind} {number}: other bits")
    for name, count in sorted(counts.items()):
        print(f"{name}: {count}")
    print(f"{given.problems} problems, {len(bad)} faults; slowest {slowest[0]:.2f} s each: {slowest[1]}")
    print(*bad, sep="\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
