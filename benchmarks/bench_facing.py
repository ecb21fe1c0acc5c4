"""Facing over time by a network that is often wrong: `python -m benchmarks.bench_facing DATA [--paths 84]`.

Simulated keypoints over the paths that real cars took before KITTI's camera (DATA has `kitti_tracking/label_02`), whose
motion is not given; the ground and the fleet are. Three of ten frames are missing, and three of ten of the others show
the car flipped, points and directions: at random, or five of them in a row. Beside `fgrecon.Tracker` stands the
majority of the frames so far, which is all that can be known of errors that have nothing to do with one another.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path

import numpy as np

from fgrecon.calibration.labelled_boxes import DIMENSIONS, FLIPPED_DEGREES, BoxOutcome, outcome
from fgrecon.core.arrays import Array
from fgrecon.core.coverage import reliability
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.half_turn import flipped_observation
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import rotation_y
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import size_prior
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.catalogue import load_prior
from fgrecon.io.files import write_text
from fgrecon.io.kitti_files import IMAGES_PER_SECOND, read_tracking
from fgrecon.io.track_file import GroundTruth
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from fgrecon.solve.tracker import Tracker
from fgrecon_research.evaluation.video_summary import consistency

_MISSING, _TURNED, _ROW = 0.3, 0.3, 5
_LONGEST, _SHORTEST = 60, 30  # frames of a path
_NEAR, _FAR = 5.0, 45.0  # metres
_WITHIN = 15.0  # degrees
_HEIGHT = 1.65
_BINS = 2.0 * np.pi * np.arange(36) / 36


def paths(folder: Path, wanted: int, rng: np.random.Generator) -> list[dict[int, Array]]:
    """Poses (4, 4) by frame of cars that are seen whole for long enough, upright on the ground of their labels."""
    found: list[dict[int, Array]] = []
    for file in sorted(folder.glob("*.txt")):
        cars: dict[int, dict[int, Array]] = {}
        for frame, one in read_tracking(file).items():
            o = one.objects
            for i, track in enumerate(one.tracks.tolist()):
                seen = o.truncation[i] == 0 and o.occlusion[i] <= 1 and _NEAR < o.location[i, 2] < _FAR
                if o.kind[i] == "Car" and seen:
                    cars.setdefault(track, {})[frame] = yaw_pose(float(o.rotation_y[i]), o.location[i])
        found += [path for path in cars.values() if len(path) >= _SHORTEST]
    return [found[i] for i in rng.permutation(len(found))[:wanted]]


def shown(vehicle: Vehicle, prior: ShapePrior, pose: Array, *, turned: bool, rng: np.random.Generator) -> Observation:
    """What a network finds, with directions; flipped where it is so."""
    seen, _ = simulate(vehicle, KITTI_CAMERA, pose, rng)
    directions = np.exp((np.cos(_BINS - view_azimuth(pose[:3, :3], pose[:3, 3])) - 1.0) / 0.1) + 0.02
    seen = replace(seen, azimuth=directions / directions.sum())
    return flipped_observation(seen, prior) if turned else seen


def scored(estimate: VehicleEstimate, pose: Array, size: Array) -> BoxOutcome:
    """How far an estimate is off, with the facing's probability over time."""
    truth = GroundTruth(pose[:3, 3], rotation_y(pose))
    found = outcome(estimate.reconstruction, truth, size, np.zeros(3))
    return replace(found, facing=estimate.facing_probability)


def follow(
    path: dict[int, Array], *, row: bool, rng: np.random.Generator
) -> tuple[list[BoxOutcome], list[BoxOutcome], list[float]]:
    """One path: online, in batch, and whether the majority of the frames so far is right (a half where it is a tie)."""
    fleet = size_prior("kitti")
    prior = load_prior("car14")
    of_fleet = prior.for_fleet(fleet)
    vehicle = Vehicle.sample(of_fleet, rng)
    size = of_fleet.box_size(vehicle.coefficients)
    numbers = [number for number in sorted(path)[:_LONGEST] if rng.random() > _MISSING]
    together = np.arange(_ROW) + rng.integers(0, len(numbers) - _ROW + 1) if row else np.zeros(0, dtype=np.int64)
    others = rng.permutation(np.setdiff1d(np.arange(len(numbers)), together))
    turned = np.zeros(len(numbers), dtype=bool)
    turned[[*together, *others[: max(round(_TURNED * len(numbers)) - len(together), 0)]]] = True
    tracker = Tracker(prior=prior, size_prior=fleet)
    online: dict[int, BoxOutcome] = {}
    for number, wrong in zip(numbers, turned.tolist(), strict=True):
        seen = {0: shown(vehicle, prior, path[number], turned=wrong, rng=rng)}
        found = tracker.update(number / IMAGES_PER_SECOND, seen, camera=KITTI_CAMERA, ground=_HEIGHT)
        if 0 in found:
            online[number] = scored(found[0], path[number], size)
    batch = [scored(one, path[number], size) for one, number in zip(tracker.smooth()[0], online, strict=True)]
    ahead = np.cumsum(np.where(turned, -1, 1))
    majority: list[float] = (0.5 * (1.0 + np.sign(ahead))).tolist()
    return [*online.values()], batch, majority


def table_row(name: str, found: Sequence[BoxOutcome], majority: Sequence[float] | None) -> str:
    """Of the Markdown table."""
    degrees, facing = np.array([one.degrees for one in found]), np.array([one.facing for one in found], dtype=float)
    error = reliability(np.maximum(facing, 1.0 - facing), (degrees <= FLIPPED_DEGREES) == (facing > 0.5)).error
    most = "-" if majority is None else f"{100 * np.mean(majority):.1f}"
    held = []
    for quantity in ("position", "yaw"):
        squared = [one.squared[quantity] for one in found if quantity in one.squared]
        judged = consistency(squared, DIMENSIONS[quantity], 1)
        held.append("-" if judged is None else f"{judged.inside:.0f}")
    within = 100 * np.mean(degrees <= _WITHIN)
    return f"| {name} | {len(degrees)} | {within:.1f} | {most} | {error:.3f} | {' | '.join(held)} |"


def main() -> int:
    """Follow every path, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of the real data")
    parser.add_argument("--paths", type=int, default=84, help="how many, drawn from all")
    parser.add_argument("--json", type=Path, help="file for the errors of every frame")
    given = parser.parse_args()
    chosen = paths(given.data / "kitti_tracking" / "label_02", given.paths, np.random.default_rng(0))
    if not chosen:
        print("error: DATA has no kitti_tracking/label_02 with long enough paths", file=sys.stderr)
        return 1
    heads = ("frames", f"within {_WITHIN:g}° %", "majority right %", "ECE", "place in region %", "yaw in region %")
    print(f"| flipped | {' | '.join(heads)} |", "|---|---:|---:|---:|---:|---:|---:|", sep="\n")
    kept: dict[str, object] = {}
    for name, row in (("at random", False), ("five in a row", True)):
        followed = [follow(path, row=row, rng=np.random.default_rng(seed)) for seed, path in enumerate(chosen)]
        online, batch, majority = ([*chain.from_iterable(parts)] for parts in zip(*followed, strict=True))
        print(table_row(f"{name}, online", online, majority), table_row(f"{name}, in batch", batch, None), sep="\n")
        kept[name] = {"online": [*map(asdict, online)], "batch": [*map(asdict, batch)], "majority": majority}
    if given.json is not None:
        write_text(given.json, json.dumps(kept) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
