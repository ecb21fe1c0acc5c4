"""Cars of known shape to look at: those that came out best, in the middle and worst."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.paper.apollocar3d import MarkedCars
from fgrecon.paper.known_shape import BASIS, KNOWN_SHAPE_OPTIONS, KNOWN_SHAPE_ROWS, KnownShapeScores
from fgrecon.solve.pipeline import reconstruct
from fgrecon.training.priors.apollo79 import Apollo79, apollo79_prior

__all__ = ["ExampleCar", "example_cars"]

_EACH = 3
_ROW = KNOWN_SHAPE_ROWS.index("joint")


@dataclass(frozen=True, eq=False)
class ExampleCar:
    """A car with its result and the truth.

    Attributes:
        place: `best`, `median` or `worst`.
        name: Of the car, `<image>:<position in the image>`.
        observation: The marks.
        camera: The camera.
        result: The reconstruction from them, by a prior that has not learnt from the car's model.
        camera_T_object: (4, 4) true pose.
        size: (3,) true length, width and height, metres.
        shape: (14, 3) true keypoints, object frame, metres.
    """

    place: str
    name: str
    observation: Observation
    camera: Camera
    result: Reconstruction
    camera_T_object: NDArray[np.float64]
    size: NDArray[np.float64]
    shape: NDArray[np.float64]


def example_cars(cars: MarkedCars, models: Apollo79, scores: KnownShapeScores) -> tuple[ExampleCar, ...]:
    """Three cars each of the smallest, the median and the largest keypoint error of the row `joint`, solved again.

    Args:
        cars: The cars.
        models: The 79 models.
        scores: Their scores. A car that failed counts as worst, and one whose solving fails is left out.
    """
    order = np.argsort(scores.keypoint[:, _ROW], kind="stable").tolist()
    each = min(_EACH, len(order) // 3)
    middle = (len(order) - each) // 2
    chosen = {"best": order[:each], "median": order[middle : middle + each], "worst": order[len(order) - each :]}
    by_name = {car.name: car for car in cars.cars}
    found = []
    for place, indices in chosen.items():
        for index in indices:
            car = by_name[scores.names[index]]
            marked = np.isfinite(car.keypoints[:, 0]).astype(np.float64)
            prior = apollo79_prior(models, basis=BASIS, exclude=[car.model])
            try:
                result = reconstruct(
                    *(car.keypoints, cars.camera),
                    confidence=marked,
                    box=car.box,
                    prior=prior,
                    options=KNOWN_SHAPE_OPTIONS,
                )
            except FgreconError:
                continue
            seen = Observation(car.keypoints, marked, box=car.box)
            pose = car.camera_T_object
            found.append(ExampleCar(place, car.name, seen, cars.camera, result, pose, car.size, car.shape))
    return tuple(found)
