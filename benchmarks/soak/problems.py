"""Random problems, most of them nonsense, and what their results must not be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import fgrecon
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import yaw_pose

_SIZES = (0.3, 30.0)  # metres: what a car can measure
_STRATEGIES = tuple(fgrecon.StrategyName)

__all__ = ["faults", "problem"]


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


def video(
    rng: np.random.Generator, camera: fgrecon.Camera, given: dict[str, Any]
) -> tuple[int, Callable[[], Sequence[Reconstruction]]]:
    """How many sightings there are, and what follows them: vehicles that come and go, a camera that jumps about."""
    frames: list[dict[str, Any]] = []
    place, time, moves = np.eye(4), 0.0, rng.random() < 0.6
    for _ in range(int(rng.integers(1, 9))):
        time += 10 ** rng.uniform(-2, 1)
        place = place @ yaw_pose(rng.normal(0, 0.1), rng.normal(0, 1, 3) * 10 ** rng.uniform(-2, 1))
        seen = {name: random_observation(rng, camera) for name in range(3) if rng.random() < 0.6}
        frame: dict[str, Any] = {"time": time, "observations": seen}
        if moves and rng.random() < 0.9:
            root = rng.normal(size=(6, 6)) * np.repeat(10 ** rng.uniform(-6, 1, 2), 3)[:, None]
            frame |= {"world_T_camera": place, "motion_covariance": root @ root.T}
        frames.append(frame)
    settings = {name: given.get(name) for name in ("size_prior", "options")}
    shared = rng.random() < 0.5

    def follow() -> list[Reconstruction]:
        tracker = fgrecon.Tracker(**settings, shared_ground=shared)
        online = [tracker.update(camera=camera, ground=given.get("ground"), **frame).values() for frame in frames]
        smoothed = tracker.smooth().values()
        return [one.reconstruction for some in (*online, *smoothed) for one in some]

    return max(sum(len(frame["observations"]) for frame in frames), 1), follow


def problem(seed: Sequence[int]) -> tuple[str, int, Callable[[], Sequence[Reconstruction]]]:
    """A random problem: its kind, how many cars or images it has, and what solves it; one in 25 is a video."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng)
    number = seed[-1]
    traffic = ("right", "left", None, None)[number // 3 % 4]
    options = fgrecon.Options(keep_history=False, box=("surface", "cuboid", "off")[number % 3], traffic=traffic)
    given: dict[str, Any] = {"options": options}
    if rng.random() < 0.5:
        given["ground"] = float(10 ** rng.uniform(-2, 2))
    if rng.random() < 0.5:
        given["size_prior"] = "kitti"
    kind = ("car", "car", "car", "scene", "track")[int(rng.integers(5))]
    if number % 25 == 5:  # of which one in four is solved twice
        return "video", *video(rng, camera, given)
    count = 1 if kind == "car" else int(rng.integers(1, 7))
    seen = [random_observation(rng, camera) for _ in range(count)]
    if kind == "car":
        if number % 20 == 7:
            given["options"] = replace(
                options, strategy=fgrecon.RobustStrategy(_STRATEGIES[number // 20 % len(_STRATEGIES)])
            )
        return kind, count, lambda: [fgrecon.reconstruct(seen[0], camera, **given)]
    if kind == "scene":
        if rng.random() < 0.3 and camera.distortion is None:
            camera = fgrecon.Camera(camera.matrix, focal_sigma=0.5)
        return kind, count, lambda: fgrecon.reconstruct_scene(seen, camera, **given).vehicles
    gaps = [None if rng.random() < 0.3 else one for one in seen]
    return kind, count, lambda: fgrecon.reconstruct_track(gaps, camera, **given).frames


def faults(results: Sequence[Reconstruction]) -> list[str]:
    """What results that are not flagged must not be."""
    found = []
    for result in results:
        if not result.status.determined:
            continue
        numbers = (
            result.camera_T_object,
            result.wireframe,
            result.box_size,
            result.shape.coefficients,
            result.diagnostics.weights,
        )
        if not all(np.isfinite(array).all() for array in numbers):
            found.append("not finite")
        elif not (result.box_size > _SIZES[0]).all() or not (result.box_size < _SIZES[1]).all():
            found.append(f"size {result.box_size.round(2).tolist()}")
        elif result.location[2] <= 0.0:
            found.append(f"behind the camera: {result.location.round(2).tolist()}")
    return found
