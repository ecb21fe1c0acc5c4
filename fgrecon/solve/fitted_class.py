"""Whether a vehicle is a car or a van, by its image too: solved as both, and how much better one explains it.

A fleet's vans that are taken for cars come out too near, and draw the ground that they share with all others along.
Where a fleet has vans (`SizePrior.mixed`), or another program is not sure which of the two a vehicle is, it is solved
by itself in either size first. The difference of the energies is added to what the program says, or else to how often
vans are: its size is that of the mixture, as sure as that leaves it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation
from fgrecon.core.vehicle_class import VehicleClass
from fgrecon.io.catalogue import shipped_class_sizes
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.image_facing import single_pose
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.solve_settings import FITTED_CLASS, SCENE


@dataclass(frozen=True, eq=False, init=False, repr=False)
class FittedClass(VehicleClass):
    """Which class a vehicle is of by an image of it as well.

    Attributes:
        odds: Logarithm of the odds of a van against a car that it has where the image says nothing. Those are the same
            in all images of the vehicle, and count once.
    """

    odds: float = 0.0

    def __init__(self, probabilities: Mapping[str, float], odds: float) -> None:
        """By classes of the package's own."""
        super().__init__(probabilities)
        object.__setattr__(self, "odds", odds)


def with_fitted_classes(
    observations: Sequence[Observation], camera: Camera, setup: SolveSetup, ground: Ground | None
) -> list[Observation]:
    """Observations that know how probably their vehicles are cars and vans, where that is open.

    Those of which somebody says the class for sure, or which cannot be solved by themselves, are as they were.

    Args:
        observations: Without lens distortion.
        camera: The camera that took the image.
        setup: What holds for all vehicles of the call.
        ground: The ground as it is given, or None.

    Raises:
        InvalidInputError: A class is none of its scheme.
    """
    alone = replace(setup, ground=ground)
    return [_fitted(one, camera, alone) for one in observations]


def _fitted(observation: Observation, camera: Camera, setup: SolveSetup) -> Observation:
    """An observation that knows of which class its vehicle is."""
    classes = setup.classes_of([observation])
    if not (setup.fits_classes if classes is None else is_open(classes)):
        return observation
    odds, new = odds_before_image(classes)
    classes = {"car": 1.0, "van": 0.0} if classes is None else classes
    car, van = (_energy(observation, camera, setup, name) for name in ("car", "van"))
    if car is None or van is None:
        return observation
    either = classes["car"] + classes["van"]
    probability = either / (1.0 + math.exp(-log_odds_of_van(odds + new, car, van)))
    known = FittedClass({**classes, "car": either - probability, "van": probability}, odds)
    others = [one for one in observation.evidence if not isinstance(one, VehicleClass)]
    return replace(observation, evidence=(*others, known))


def is_open(classes: Mapping[str, float]) -> bool:
    """Whether another program leaves open which of a car and a van a vehicle is."""
    return min(classes["car"], classes["van"]) >= FITTED_CLASS.least_probability


def odds_before_image(classes: Mapping[str, float] | None) -> tuple[float, float]:
    """Log odds of a van against a car where the image says nothing, and of what another program says of it.

    Args:
        classes: Probability of each class by other programs, which is open; None where they say nothing.
    """
    if classes is None:
        return FITTED_CLASS.log_odds, 0.0
    share = shipped_class_sizes().share
    new = math.log(classes["van"] / classes["car"]) - math.log(share["van"] / share["car"])
    return FITTED_CLASS.log_odds + FITTED_CLASS.given_log_odds, new


def log_odds_of_van(odds: float, car: float, van: float) -> float:
    """Log odds of a van against a car with what an image says.

    Args:
        odds: Those without it.
        car: Energy of the vehicle as a car, nats.
        van: And as a van.
    """
    most = FITTED_CLASS.most_nats
    return odds + FITTED_CLASS.energy_temper * min(max(car - van, -most), most)


def _energy(observation: Observation, camera: Camera, setup: SolveSetup, name: str) -> float | None:
    """The least energy, nats, of a vehicle that is of a class; None where it has no pose."""
    model = setup.model_as(name)
    try:
        problem, start = single_pose(observation, camera, model, setup)
    except FgreconError:
        return None
    found = minimise_from_proposals([GraphObservation(problem)], [start], steady=SCENE.single_visibility_step)
    return None if found.optimum.failure is not None else found.optimum.energy
