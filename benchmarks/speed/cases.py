"""The cars that are solved: real frames, simulated ones with hard keypoints, photographs, and a made-up drive."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from fgrecon.io.track_file import read_track
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from fgrecon_research.simulation import HARD, simulate_many
from tests.conftest import data_root

GROUND_HEIGHT = 1.65
SIZE = "kitti"


@dataclass(frozen=True)
class Case:
    """One car in one image, given the ground and the fleet's size.

    Attributes:
        observation: Its keypoints and box.
        camera: The camera.
        prior: Name of the prior.
        box_model: What the box encloses.
        size: Name of the fleet, or None.
        ground: Height of the camera, or None.
    """

    observation: Observation
    camera: Camera
    prior: str = "car14"
    box_model: str = "cuboid"
    size: str | None = SIZE
    ground: float | None = GROUND_HEIGHT

    def plain(self) -> dict[str, Any]:
        """Numbers and words alone, which every version reads."""
        seen = self.observation
        confidence = np.ones(len(seen.keypoints)) if seen.confidence is None else seen.confidence
        box = np.full(4, np.nan) if seen.box is None else seen.box
        return {
            "keypoints": seen.keypoints.tolist(),
            "confidence": confidence.tolist(),
            "box": box.tolist(),
            "camera": self.camera.matrix.tolist(),
            "prior": self.prior,
            "box_model": self.box_model,
            "size": self.size,
            "ground": self.ground,
        }


def write_cases(path: Path, cases: Sequence[Case]) -> Path:
    """A file that `benchmarks/speed/worker.py` reads."""
    path.write_text(json.dumps([case.plain() for case in cases]), encoding="utf-8")
    return path


def real_frames(count: int) -> list[Case]:
    """Frames of the labelled tracks, evenly spaced; none where the data is absent."""
    folder, category = data_root(), load_prior("car14").category
    files = [] if folder is None else sorted(folder.glob("kitti_tracking_keypoints14/*.json"))
    tracks = [read_track(file, category) for file in files]
    found = [Case(f.observation, t.camera) for t in tracks for f in t.frames if f.observation is not None]
    return found[:: max(1, len(found) // count)][:count]


def hard_cars(count: int) -> list[Case]:
    """Simulated cars of KITTI's size with the keypoints of difficult tracks."""
    fleet, rng = load_prior("car14").for_fleet(SIZE_PRIORS[SIZE]), np.random.default_rng(0)
    found: list[Case] = []
    while len(found) < count:
        ((observation, _),) = simulate_many(fleet, 1, rng, HARD)
        found.append(Case(observation, KITTI_CAMERA, box_model="surface"))
    return found


def marked_cars(count: int) -> list[Case]:
    """Cars of ApolloCar3D with keypoints marked by people, evenly spaced; none where the data is absent."""
    from fgrecon_research.paper.apollocar3d import read_apollocar3d
    from fgrecon_research.training.priors.apollo79 import load_apollo79

    folder = data_root()
    if folder is None or not (folder / "apollocar3d_val").is_dir():
        return []
    cars = read_apollocar3d(folder / "apollocar3d_val" / "annotations.json", load_apollo79(folder))
    chosen = cars.cars[:: max(1, len(cars.cars) // count)][:count]
    seen = [Observation.of(car.keypoints, np.isfinite(car.keypoints[:, 0]) * 0.95, car.box) for car in chosen]
    return [Case(one, cars.camera, size="apollo79", ground=None, box_model="surface") for one in seen]


def streets(cars: int, count: int) -> list[list[Case]]:
    """Images of so many simulated cars on one road, which goes up or down by a degree or so from the camera."""
    fleet, rng = load_prior("car14").for_fleet(SIZE_PRIORS[SIZE]), np.random.default_rng(cars)
    found: list[list[Case]] = []
    for _ in range(count):
        pitch, street = np.radians(rng.normal(0.0, 1.0)), list[Case]()
        turn = np.eye(4)
        turn[1:3, 1:3] = [[np.cos(pitch), -np.sin(pitch)], [np.sin(pitch), np.cos(pitch)]]
        while len(street) < cars:
            place = np.array([rng.uniform(-8.0, 8.0), GROUND_HEIGHT, rng.uniform(8.0, 40.0)])
            pose = turn @ yaw_pose(rng.uniform(-np.pi, np.pi), place)
            try:
                observation, _ = simulate(Vehicle.sample(fleet, rng), KITTI_CAMERA, pose, rng, HARD)
            except FgreconError:
                continue
            street.append(Case(observation, KITTI_CAMERA, box_model="surface"))
        found.append(street)
    return found


def drive(images: int) -> list[Case]:
    """One car for as many images as wanted: it swerves ahead of the camera, nearer and farther."""
    fleet, rng = load_prior("car14").for_fleet(SIZE_PRIORS[SIZE]), np.random.default_rng(1)
    vehicle = Vehicle.sample(fleet, rng)
    found: list[Case] = []
    while len(found) < images:
        phase = 0.1 * len(found)
        location = np.array([4.0 * np.sin(0.7 * phase), GROUND_HEIGHT, 18.0 + 6.0 * np.sin(phase)])
        try:
            observation, _ = simulate(vehicle, KITTI_CAMERA, yaw_pose(-1.57 + 0.5 * np.sin(phase), location), rng)
        except FgreconError:
            continue
        found.append(Case(observation, KITTI_CAMERA, box_model="surface"))
    return found
