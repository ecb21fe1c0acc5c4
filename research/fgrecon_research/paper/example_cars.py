"""Cars of known shape to look at: those that came out best, in the middle and worst."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon_research.paper.apollocar3d import MarkedCar, MarkedCars
from fgrecon_research.paper.known_shape import BASIS, KNOWN_SHAPE_OPTIONS, car_errors
from fgrecon_research.training.priors.apollo79 import Apollo79, apollo79_prior

_EACH = 3


@dataclass(frozen=True, eq=False)
class ExampleCar:
    """A car with its result and the truth."""

    place: str  # `best`, `median` or `worst`
    name: str  # of the car, `<image>:<position in the image>`
    observation: Observation  # the marks
    camera: Camera
    result: Reconstruction  # the reconstruction from them, by a prior that has not learnt from the car's model
    camera_T_object: NDArray[np.float64]  # (4, 4) true pose
    size: NDArray[np.float64]  # (3,) true length, width and height, metres
    shape: NDArray[np.float64]  # (14, 3) true keypoints, object frame, metres


def example_cars(cars: MarkedCars, models: Apollo79) -> tuple[ExampleCar, ...]:
    """Three cars each of the smallest, the median and the largest error of their keypoints in the camera frame.

    Args:
        cars: The cars; all are solved. One that fails is left out.
        models: The 79 models.
    """
    found: list[tuple[float, ExampleCar]] = []
    for model in sorted({car.model for car in cars.cars}):
        prior = apollo79_prior(models, basis=BASIS, exclude=[model])
        for car in (car for car in cars.cars if car.model == model):
            if (example := _solved(car, cars.camera, prior)) is not None:
                result = example.result
                found.append((car_errors(car, result.camera_T_object, result.wireframe)[2], example))
    ordered = [example for _, example in sorted(found, key=lambda pair: pair[0])]
    each = min(_EACH, len(ordered) // 3)
    middle = (len(ordered) - each) // 2
    places = {"best": 0, "median": middle, "worst": len(ordered) - each}
    return tuple(replace(one, place=place) for place, at in places.items() for one in ordered[at : at + each])


def _solved(car: MarkedCar, camera: Camera, prior: ShapePrior) -> ExampleCar | None:
    marked = np.isfinite(car.keypoints[:, 0]).astype(np.float64)
    try:
        result = reconstruct(
            car.keypoints, camera, confidence=marked, box=car.box, prior=prior, options=KNOWN_SHAPE_OPTIONS
        )
    except FgreconError:
        return None
    seen = Observation(car.keypoints, marked, box=car.box)
    found = np.isfinite(result.camera_T_object).all()
    return ExampleCar("", car.name, seen, camera, result, car.camera_T_object, car.size, car.shape) if found else None
