"""Scenes to draw: simulated streets whose results are the truth, moved a little. No solver is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.sample import GROUND, SampleStreet, SeenCar, sample_street
from fgrecon.viz import DrawnVehicle, Truth
from tests.results import changed
from tests.viz.made_up import Example

__all__ = ["GROUND", "result_of", "shown_of", "street"]


def street(seed: int = 0) -> SampleStreet:
    """Three cars beside a road."""
    return sample_street(load_prior("car14"), seed)


def result_of(example: Example, car: SeenCar, *, status: Status = Status.CONVERGED) -> Reconstruction:
    """The made-up result with a simulated car's pose, 0.3 m to the right, and its shape; it began 3 m ahead."""
    truth = car.truth
    pose, start = truth.camera_T_object.copy(), truth.camera_T_object.copy()
    pose[:3, 3] += (0.3, 0.0, 0.0)
    start[:3, 3] += (0.0, 0.0, 3.0)
    first = replace(
        example.reconstruction.diagnostics.history[0], camera_T_object=start, keypoints=truth.vehicle.keypoints
    )
    return changed(
        example.reconstruction,
        status=status,
        camera_T_object=pose,
        wireframe=truth.vehicle.keypoints,
        surface_vertices=truth.vehicle.vertices,
        surface_faces=truth.vehicle.faces.astype(np.int64),
        pose_covariance=np.diag([1e-3, 2e-3, 1e-3, 0.02, 0.01, 0.2]),
        history=(first,),
    )


def shown_of(example: Example, seen: SampleStreet, *, truth: bool = False) -> list[DrawnVehicle]:
    """The street's cars; the second is ambiguous."""
    vehicles = []
    for number, car in enumerate(seen.cars):
        result = result_of(example, car, status=Status.AMBIGUOUS if number == 1 else Status.CONVERGED)
        known = Truth(car.truth.camera_T_object, result.box_size, car.truth.vehicle.keypoints) if truth else None
        vehicles.append(DrawnVehicle(number, car.truth.box, result, truth=known))
    return vehicles
