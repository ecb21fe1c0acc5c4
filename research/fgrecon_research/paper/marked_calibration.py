"""Accuracy of people's marks, fitted so that regions hold, and tested elsewhere: ApolloCar3D.

Pose, size and keypoints of its cars are known. The standard deviation of a mark is fitted to the cars of one half of
the images and tested on the other half, and the other way round; the prior of a car has not learnt from its model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgrecon.calibration.detector_fit import holding
from fgrecon.core.coverage import SIGMAS, coverage
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon_research.evaluation.calibration import Calibration, Judged, calibrate, judge_known
from fgrecon_research.paper.apollocar3d import MarkedCar, MarkedCars, image_half
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_OPTIONS
from fgrecon_research.training.priors.apollo79 import Apollo79, apollo79_prior

NOISES = (0.01, 0.015, 0.02, 0.025, 0.035)
"""Standard deviations of a mark that are tried, as fractions of the box's longer side; what is fitted lies between."""

_BASIS = 5  # as the shipped prior


@dataclass(frozen=True)
class MarkedCalibration:
    """What was fitted to either half of the images, and what results of the other half say of themselves with it."""

    sigma_relative: tuple[float, float]  # fitted to the first and to the second half
    calibration: Calibration  # of all cars, each with what was fitted without its half
    failures: tuple[str, ...]  # why cars could not be reconstructed, by their names


def halves(cars: Sequence[MarkedCar]) -> tuple[list[MarkedCar], list[MarkedCar]]:
    """The cars of two halves of the images, by a hash of the images' names."""
    parts: tuple[list[MarkedCar], list[MarkedCar]] = [], []
    for car in cars:
        parts[image_half(car.name)].append(car)
    return parts


def calibrate_marked(
    cars: MarkedCars, models: Apollo79, advance: Callable[[int, int], None] = lambda *_: None
) -> MarkedCalibration:
    """Fit the marks' noise to each half of the images, and judge the other half's results with it.

    Raises:
        InvalidInputError: All cars are in one half of the images.
    """
    parts = halves(cars.cars)
    if not all(parts):
        raise InvalidInputError("cars", f"{len(cars.cars)} in one half of the images", "Give more images.")
    solver = _Solver(cars, models, advance)
    fitted = _fitted(solver, parts[0]), _fitted(solver, parts[1])
    solver.failures.clear()
    judged = [one for part, sigma in zip(parts, fitted[::-1], strict=True) for one in solver.judge(part, sigma)]
    return MarkedCalibration(fitted, calibrate(judged), tuple(solver.failures))


class _Solver:
    """Reconstructs and judges cars; keeps the priors."""

    def __init__(self, cars: MarkedCars, models: Apollo79, advance: Callable[[int, int], None]) -> None:
        self.camera, self.models, self.advance = cars.camera, models, advance
        self.count, self.done = len(cars.cars) * (len(NOISES) + 1), 0
        self.priors: dict[str, ShapePrior] = {}
        self.failures: list[str] = []

    def judge(self, cars: Sequence[MarkedCar], sigma: float) -> list[Judged]:
        """What results say of themselves where marks are known to a fraction of the box."""
        options = replace(KNOWN_SHAPE_OPTIONS, keypoints=KeypointOptions(sigma_relative=sigma), keep_history=False)
        judged = []
        for car in cars:
            try:
                judged.append(self._one(car, options))
            except FgreconError as error:
                self.failures.append(f"{car.name}: {error}")
            self.done += 1
            self.advance(self.done, self.count)
        return judged

    def _one(self, car: MarkedCar, options: Options) -> Judged:
        if car.model not in self.priors:
            self.priors[car.model] = apollo79_prior(self.models, basis=_BASIS, exclude=[car.model])
        result = reconstruct(car.observation, self.camera, prior=self.priors[car.model], options=options)
        return judge_known(result, car.camera_T_object, car.size, car.shape, car.name.partition("_")[0])


def _fitted(solver: _Solver, cars: Sequence[MarkedCar]) -> float:
    """The marks' noise at which regions hold as much as they claim, on the mean over quantities and levels."""
    curves: dict[tuple[str, float], list[float]] = {}
    for sigma in NOISES:
        for one in coverage([region for car in solver.judge(cars, sigma) for region in car.regions]):
            for level in SIGMAS:
                curves.setdefault((one.quantity, level), []).append(one.inside[level]["claimed"])
    complete = [np.array(shares) for shares in curves.values() if len(shares) == len(NOISES)]
    if not complete:
        raise InvalidInputError("cars", "none that can be reconstructed", "Give cars with more marks.")
    return holding(NOISES, complete)
