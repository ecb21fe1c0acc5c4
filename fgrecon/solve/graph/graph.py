"""Factor graph of all that is solved together: observations of vehicles in images, and the caller's own factors.

One image of one car is the smallest case: a `VehiclePart`, an `ObservationPart`. Further images of the car add
observation parts on the same vehicle part; further cars add both. Factors of the caller's own tie any of their
variables: X(v, t), L(v), O(v) of `factors.keys`, vehicles and images numbered from 0.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import gtsam
import numpy as np

from factors import check_in_front
from factors.guard import CompiledFactor
from factors.keys import F, S, decode_key, key_name
from factors.mixture import Form
from factors.sensed import SensedFactor
from factors.surface_points import SurfacePointsFactor
from factors.system import CompiledSystem, MixedSystem, Point, system_of
from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import Options
from fgrecon.solve.graph.observation_part import ObservationPart, Weights
from fgrecon.solve.graph.sensed_part import SharedErrors, common_factor, sensed_of
from fgrecon.solve.graph.vehicle_part import ShapeValues, Terms, VehiclePart, is_any_fleets, vehicle_part
from fgrecon.solve.proposals.problem import Problem

__all__ = ["EXTRA", "Graph", "GraphObservation", "State", "Terms", "common_share"]


EXTRA, GROUND = "extra", "ground"
"""Energy term of the caller's own factors."""


@dataclass(frozen=True)
class GraphObservation:
    """One vehicle in one image, and its place in the graph.

    Attributes:
        problem: What is given.
        vehicle: Number of the vehicle.
        image: Number of the image.
    """

    problem: Problem
    vehicle: int = 0
    image: int = 0


@dataclass
class State:
    """Where an optimisation is: a pose and weights for each observation, a shape for each vehicle.

    Attributes:
        poses: camera_T_object of each observation.
        shapes: Lambda (N,) and offsets (K, 3) by the number of the vehicle.
        weights: Weights of each observation.
        others: Values of variables that are neither: those of factors beside the vehicles', such as the ground's.
    """

    poses: list[gtsam.Pose3]
    shapes: dict[int, ShapeValues]
    weights: list[Weights]
    others: gtsam.Values = field(default_factory=gtsam.Values)


def common_share(images: int, options: Options) -> float:
    """Share of its information that each of so many images of one vehicle has for the graph; 1 for a single one."""
    return 1.0 / (1.0 + (images - 1) * options.shape.common_error)


class Graph:
    """Builds the factors for given weights; everything that does not depend on them is built once.

    Attributes:
        observations: A part for each observation.
        vehicles: A part for each vehicle, by number.
        extra: The caller's own factors.
        sensed: What other sensors say of all observations, matched anew by `reweigh`.
        options: Settings.
    """

    def __init__(
        self,
        observations: Sequence[GraphObservation],
        state: State,
        *,
        pose_free: bool,
        hold_shape: bool = False,
        extra: Sequence[gtsam.NonlinearFactor] = (),
        earlier: int = 0,
    ) -> None:
        """Prepare the graph.

        Args:
            observations: At least one observation.
            state: Where it starts: constants are taken from there.
            pose_free: Whether the poses are variables.
            hold_shape: Whether the shapes are constants.
            extra: The caller's own factors; those on variables that are held are left out, unless they always are.
            earlier: How many images of each vehicle there are beside these.

        Raises:
            InvalidInputError: A factor of the caller's own has a key of no variable, or is of another type than it.
        """
        self.options: Options = observations[0].problem.options
        self._applied: tuple[Sequence[Weights], Form] | None = None  # what the rows have
        self._system: CompiledSystem | MixedSystem | None = None
        self.vehicles: dict[int, VehiclePart] = {}
        self.observations: list[ObservationPart] = []
        counts = Counter(one.vehicle for one in observations)
        self._more = {number: count - 1 + earlier for number, count in counts.items()}  # images beside one of its own
        for one, pose in zip(observations, state.poses, strict=True):
            if one.vehicle not in self.vehicles:
                model, number = one.problem.model, one.vehicle
                if hold_shape:
                    self.vehicles[number] = VehiclePart(model, self.options, number, held=state.shapes[number])
                else:
                    of_fleet = state.others.exists(S()) and is_any_fleets(model, self.options)
                    self.vehicles[number] = vehicle_part(model, self.options, number, of_fleet=of_fleet)
            vehicle = self.vehicles[one.vehicle]
            share = common_share(1 + self._more[one.vehicle], self.options)
            self.observations.append(
                ObservationPart(
                    one.problem,
                    vehicle,
                    pose,
                    pose_free=pose_free,
                    image=one.image,
                    share=share,
                    focal_free=state.others.exists(F(one.image)),
                )
            )
        self.shared = SharedErrors(self.observations, free=pose_free and not hold_shape)
        parts = enumerate(self.observations)
        each = [(i, found, found.factor()) for i, part in parts for found in sensed_of(part, self.shared)]
        each.sort(key=lambda one: not one[1].judges)  # those of compiled rows first
        self._judging = sum(found.judges for _, found, _ in each)
        self.sensed: list[SensedFactor] = [found for _, found, _ in each]
        self._sensed_factors = [factor for _, _, factor in each]
        self._sensed_by = [index for index, _, _ in each]
        self._own_keys = {part.pose_key for part in self.observations if part.pose_key is not None}
        self._own_keys |= {key for vehicle in self.vehicles.values() for key in vehicle.keys}
        keys = self._own_keys | set(state.others.keys()) | self.shared.known.keys()
        self.extra = [factor for factor in extra if keys.issuperset(factor.keys())]
        if extra and not hold_shape and (pose_free or not self.options.shape.joint):
            _check_extra(extra, self.values(state))

    def values(self, state: State) -> gtsam.Values:
        """Values of every variable."""
        values = gtsam.Values()
        for part, pose in zip(self.observations, state.poses, strict=True):
            if part.pose_key is not None:
                values.insert(part.pose_key, pose)
        for number, vehicle in self.vehicles.items():
            vehicle.insert(values, *state.shapes[number])
        values.insert(state.others)
        self.shared.insert_missing(values)
        return values

    def read(self, values: gtsam.Values, weights: Sequence[Weights]) -> State:
        """The state at the values."""
        poses = [part.pose(values) for part in self.observations]
        shapes = {number: vehicle.read(values) for number, vehicle in self.vehicles.items()}
        others = gtsam.Values(values)
        for key in self._own_keys:
            others.erase(key)
        return State(poses, shapes, list(weights), others)

    def alone(self, index: int, values: gtsam.Values, weights: Sequence[Weights]) -> tuple[Graph, State]:
        """The graph of one observation's pose with everything else held at the values, and its state there."""
        part = self.observations[index]
        number = part.vehicle.number
        state = State([part.pose(values)], {number: part.vehicle.read(values)}, [weights[index]])
        one = GraphObservation(part.problem, number, part.image)
        more = self._more[number]
        return Graph([one], state, pose_free=True, hold_shape=True, extra=self.extra, earlier=more), state

    def check_in_front(self, values: gtsam.Values, point: Point = None) -> None:
        """Refuse values with keypoints behind a camera.

        Args:
            point: The point of `system` there, where it is known.

        Raises:
            DegenerateProblemError: There are some.
        """
        if not (
            self._judges and math.isfinite(self.error(self.system(values).point(values) if point is None else point))
        ):
            for part in self.observations:
                check_in_front(part.kernel, values)

    def points_of(self, index: int, name: str | None = None) -> tuple[Array, Array]:
        """The measured points (M, 3) of an observation, and their weights (M,) where they were looked at last.

        `name` is what measured them; None for all.
        """
        every = zip(self.sensed, self._sensed_by, strict=True)
        own = [one for one, by in every if by == index and isinstance(one, SurfacePointsFactor)]
        own = [one for one in own if name in (None, one.name)]
        points = np.concatenate([np.zeros((0, 3)), *(one.points for one in own)])
        return points, np.concatenate([np.zeros(0), *(one.weights for one in own)])

    def names_of(self, index: int) -> set[str]:
        """Names of what other sensors say of an observation."""
        return {one.name for one, by in zip(self.sensed, self._sensed_by, strict=True) if by == index}

    @property
    def is_robust(self) -> bool:
        """Whether one solve finds the minimum of the robust energy: its losses are inside the factors."""
        return all(part.is_robust for part in self.observations)

    def reweigh(
        self, values: gtsam.Values, before: Sequence[Weights], progress: float, *, hold: bool = False
    ) -> list[Weights]:
        """Weights of every observation at the values; see `ObservationPart.reweigh`.

        Args:
            values: Where.
            before: The weights until now.
            progress: 0 at the first update, 1 at the last.
            hold: Keep visibility and the ground's uncertainty of all observations.
        """
        return self.reweigh_at(self.system(values).point(values), before, progress, hold=hold)

    def reweigh_at(
        self,
        point: Point,
        before: Sequence[Weights],
        progress: float = 1.0,
        *,
        hold: bool = False,
        held: Collection[int] = (),
    ) -> list[Weights]:
        """The same at a point of `system`; `held` are indices of observations of which they are kept in any case."""
        assert self._system is not None
        looks = [not (hold or i in held) for i in range(len(self.observations))]
        if not self._judges:
            values = self._system.values(point)
            self.look(values, hold=hold)
            return [
                part.reweigh(values, weights, progress, hold=not look)
                for part, weights, look in zip(self.observations, before, looks, strict=True)
            ]
        form = Form.NEWTON if self._applied is None else self._applied[1]
        self._tell(before, form)
        found = self._system.judge(point, [*looks, *[not hold] * self._judging])
        weights = [
            part.judged(one, None if look else w)
            for part, one, look, w in zip(self.observations, found, looks, before, strict=False)
        ]
        for one, judged in zip(self.sensed, found[len(looks) :], strict=False):
            one.judged(judged)
        if others := self.sensed[self._judging :]:
            values = self._system.values(point)
            for one in others:
                one.look(values, hold=hold)
        self._applied = weights, form
        return weights

    @property
    def _observed(self) -> list[gtsam.NonlinearFactor]:
        return [part.factor for part in self.observations if part.factor is not None]

    @property
    def _own(self) -> list[gtsam.NonlinearFactor]:
        own = [factor for vehicle in self.vehicles.values() for factor in vehicle.solved]
        return [*own, *self.shared.priors]

    def system(self, values: gtsam.Values) -> CompiledSystem | MixedSystem:
        """All factors of its variables; made once."""
        if self._system is None:
            observed = [part.compiled or part.factor for part in self.observations if part.keys]
            every = [*observed, *self._sensed_factors, *self.extra, *self._own]
            rows, vehicle = self.observations[0].compiled, self.observations[0].vehicle
            if rows is not None and len(every) == 1 + len(vehicle.solved) and every[0] is rows:
                self._system = vehicle.system_with(rows, values)
            else:
                self._system = system_of(every, values)
        return self._system

    @cached_property
    def _judges(self) -> bool:
        return all(part.judges for part in self.observations)

    def _tell(self, weights: Sequence[Weights], form: Form) -> None:
        """Set weights, unless they are set."""
        if self._applied is not None and self._applied[0] is weights and self._applied[1] is form:
            return
        for part, weight in zip(self.observations, weights, strict=True):
            if self._judges:
                part.see(weight, form)
            else:
                part.tell(weight, form)
        for one in self.sensed:
            one.tell(form)
        self._applied = weights, form

    def step(self, point: Point, weights: Sequence[Weights], form: Form) -> tuple[Array, Callable[[], float]]:
        """The step of `system` at a point of it, and what tells their energy as `error` has it, nats.

        Args:
            point: Where.
            weights: Weights of each observation.
            form: How a mixture is handed to the solver: with these weights, or with its loss and curvature.

        Raises:
            RuntimeError: A direction that nothing determines.
        """
        assert self._system is not None
        self._tell(weights, form)
        return self._system.step(point)

    def error(self, point: Point) -> float:
        """Energy of all factors with the weights that were set last, nats: what a step is judged by.

        It differs from the sum of the terms' by what does not change as long as visibility does not.
        """
        assert self._system is not None
        return self._system.error(point)

    def error_of(self, factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> float:
        """Energy of some of the extra factors at the values, nats."""
        system = self.system(values)
        return system.error_of(factors, system.point(values))

    def look(self, values: gtsam.Values, *, hold: bool = False) -> None:
        """Match what other sensors say at the values, and weigh it; `hold` keeps what it is matched to."""
        for one in self.sensed:
            one.look(values, hold=hold)

    def build(
        self, weights: Sequence[Weights], form: Form = Form.WEIGHTED, *, for_covariances: bool = False
    ) -> gtsam.NonlinearFactorGraph:
        """All factors as GTSAM has them, with these weights until others are set.

        Args:
            weights: Weights of each observation.
            form: How a mixture is handed to the solver: with these weights, or with its loss and curvature.
            for_covariances: Whether what other sensors say counts as it does for covariances.
        """
        self._applied = None
        for part, weight in zip(self.observations, weights, strict=True):
            part.tell(weight, form)
        for one in self.sensed:
            one.tell(form, common_factor(one) if for_covariances else 1.0)
        graph = gtsam.NonlinearFactorGraph()
        for factor in [*self._observed, *self._own, *self._sensed_factors, *self.extra]:
            graph.add(factor)
        return graph

    def weighted(
        self, values: gtsam.Values, weights: Sequence[Weights], *, silent: str | None = None
    ) -> CompiledSystem | MixedSystem:
        """The factors of `build` for covariances, with these weights until others are set.

        What other sensors say by the `silent` name counts for nothing.
        """
        self._applied = None
        for part, weight in zip(self.observations, weights, strict=True):
            part.tell(weight, Form.WEIGHTED)
        for one in self.sensed:
            one.tell(Form.WEIGHTED, math.inf if one.name == silent else common_factor(one))
        return self.system(values)

    def terms(self, weights: Sequence[Weights]) -> Iterator[tuple[str, list[gtsam.NonlinearFactor]]]:
        """Name and factors of each term, observation by observation, then vehicle by vehicle, then the extra ones."""
        for part, weight in zip(self.observations, weights, strict=True):
            yield from part.terms(weight).items()
        for vehicle in self.vehicles.values():
            yield from vehicle.terms.items()
        for name in dict.fromkeys(one.name for one in self.sensed):
            pairs = zip(self.sensed, self._sensed_factors, strict=True)
            yield name, [factor for one, factor in pairs if one.name == name]
        yield from self.shared.terms.items()
        if self.extra:
            yield EXTRA, self.extra

    def own_energies(self, values: gtsam.Values) -> dict[str, float]:
        """Energy of the terms that belong to no single observation, nats."""
        energies: dict[str, float] = {}
        for vehicle in self.vehicles.values():
            for name, energy in vehicle.energies(values):
                energies[name] = energies.get(name, 0.0) + energy
        for one in self.sensed:
            energies[one.name] = energies.get(one.name, 0.0) + one.energy(values)
        for name, priors in self.shared.terms.items():
            energies[name] = sum(prior.error(values) for prior in priors)
        if self.extra:
            energies[EXTRA] = sum(factor.error(values) for factor in self.extra)
        return energies

    def shares_nothing(self, index: int) -> bool:
        """Whether no other observation shows the vehicle of one."""
        return not self._more[self.observations[index].vehicle.number]

    def energies_of(self, index: int, values: gtsam.Values, weights: Weights) -> dict[str, float]:
        """Energy of each term about one observation, nats: also about its vehicle, where no other one shows that.

        Extra factors that tie it to the ground are the term `ground`; what ties two vehicles is told of both.
        """
        part = self.observations[index]
        energies = dict(part.energies(values, weights))
        if not self.shares_nothing(index):
            return energies
        energies |= part.vehicle.energies(values)
        for one in (one for one, by in zip(self.sensed, self._sensed_by, strict=True) if by == index):
            energies[one.name] = energies.get(one.name, 0.0) + one.energy(values)
        own = [self._extra_by_key.get(key, set()) for key in (part.pose_key, *part.vehicle.keys) if key is not None]
        for number in sorted(set[int]().union(*own)):
            factor = self.extra[number]
            letters = [decode_key(key).letter for key in list(factor.keys())]
            name = GROUND if "G" in letters else EXTRA
            energies[name] = energies.get(name, 0.0) + factor.error(values)
        return energies

    @cached_property
    def _extra_by_key(self) -> dict[int, set[int]]:
        """The numbers of the extra factors on each variable."""
        found: dict[int, set[int]] = {}
        for number, factor in enumerate(self.extra):
            for key in list(factor.keys()):
                found.setdefault(key, set()).add(number)
        return found

    def energies(self, values: gtsam.Values, weights: Sequence[Weights]) -> dict[str, float]:
        """Energy of each term over everything, nats; see `ObservationPart.energies`."""
        total: dict[str, float] = {}
        for part, weight in zip(self.observations, weights, strict=True):
            for name, energy in part.energies(values, weight).items():
                total[name] = total.get(name, 0.0) + energy
        return total | self.own_energies(values)

    def energy(self, values: gtsam.Values, weights: Sequence[Weights]) -> float:
        """The sum of `energies`, nats."""
        return sum(self.energies(values, weights).values())

    def read_energies(self, values: gtsam.Values, weights: Sequence[Weights]) -> Callable[[], dict[str, float]]:
        """What tells `energies` here: made when first read, at once where other sensors are matched anew elsewhere."""
        read = cache(lambda: self.energies(values, weights))
        if self.sensed:
            read()
        return read


def _check_columns(number: int, factor: gtsam.CustomFactor, values: gtsam.Values) -> None:
    """Refuse a Jacobian of other columns than its variables have dimensions, with which GTSAM computes something."""
    linear = factor.linearize(values)
    dims = values.dims()
    keys = list(factor.keys())
    wanted, columns = sum(dims[key] for key in keys), linear.jacobian()[0].shape[1]
    if columns != wanted:
        named = ", ".join(f"{key_name(key)} {dims[key]}" for key in keys)
        fix = f"Give as many as its variables have dimensions, {wanted}: {named}."
        raise InvalidInputError(f"extra_factors[{number}]", f"a Jacobian of {columns} columns", fix)


def _check_extra(factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values) -> None:
    """Refuse a caller's own factors that do not fit the variables at these values.

    Raises:
        InvalidInputError: A key is no variable's, or a factor is of another type or size than its variables.
    """
    known = set(values.keys())
    if unknown := {key for factor in factors for key in list(factor.keys())} - known:
        names, variables = (", ".join(sorted(map(key_name, keys))) for keys in (unknown, known))
        fix = f"The graph has {variables}; `factors` has functions that make these keys."
        raise InvalidInputError("extra_factors", f"variables {names}", fix)
    for number, factor in enumerate(factors):
        if isinstance(factor, gtsam.CustomFactor):  # a callback's errors are the caller's own
            if not isinstance(factor, CompiledFactor):
                _check_columns(number, factor, values)
            continue
        try:
            factor.linearize(values)
        except (RuntimeError, ValueError) as error:
            keys = ", ".join(key_name(key) for key in list(factor.keys()))
            fix = f"Give one of the type and size of these variables: {error}"
            raise InvalidInputError(f"extra_factors[{number}]", f"{type(factor).__name__} on {keys}", fix) from error
