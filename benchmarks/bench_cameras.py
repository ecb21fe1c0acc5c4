"""Cameras of which little is given: `python -m benchmarks.bench_cameras [--data DIR] [--draws 100] [--json FILE]`.

Four tables. Photographs of cars whose models no network has learnt from, with the measured camera, with the focal
length to be found, and with a field of view of 60 degrees assumed (DIR has `posed_cars` and `hand_labels`; without
--data the table is left out). Simulated pictures of one and of four cars, and of five pictures of two cars each that
one camera took: how far the focal length is off, and how often its 95 % region holds it; and of their cars what each
status is worth. Simulated roadside cameras, by what is given: places and the ground's tilt.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fgrecon.calibration.labelled_boxes import normalised_squared_error
from fgrecon.core.arrays import Array
from fgrecon.core.camera import ANY_FOCAL_SIGMA, Camera, Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Status
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.files import write_text
from fgrecon.io.images import read_image
from fgrecon.perception.from_image import reconstruct_detections
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.simulation.vehicles import Vehicle, simulate, yaw_pose
from fgrecon.solve.scene import reconstruct_scene, reconstruct_scenes
from fgrecon_research.evaluation.measures import rotation_error
from fgrecon_research.training.keypoints.posed_cars import PosedCar, read_posed_cars, read_validation_ids

T = TypeVar("T")

_SIZE = (1280, 960)
_SIGMAS = 1.96  # of a 95 % region of one number
_SQUARED = 7.815  # of one of three numbers
_WRONG = 0.2  # of the distance, as in docs/reference/result.md
_GROSS = 20.0  # degrees


# Photographs


def cameras_of(car: PosedCar) -> dict[str, Camera]:
    """What is given of a photograph's camera, by the name of the row; the principal point is the measured one."""
    width, height = car.size
    assumed = Camera.of_field_of_view(width, height).matrix.copy()
    assumed[:2, 2] = car.matrix[:2, 2]
    guess = Camera(assumed, image_size=car.size)
    return {
        "measured": Camera(car.matrix, image_size=car.size),
        "estimated": replace(guess, focal_sigma=ANY_FOCAL_SIGMA),
        "60 degrees assumed": guess,
    }


def photographs(data: Path, count: int) -> dict[str, list[tuple[float, float, bool]]]:
    """By what is given: error of the rotation in degrees, of the focal length (share), and whether its region holds."""
    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    cars = [car for car in read_posed_cars(data / "posed_cars") if car.cad_id in apart]
    chosen = [cars[i] for i in np.linspace(0, len(cars) - 1, min(count, len(cars))).round().astype(int)]
    networks, prior = KeypointCascade("photographs"), load_prior("car14")
    options = Options(box="surface", keep_history=False)
    found: dict[str, list[tuple[float, float, bool]]] = {}
    for car in chosen:
        detections = networks(read_image(car.image), [car.box])
        for name, camera in cameras_of(car).items():
            (one,) = reconstruct_detections(detections, camera, prior=prior, options=options)
            row = (FAILURE_DEGREES, np.inf, False)
            if one.result is not None and one.camera is not None:
                off, inside = focal_error(one.camera, car.matrix[0, 0])
                turned = rotation_error(one.result.camera_T_object[None, :3, :3], car.rotation[None])
                row = float(turned[0]), off, inside
            found.setdefault(name, []).append(row)
    return found


def focal_error(camera: Camera, truth: float) -> tuple[float, bool]:
    """By which share a focal length is off, and whether its 95 % region holds the true one."""
    log = float(np.log(camera.matrix[0, 0] / truth))
    return float(np.expm1(abs(log))), abs(log) <= _SIGMAS * camera.focal_sigma


def photographs_table(found: dict[str, list[tuple[float, float, bool]]]) -> str:
    """Markdown."""
    lines = [
        "| camera | photographs | median ° | above 20° % | focal length off % | 95 % region holds % |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, rows in found.items():
        degrees, off, inside = (np.array(column) for column in zip(*rows, strict=True))
        numbers = f"{np.median(degrees):.1f} | {100 * np.mean(degrees > _GROSS):.1f}"
        focal = f"{100 * np.median(off):.0f} | {100 * np.mean(inside):.0f}" if name == "estimated" else "- | -"
        lines.append(f"| {name} | {len(rows)} | {numbers} | {focal} |")
    return "\n".join(lines)


# Simulated pictures


@dataclass(frozen=True)
class Mount:
    """How a camera stands: metres above the road, degrees down, and by how many degrees it rolls at most."""

    height: float
    down: float
    rolls: float
    depths: tuple[float, float]


_CAR = Mount(1.65, 0.0, 0.0, (8.0, 35.0))
_ROADSIDE = Mount(6.0, 15.0, 5.0, (12.0, 40.0))


def picture(
    count: int, camera: Camera, mount: Mount, rng: np.random.Generator
) -> tuple[list[Observation], Array, Array]:
    """Keypoints of so many cars of KITTI's size on a road, as a network finds them; their places; the road's normal."""
    fleet = size_prior("kitti")
    prior = load_prior("car14").for_fleet(fleet)
    roll = np.radians(rng.uniform(-mount.rolls, mount.rolls))
    turn = Rotation.from_euler("zx", [roll, np.radians(mount.down)]).as_matrix()  # road to camera
    seen: list[Observation] = []
    places: list[Array] = []
    while len(seen) < count:
        pose = yaw_pose(rng.uniform(-np.pi, np.pi), np.array([0.0, mount.height, rng.uniform(*mount.depths)]))
        pose[0, 3] = 0.35 * rng.uniform(-1.0, 1.0) * pose[2, 3]
        pose[:3] = turn @ pose[:3]
        if any(np.linalg.norm(pose[:3, 3] - place) < 4.0 for place in places):
            continue
        try:
            seen.append(simulate(Vehicle.sample(prior, rng), camera, pose, rng)[0])
        except InvalidInputError:  # outside the image
            continue
        places.append(pose[:3, 3])
    return seen, np.array(places), turn @ [0.0, 1.0, 0.0]


Place = tuple[float, bool, str]
"""Error of a vehicle's place as a share of its distance, whether its 95 % region holds, and the vehicle's status."""


def places_off(scene: SceneReconstruction, places: Array) -> list[Place]:
    """Of each vehicle; infinitely far off where it was refused."""
    found: list[Place] = [(np.inf, False, "refused")] * len(places)
    for number, vehicle in zip(scene.numbers, scene.vehicles, strict=True):
        error = vehicle.location - places[number]
        off = float(np.linalg.norm(error) / np.linalg.norm(places[number]))
        squared = None
        if vehicle.uncertainty.pose_covariance is not None:
            error = vehicle.camera_T_object[:3, :3].T @ error
            squared = normalised_squared_error(error, vehicle.uncertainty.pose_covariance[3:, 3:])
        found[number] = off, squared is not None and squared <= _SQUARED, vehicle.status.value
    return found


Focal = tuple[float, bool, list[Place]]
"""Error of a focal length (share), whether its region holds, and what is off of the places."""


def focal_draw(
    images: int, cars: int, rng: np.random.Generator, *, shared: bool = False, sigma: float = ANY_FOCAL_SIGMA
) -> list[Focal]:
    """Pictures of one camera whose focal length is drawn from what is believed of it (1 `sigma` of its logarithm)."""
    guess = replace(Camera.of_unknown(*_SIZE), focal_sigma=sigma)
    scale = np.exp(sigma * np.clip(rng.standard_normal(), -2.0, 2.0))
    truth = replace(guess, matrix=guess.matrix @ np.diag([scale, scale, 1.0]), focal_sigma=0.0)
    pictures = [picture(cars, truth, _CAR, rng) for _ in range(images)]
    some = [seen for seen, _, _ in pictures]
    scenes = (
        reconstruct_scenes(some, guess, size_prior="kitti")
        if shared
        else [reconstruct_scene(seen, guess, size_prior="kitti") for seen in some]
    )
    return [
        (*focal_error(scene.camera, truth.matrix[0, 0]), places_off(scene, places))
        for scene, (_, places, _) in zip(scenes, pictures, strict=True)
    ]


FOCAL_ROWS: dict[str, Callable[[np.random.Generator], list[Focal]]] = {
    "one car": lambda rng: focal_draw(1, 1, rng),
    "four cars": lambda rng: focal_draw(1, 4, rng),
    "four cars, focal length known to 10 %": lambda rng: focal_draw(1, 4, rng, sigma=0.1),
    "two cars": lambda rng: focal_draw(5, 2, rng),
    "five pictures of two cars, one camera": lambda rng: focal_draw(5, 2, rng, shared=True),
}
"""Draws by the name of the row; each begins with the same numbers, so the last two are the same pictures."""


def focal_table(found: dict[str, list[list[Focal]]]) -> str:
    """Markdown."""
    lines = [
        "| picture | draws | focal length off % | 95 % region holds % | places off, median % of the distance |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, draws in found.items():
        pairs = [draw[0][:2] for draw in draws] if "one camera" in name else [one[:2] for draw in draws for one in draw]
        places = [off for draw in draws for _, _, some in draw for off, _, _ in some]
        off, inside = (np.array(column) for column in zip(*pairs, strict=True))
        numbers = f"{100 * np.median(off):.0f} | {100 * np.mean(inside):.0f} | {100 * np.median(places):.0f}"
        lines.append(f"| {name} | {len(pairs)} | {numbers} |")
    return "\n".join(lines)


def status_table(found: dict[str, list[list[Focal]]]) -> str:
    """Markdown."""
    lines = [
        "| status | cars | places off by more than 20 % of the distance, % | 95 % region of the place holds % |",
        "|---|---:|---:|---:|",
    ]
    places = [place for draws in found.values() for draw in draws for _, _, some in draw for place in some]
    for status in dict.fromkeys([*(status.value for status in Status), "refused"]):
        own = [(off > _WRONG, inside) for off, inside, ended in places if ended == status]
        if own:
            wrong, inside = 100 * np.mean(own, axis=0)
            lines.append(f"| {status} | {len(own)} | {wrong:.0f} | {inside:.0f} |")
    return "\n".join(lines)


Roadside = tuple[float, float, list[Place]]
"""Tilt of the ground in degrees, error of the camera's height (share), and what is off of the places."""


def roadside_draw(rng: np.random.Generator, *, ground: Ground | None, fleet: str | None) -> Roadside:
    """Six cars from a camera of known lens, 6 m up, 15 degrees down, rolled by up to 5."""
    camera = Camera(np.array([[1100.0, 0.0, 639.5], [0.0, 1100.0, 479.5], [0.0, 0.0, 1.0]]), image_size=_SIZE)
    seen, places, normal = picture(6, camera, _ROADSIDE, rng)
    scene = reconstruct_scene(seen, camera, ground=ground, size_prior=fleet)
    if scene.ground is None:
        return FAILURE_DEGREES, np.inf, places_off(scene, places)
    tilt = float(np.degrees(np.arccos(np.clip(scene.ground.normal @ normal, -1.0, 1.0))))
    return tilt, abs(scene.ground.distance / _ROADSIDE.height - 1.0), places_off(scene, places)


_HEIGHT = Ground.of_height(_ROADSIDE.height)
ROADSIDE_ROWS: dict[str, Callable[[np.random.Generator], Roadside]] = {
    "nothing": lambda rng: roadside_draw(rng, ground=None, fleet=None),
    "the height": lambda rng: roadside_draw(rng, ground=_HEIGHT, fleet=None),
    "the fleet": lambda rng: roadside_draw(rng, ground=None, fleet="kitti"),
    "height and fleet": lambda rng: roadside_draw(rng, ground=_HEIGHT, fleet="kitti"),
}
"""Draws by what is given; each begins with the same numbers, so all are the same pictures."""


def roadside_table(found: dict[str, list[Roadside]]) -> str:
    """Markdown."""
    lines = [
        "| given | draws | places off, median % of the distance | tilt off, median ° | within 1° % | height off % |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, draws in found.items():
        tilt, height = np.array([draw[:2] for draw in draws]).T
        places = [off for draw in draws for off, _, _ in draw[2]]
        numbers = f"{100 * np.median(places):.1f} | {np.median(tilt):.2f} | {100 * np.mean(tilt <= 1.0):.0f}"
        lines.append(f"| {name} | {len(draws)} | {numbers} | {100 * np.median(height):.1f} |")
    return "\n".join(lines)


def drawn(rows: dict[str, Callable[[np.random.Generator], T]], draws: int) -> dict[str, list[T]]:
    """So many draws of each row."""
    found = {}
    for name, one in rows.items():
        found[name] = [one(np.random.default_rng(seed)) for seed in range(draws)]
        print(f"{name}: {draws} draws", file=sys.stderr)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of the real data")
    parser.add_argument("--photographs", type=int, default=200, help="how many")
    parser.add_argument("--draws", type=int, default=100, help="of each simulated row")
    parser.add_argument("--json", type=Path, help="file for every number")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    found: dict[str, object] = {}
    if given.data is not None:
        try:
            rows = photographs(given.data, given.photographs)
        except FgreconError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        found["photographs"] = rows
        print(photographs_table(rows), "\n", sep="\n")
    found["focal"] = focal = drawn(FOCAL_ROWS, given.draws)
    print(focal_table(focal), "\n", status_table(focal), "\n", sep="\n")
    found["roadside"] = roadside = drawn(ROADSIDE_ROWS, given.draws)
    print(roadside_table(roadside))
    if given.json is not None:
        write_text(given.json, json.dumps(found) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
