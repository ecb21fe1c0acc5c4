"""Errors of pose and shape where both are known: marked cars, each left out of the prior that fits it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.options import BoxModel, KeypointOptions, Options, ShapeOptions
from fgrecon.core.processes import processes
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category
from fgrecon.solve.vehicle.conditioning import given_size, learn_size_relation
from fgrecon_research.evaluation.measures import keypoint_error, rotation_error
from fgrecon_research.evaluation.methods import load_sqpnp
from fgrecon_research.paper.apollocar3d import MarkedCar, MarkedCars, image_half, marking_offsets
from fgrecon_research.paper.stages import stages
from fgrecon_research.training.priors.apollo79 import Apollo79, apollo79_prior, kept_models

_Result = tuple[Array, list[str]]  # scores (R, 3) of one car, and why rows failed

BASIS = 14
"""Basis vectors of the priors: five, as shipped, leave 2.4 degrees and 4.4 % of the distance where eight leave 2.2 and
4.0 and fourteen 2.2 and 3.8; what comes after these is finer than the marks."""

KNOWN_SHAPE_OPTIONS = Options(
    keypoints=KeypointOptions(sigma_relative=0.015),
    box=BoxModel.OFF,
    shape=ShapeOptions(own_fleet=True),
    keep_history=True,
)
"""Marks are sharper than a network's points (1.9 % of the box about the labelled model, of which a part is the labels'
own error). The boxes are 2 to 3 % too large, and on some cars far off."""

_SIZE_SIGMA = 0.02  # of each dimension: bumpers and lamps differ between cars of one length
_STAGES = ("pose", "shape", "joint")

EACH_MODEL = 10
"""Cars that every model counts for in the prior of the rows `+others`, besides those that there are of it. The two
commonest of 31 models make up a third of the cars, and the frequent ones are longer than the average model; 5 to 40 do
alike."""

KNOWN_SHAPE_ROWS = tuple(
    f"{name}{size}{others}" for size in ("", "+size") for others in ("", "+others") for name in ("sqpnp", *_STAGES)
)
"""SQPnP with the mean shape, and fgrecon after each stage. `+size` knows the car's true length, width and height.
`+others` knows what the cars of all other models tell: where people put their marks (`marking_offsets`) and, where the
size is not given, how frequent each model is."""


@dataclass(frozen=True)
class KnownShapeScores:
    """C cars by R rows (`KNOWN_SHAPE_ROWS`)."""

    names: tuple[str, ...]  # C names of cars, `<image>:<position in the image>`
    distance: Array  # (C,) distance of the car, metres
    marks: NDArray[np.int64]  # (C,) number of marked keypoints
    rotation: Array  # (C, R) angle between estimated and true rotation, degrees; 180 for a failure
    # (C, R) distance between the estimated and true centroid of the keypoints relative to the distance of the true one;
    # infinite for a failure
    translation: Array
    # (C, R) mean distance of the 14 keypoints from the true ones, both about their centroid, in the camera frame,
    # metres; infinite for a failure
    keypoint: Array
    failures: tuple[str, ...]  # why a row failed: `car row: reason`

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(C,) cars of the half of the images, by a hash of their names, that later settings were not chosen on."""
        return np.array([image_half(name) == 1 for name in self.names], dtype=bool)


def score_known_shapes(
    cars: MarkedCars, models: Apollo79, *, workers: int = 1, advance: Callable[[int, int], None] = lambda *_: None
) -> KnownShapeScores:
    """Fit every car with a prior that knows neither it nor, where it has two names, its duplicate.

    Args:
        workers: Number of processes; the result does not depend on it.
    """
    groups = [[c for c in cars.cars if c.model == model] for model in sorted({car.model for car in cars.cars})]
    found: dict[str, _Result] = {}
    advance(0, len(cars.cars))
    with processes(workers) as pool:
        waiting = {
            pool.submit(_score_model, models, cars.camera, group, learnt_from_others(models, cars, group)): group
            for group in groups
        }
        for future in as_completed(waiting):
            found.update(zip((car.name for car in waiting[future]), future.result(), strict=True))
            advance(len(found), len(cars.cars))
    table = np.array([found[car.name][0] for car in cars.cars]).reshape(len(cars.cars), len(KNOWN_SHAPE_ROWS), 3)
    return KnownShapeScores(
        names=tuple(car.name for car in cars.cars),
        distance=np.array([car.distance for car in cars.cars]),
        marks=np.array([car.marks for car in cars.cars], dtype=np.int64),
        rotation=table[..., 0],
        translation=table[..., 1],
        keypoint=table[..., 2],
        failures=tuple(reason for car in cars.cars for reason in found[car.name][1]),
    )


def learnt_from_others(models: Apollo79, cars: MarkedCars, group: Sequence[MarkedCar]) -> tuple[Array, Array]:
    """What all other models' cars tell: how their marks lie (14, 3), and how much each model counts (79,)."""
    others = [car for car in cars.cars if car.model != group[0].model]
    found = Counter(car.model for car in others)
    return (
        marking_offsets(others, cars.camera, load_category("car14")),
        np.array([float(EACH_MODEL + found[name]) for name in models.names]),
    )


def _score_model(
    models: Apollo79, camera: Camera, cars: Sequence[MarkedCar], others: tuple[Array, Array]
) -> list[_Result]:
    """Scores (R, 3) and failures of cars of one model."""
    exclude, size, (offsets, frequency) = [cars[0].model], cars[0].size, others
    prior = apollo79_prior(models, basis=BASIS, exclude=exclude)
    frequent = apollo79_prior(models, basis=BASIS, exclude=exclude, weights=frequency)
    keep = kept_models(models, exclude)
    relation = learn_size_relation(prior, models.keypoints[keep], models.size[keep])
    sized = given_size(prior, SizePrior("the true size", size, _SIZE_SIGMA * size), relation)
    as_modelled = np.zeros_like(offsets)
    variants = [(prior, as_modelled), (frequent, offsets), (sized, as_modelled), (sized, offsets)]
    return [_score_car(car, camera, variants) for car in cars]


def _score_car(car: MarkedCar, camera: Camera, variants: Sequence[tuple[ShapePrior, Array]]) -> _Result:
    """Scores (R, 3) and failures of one car; a variant is a prior and where marks lie relative to its keypoints."""
    rows: list[tuple[float, float, float]] = []
    failures: list[str] = []
    for base, offsets in variants:
        for solve, names in ((_sqpnp, ("sqpnp",)), (_stages, _STAGES)):
            try:
                marked = replace(base, mean=base.mean + offsets)
                rows += [car_errors(car, pose, shape - offsets) for pose, shape in solve(car, camera, marked)]
            except Exception as error:  # noqa: BLE001 - a crash counts like a refusal: wrong, named, never left out
                rows += [(FAILURE_DEGREES, np.inf, np.inf)] * len(names)
                failures.append(f"{car.name} {names[0]}: {type(error).__name__}: {error}")
    return np.array(rows), failures


def _sqpnp(car: MarkedCar, camera: Camera, prior: ShapePrior) -> list[tuple[Array, Array]]:
    return [(load_sqpnp()(prior.mean, car.observation, camera), prior.mean)]


def _stages(car: MarkedCar, camera: Camera, prior: ShapePrior) -> list[tuple[Array, Array]]:
    found = stages(car.observation, camera, prior, KNOWN_SHAPE_OPTIONS)
    return [(found[stage].camera_T_object, found[stage].keypoints) for stage in _STAGES]


def car_errors(car: MarkedCar, camera_T_object: Array, shape: Array) -> tuple[float, float, float]:
    """Rotation in degrees, relative distance, and keypoints in metres, as `KnownShapeScores` has them."""
    points = transform(camera_T_object, shape)
    truth = car.in_camera
    turn = rotation_error(camera_T_object[None, :3, :3], car.camera_T_object[None, :3, :3])[0]
    centre, true_centre = points.mean(axis=0), truth.mean(axis=0)
    away = float(np.linalg.norm(centre - true_centre) / np.linalg.norm(true_centre))
    return float(turn), away, float(keypoint_error(points - centre, truth - true_centre).mean())
