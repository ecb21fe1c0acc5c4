"""Class of a vehicle by its image: solved as one of each class, and compared by the energies.

A fleet's vans that are taken for cars come out too near, and draw the ground that they share with all others along.
Where a fleet has several classes (`SizePrior.mixed`), or another program is not sure of which one a vehicle is, it is
solved by itself as each of them first. The differences of the energies are added to what the program says, or else to
how often the classes are: its size is that of the mixture, as sure as that leaves it.

Compared are classes of one shape. Between shapes, such as a prior's and a cuboid, energies say more of the shapes than
of the vehicle (docs/history/size.md): there what the program says counts alone.

Log weights of classes are nats beside the first class of a vehicle, which has none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.observation import Observation
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.image_facing import single_pose
from fgrecon.solve.inputs import SolveSetup
from fgrecon.solve.solve_settings import FITTED_CLASS, SCENE


@dataclass(frozen=True, eq=False, init=False, repr=False)
class FittedClass(VehicleClass):
    """Which class a vehicle is of by an image of it as well.

    Attributes:
        odds: Log weight that each class has where the image says nothing. Those are the same in all images of the
            vehicle, and count once.
    """

    odds: Mapping[str, float] = field(default_factory=dict)

    def __init__(self, probabilities: Mapping[str, float], odds: Mapping[str, float]) -> None:
        """By classes of the package's own."""
        super().__init__(probabilities)
        object.__setattr__(self, "odds", odds)


def with_fitted_classes(
    observations: Sequence[Observation], camera: Camera, setup: SolveSetup, ground: Ground | None
) -> list[Observation]:
    """Observations that know how probably their vehicles are of each class, where that is open.

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
    energies = {name: _energy(observation, camera, setup, name) for name in open_classes(classes, setup)}
    solved = {name: energy for name, energy in energies.items() if energy is not None}
    if len(solved) < 2:
        return observation
    odds, given = odds_before_image([*solved], classes, setup)
    classes = {next(iter(solved)): 1.0} if classes is None else classes
    total = sum(classes.get(name, 0.0) for name in solved)
    known = probabilities(with_energies({name: odds[name] + given[name] for name in odds}, solved), total)
    others = [one for one in observation.evidence if not isinstance(one, VehicleClass)]
    return replace(observation, evidence=(*others, FittedClass({**classes, **known}, odds)))


def open_classes(classes: Mapping[str, float] | None, setup: SolveSetup, *, in_traffic: bool = False) -> list[str]:
    """Names of the classes of which a vehicle may be, the usual one first; none where that is no question.

    Args:
        classes: Probability of each class by other programs; None where they say nothing.
        setup: What holds for all vehicles of the call.
        in_traffic: Whether the classes of a fleet's traffic count where nobody says more.
    """
    if classes is not None:
        alike, least = setup.class_sizes.of_one_shape(classes), FITTED_CLASS.least_probability
        names = [name for name, probability in alike.items() if probability >= least]
    else:
        fleet = setup.fleet
        counted = fleet is not None and (fleet.mixed or (in_traffic and fleet.traffic is not None))
        names = [*fleet.classes] if fleet is not None and counted else []
    return names if len(names) > 1 else []


def odds_before_image(
    names: Sequence[str], classes: Mapping[str, float] | None, setup: SolveSetup
) -> tuple[dict[str, float], dict[str, float]]:
    """Log weights of classes where an image says nothing, and what another program says of them.

    Args:
        names: Of the classes, the first of which the others are beside.
        classes: Probability of each by other programs; None where they say nothing.
        setup: What holds for all vehicles of the call.
    """
    sizes = setup.class_sizes
    odds = {name: sizes.odds[name].fleet for name in names}
    if classes is None:
        return _beside_first(odds), dict.fromkeys(names, 0.0)
    first, least = names[0], FITTED_CLASS.least_probability
    share = {name: max(sizes.share[name], least) for name in names}
    given = {name: math.log(classes[name] / classes[first]) - math.log(share[name] / share[first]) for name in names}
    return _beside_first({name: odds[name] + sizes.odds[name].given for name in names}), given


def with_energies(weights: Mapping[str, float], energies: Mapping[str, float]) -> dict[str, float]:
    """Log weights of classes with what an image says: the least energies of the vehicle as one of each, nats."""
    best, temper, most = min(energies.values()), FITTED_CLASS.energy_temper, FITTED_CLASS.most_nats
    return _beside_first({name: weights[name] + temper * max(best - energies[name], -most) for name in energies})


def probabilities(weights: Mapping[str, float], total: float = 1.0) -> dict[str, float]:
    """Probabilities of classes by their log weights beside the first, which add up to a total."""
    (first, _), *others = weights.items()
    found = {name: total / sum(math.exp(other - own) for other in weights.values()) for name, own in others}
    return {first: max(total - sum(found.values()), 0.0), **found}


def _beside_first(weights: Mapping[str, float]) -> dict[str, float]:
    first = next(iter(weights.values()))
    return {name: weight - first for name, weight in weights.items()}


def _energy(observation: Observation, camera: Camera, setup: SolveSetup, name: str) -> float | None:
    """The least energy, nats, of a vehicle that is of a class; None where it has no pose."""
    model = setup.model_as(name)
    try:
        problem, start = single_pose(observation, camera, model, setup)
    except FgreconError:
        return None
    found = minimise_from_proposals([GraphObservation(problem)], [start], steady=SCENE.single_visibility_step)
    return None if found.optimum.failure is not None else found.optimum.energy
