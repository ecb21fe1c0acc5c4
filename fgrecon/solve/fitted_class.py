"""Whether a vehicle is a car or a van by its image alone: solved as both, and how much better one explains it.

A fleet's vans that are taken for cars come out too near, and draw the ground that they share with all others along.
Where a fleet has vans (`SizePrior.mixed`) each vehicle is solved by itself in either size first. The difference of the
energies is evidence of its class, as another program's is: its size is that of the mixture, as sure as that leaves it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.size_prior import CLASSES
from fgrecon.core.vehicle_class import VehicleClass
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.image_facing import single_pose
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.solve_settings import FITTED_CLASS, SCENE


def with_fitted_classes(
    observations: Sequence[Observation], camera: Camera, setup: SolveSetup, ground: Ground | None
) -> list[Observation]:
    """Observations that know how probably their vehicles are cars and vans, where the fleet has both.

    Those of which somebody says the class already, or which cannot be solved by themselves, are as they were.

    Args:
        observations: Without lens distortion.
        camera: The camera that took the image.
        setup: What holds for all vehicles of the call.
        ground: The ground as it is given, or None.
    """
    if not setup.fits_classes:
        return list(observations)
    alone = replace(setup, ground=ground)
    return [one if _is_classed(one) else _fitted(one, camera, alone) for one in observations]


def _is_classed(observation: Observation) -> bool:
    """Whether somebody says of which class the vehicle is."""
    return any(isinstance(one, VehicleClass) for one in observation.evidence)


def _fitted(observation: Observation, camera: Camera, setup: SolveSetup) -> Observation:
    """An observation that knows of which class its vehicle is."""
    car, van = (_energy(observation, camera, setup, name) for name in ("car", "van"))
    if car is None or van is None:
        return observation
    most = FITTED_CLASS.most_nats
    gain = min(max(car - van, -most), most)
    probability = 1.0 / (1.0 + math.exp(-(FITTED_CLASS.log_odds + FITTED_CLASS.energy_temper * gain)))
    return observation.with_evidence([VehicleClass({"car": 1.0 - probability, "van": probability})])


def _energy(observation: Observation, camera: Camera, setup: SolveSetup, name: str) -> float | None:
    """The least energy, nats, of a vehicle that is of a class; None where it has no pose."""
    model = setup.model_for({one: float(one == name) for one in CLASSES})
    try:
        problem, start = single_pose(observation, camera, model, setup)
    except FgreconError:
        return None
    found = minimise_from_proposals([GraphObservation(problem)], [start], steady=SCENE.single_visibility_step)
    return None if found.optimum.failure is not None else found.optimum.energy
