"""Class of a vehicle over time: the likelihoods of its frames are multiplied, as far as they are new.

The shape of a vehicle starts from the mean of one class, so its frames are made anew for another (`with_model`) once
they say something else than what that one was made for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Alternative
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.frame import Frame
from fgrecon.solve.time.time_settings import SETTINGS
from fgrecon.solve.time.vehicle_filter import VehicleFilter
from fgrecon.solve.vehicle.conditioning import express
from fgrecon.solve.vehicle.model import VehicleModel


@dataclass(frozen=True)
class ClassBelief:
    """Probability of each class by its name, by all frames and as the vehicle's model was made for."""

    probability: Mapping[str, float]
    modelled: Mapping[str, float]

    @classmethod
    def first(cls, classes: Mapping[str, float]) -> ClassBelief:
        """By the first frame that says something."""
        return cls(classes, classes)

    def updated(
        self, classes: Mapping[str, float], seconds: float, height: float, odds: Mapping[str, float]
    ) -> ClassBelief:
        """With what a frame says, as far as it counts so soon after the one before, and so small (pixels).

        Args:
            classes: Probability of each class by the frame.
            seconds: Since the frame before.
            height: Of the vehicle, pixels.
            odds: Log weights of classes that are in what every frame says, and count once
                (`fgrecon.solve.fitted_class.FittedClass`).
        """
        least, classes = SETTINGS.least_class_probability, _without(classes, odds)
        weight = min(seconds / SETTINGS.class_correlation_s, 1.0) * min(height / SETTINGS.full_height_px, 1.0)
        both = {
            name: max(before, least) * max(classes.get(name, 0.0), least) ** weight
            for name, before in self.probability.items()
        }
        total = sum(both.values())
        return replace(self, probability={name: value / total for name, value in both.items()})

    @property
    def outdated(self) -> bool:
        """Whether the model was made for something else."""
        off = max(abs(value - self.modelled.get(name, 0.0)) for name, value in self.probability.items())
        return off > SETTINGS.class_change


def _without(classes: Mapping[str, float], odds: Mapping[str, float]) -> Mapping[str, float]:
    """Probabilities without the log weights that some of them were made with."""
    without = {name: classes[name] * math.exp(-weight) for name, weight in odds.items()}
    total, left = sum(classes[name] for name in odds), sum(without.values())
    return {**classes, **{name: total * value / left for name, value in without.items()}}


def with_model(vehicle: VehicleFilter, model: VehicleModel) -> VehicleFilter:
    """The vehicle with all its frames made for another model, each shape as near to what it was as the model has it."""
    frames = {id(frame): _with_model(frame, model) for frame in (*vehicle.past, *vehicle.frames)}
    before = vehicle.frames[-1].problem.model
    return replace(
        vehicle,
        frames=tuple(frames[id(frame)] for frame in vehicle.frames),
        past=tuple(frames[id(frame)] for frame in vehicle.past),
        shape=_shape(vehicle.shape, before, model),
    )


def _with_model(frame: Frame, model: VehicleModel) -> Frame:
    """A frame made for another model."""
    before = frame.problem.model

    def made(problem: Problem) -> Problem:
        other = Problem.of(problem.observation, problem.camera, model, problem.ground, problem.options)
        return replace(other, assumed=problem.assumed)

    def moved(pose: Alternative) -> Alternative:
        return replace(pose, coefficients=_coefficients(pose.coefficients, before, model))

    start = replace(
        frame.start,
        coefficients=_coefficients(frame.start.coefficients, before, model),
        alternatives=tuple(map(moved, frame.start.alternatives)),
    )
    flipped = None if frame.flipped is None else made(frame.flipped)
    return replace(frame, given=made(frame.given), flipped=flipped, start=start, poses=tuple(map(moved, frame.poses)))


def _shape(shape: ShapeValues, before: VehicleModel, model: VehicleModel) -> ShapeValues:
    coefficients, offsets = shape
    return _coefficients(coefficients, before, model), offsets


def _coefficients(coefficients: Array, before: VehicleModel, model: VehicleModel) -> Array:
    """(N,) those of the model's shape that is most like that of the model before."""
    found, _ = express(model.prior, before.prior.keypoints(coefficients)[None])
    return np.clip(found[0], -SETTINGS.farthest_coefficient, SETTINGS.farthest_coefficient)
