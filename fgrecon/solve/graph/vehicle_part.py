"""Part of the graph that a vehicle has once, in however many images it is: its shape, and the terms about it.

    prior --- L(v) ---+-----------+-------------+-----------+
    N(0, I) (lambda)  |           |             |           |
              dimensions   Laplacian    planarity_f    symmetry
                          rectangularity    |             |
                                 |       P(v,f)         M(v)
    offsets' prior --- O(v) -----+          |
                                      ground-parallel

With free offsets O(v) joins L(v) in every term. With a prior that is exactly symmetric and without offsets, symmetry
holds for every lambda, and so does the planarity of every quad made of two mirrored pairs: those terms are constant
zero and are not built.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from threading import get_ident

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors import L, LinearShape, O, fit_plane
from factors.guard import CompiledRows
from factors.keys import S
from factors.native import native
from factors.shape_factor import ShapeContext, ShapeTerm, shape_terms
from factors.shape_prior import spread_prior
from factors.shape_terms import STACKED, ShapeTerms
from factors.system import CompiledSystem, MixedSystem, system_of
from fgrecon.core.arrays import Array
from fgrecon.core.options import Options
from fgrecon.core.robust import StrategyName
from fgrecon.solve.vehicle.model import VehicleModel

Terms = Mapping[str, list[gtsam.NonlinearFactor]]
"""Factors by the name of their energy term."""


class VehiclePart:
    """Variables and terms of one vehicle's shape.

    Attributes:
        model: The prepared prior.
        options: Settings.
        number: Number of the vehicle in the keys.
        shape: The keypoints as a function of lambda and the offsets.
        coefficients: Key of lambda, or its value where it is held.
    """

    def __init__(
        self,
        model: VehicleModel,
        options: Options,
        number: int = 0,
        *,
        held: ShapeValues | None = None,
        of_fleet: bool = False,
    ) -> None:
        """Prepare the part.

        Args:
            held: Lambda (N,) and offsets (K, 3) where the shape is a constant.
            of_fleet: Whether the prior on lambda is about the mean of a fleet S, which is a variable of the graph.
        """
        prior = model.prior
        self.model, self.options, self.number, self.of_fleet = model, options, number, of_fleet
        offsets: int | Array | None
        if held is None:
            self.coefficients: int | Array = L(number) if prior.dimension else np.zeros(0)
            offsets = O(number) if options.shape.free_offsets else None
        else:
            self.coefficients, offsets = held
        self._held = held
        self.shape = LinearShape(prior.mean, prior.basis, self.coefficients, offsets)
        self._planes: dict[int, NDArray[np.intp] | None] = {}  # keypoints to fit each plane to; None: the medial plane
        self._present: dict[str, ShapeTerm] = {}  # registered terms that say something about the vehicle
        if self.shape.keys:
            about, off = self._described(), options.disabled_terms
            self._context = about
            self._present = {t.name: t for t in shape_terms() if t.name not in off and t.applies(about)}
            for term in self._present.values():
                self._planes |= term.planes(about)
        self._made: dict[str, list[gtsam.NonlinearFactor]] = {}
        self._last_system: CompiledSystem | None = None
        self._enclosed: tuple[Array, Array, LinearShape] | None = None
        self._stack = self._stacked()
        self._solved: list[gtsam.NonlinearFactor] = [self._stack.factor()] if self._stack is not None else []
        self._solved += [factor for name in self._others for factor in self._term(name)]

    @property
    def keys(self) -> tuple[int, ...]:
        """Keys of its variables: lambda, the offsets, the planes, as far as they are there."""
        return (*self.shape.keys, *self._planes)

    def enclosed(self, mean: Array, basis: Array) -> LinearShape:
        """The points (P, 3) that a 2D box encloses as a function of lambda; those of the last call are remembered."""
        if self._enclosed is None or self._enclosed[0] is not mean or self._enclosed[1] is not basis:
            self._enclosed = mean, basis, LinearShape(mean, basis, self.coefficients)
        return self._enclosed[2]

    @cached_property
    def size_derivative(self) -> Array:
        """(3, D) derivative of the box's length, width and height by the shape's variables."""
        return np.tensordot(self.model.prior.category.dimension_operator, self.shape.derivative, axes=2)

    @property
    def terms(self) -> Terms:
        """Factors by energy term: one for each thing that is said, as they are shown and tested."""
        return {name: self._term(name) for name in self._present}

    def _term(self, name: str) -> list[gtsam.NonlinearFactor]:
        if name not in self._made:  # on use: what the solver gets is stacked
            self._made[name] = self._present[name].factors(self._context)
        return self._made[name]

    def insert(self, values: gtsam.Values, coefficients: Array, offsets: Array) -> None:
        """Add every variable to the values; planes are fitted to the keypoints."""
        if self.shape.coefficients_key is not None:
            values.insert(self.shape.coefficients_key, coefficients)
        if self.shape.offsets_key is not None:
            values.insert(self.shape.offsets_key, offsets.ravel())
        for key, keypoints in self._planes.items():
            if keypoints is None:
                values.insert(_medial_plane(key))
                continue
            plane = fit_plane(self.shape.points(values)[keypoints])
            free = self.options.shape.plane_penalty is not None
            values.insert(key, plane.planeCoefficients() if free else plane)

    def read(self, values: gtsam.Values) -> ShapeValues:
        """Coefficients (N,) and offsets (K, 3) at the values."""
        if self._held is not None:
            return self._held
        key, offsets_key = self.shape.coefficients_key, self.shape.offsets_key
        coefficients = np.zeros(0) if key is None else values.atVector(key)
        offsets = np.zeros((self.shape.size, 3)) if offsets_key is None else values.atVector(offsets_key).reshape(-1, 3)
        return coefficients, offsets

    @property
    def solved(self) -> Sequence[gtsam.NonlinearFactor]:
        """The factors of all terms as the solver gets them: the stacked ones in one."""
        return self._solved

    def system_with(self, rows: CompiledRows, values: gtsam.Values) -> CompiledSystem | MixedSystem:
        """The system of one image's rows and its terms: the last one, where its rows are of the same variables."""
        system: CompiledSystem | MixedSystem | None = self._last_system and self._last_system.with_rows(rows)
        if system is None:
            system = system_of([rows, *self._solved], values)
            self._last_system = system if isinstance(system, CompiledSystem) else None
        return system

    @cached_property
    def size_error(self) -> Array | None:
        """(N, N) how much more lambda moves the minimum than the terms assume; None where they assume what is so.

        The prior on lambda tells sizes and so does the fleet, and the minimum is nearer the truth with both. But real
        vehicles spread more than both together allow (`VehicleModel.size_errors`): as the traffic does, or as their
        class where the chance of another one is counted beside it (`fgrecon.solve.either_class`).
        """
        errors = self.model.size_errors
        if errors is None or not {"coefficients", "dimensions"} <= self._present.keys():
            return None
        return errors[counts_classes(self.options)]

    def energies(self, values: gtsam.Values) -> Iterator[tuple[str, float]]:
        """Name and energy of each term at the values, nats."""
        if self._stack is not None:
            yield from self._stack.energies(values)
        for name in self._others:
            yield name, sum(factor.error(values) for factor in self._term(name))

    @cached_property
    def _others(self) -> list[str]:
        """Terms that are not in the stack."""
        return [name for name in self._present if self._stack is None or name not in self._stack.slices]

    def _stacked(self) -> ShapeTerms | None:
        """The terms that the compiled kernel has, as far as they are there."""
        kernel = native("factors._shape")
        names = {name for name in STACKED if name in self._present}
        return ShapeTerms(kernel, self._context, names) if kernel is not None and names else None

    def _described(self) -> ShapeContext:
        model, options, category = self.model, self.options, self.model.prior.category
        return ShapeContext(
            shape=self.shape,
            number=self.number,
            faces=category.faces,
            pairs=category.symmetric_pairs,
            mirror=category.mirror,
            neighbours=category.neighbours,
            mirrored_prior=model.prior.is_symmetric,
            dimension_operator=category.dimension_operator,
            size=None if model.size is None else (model.size.mean, model.size.assumed_sigma),
            offset_sigma=model.prior.offset_sigma,
            spread=model.any_fleet_spread if is_any_fleets(model, options) else None,
            by_size=model.by_size if self.of_fleet else None,
            settings=options.shape,
            disabled=options.disabled_terms,
        )


ShapeValues = tuple[Array, Array]
"""Lambda (N,) and offsets (K, 3)."""


def vehicle_part(model: VehicleModel, options: Options, number: int, *, of_fleet: bool = False) -> VehiclePart:
    """The part of a vehicle whose shape is free; remembered, since every vehicle of a fleet has the same."""
    return _remembered(model, options, number, of_fleet, get_ident())


@lru_cache(maxsize=16)
def _remembered(model: VehicleModel, options: Options, number: int, of_fleet: bool, thread: int) -> VehiclePart:  # noqa: ARG001
    """One for each thread: a part keeps what it evaluated last."""
    return VehiclePart(model, options, number, of_fleet=of_fleet)


@lru_cache(maxsize=16)
def _medial_plane(key: int) -> gtsam.Values:
    """The plane z = 0 of the object frame as values, which GTSAM takes over without looking for their type."""
    values = gtsam.Values()
    values.insert(key, gtsam.OrientedPlane3(np.array([0.0, 0.0, 1.0, 0.0])))
    return values


def counts_classes(options: Options) -> bool:
    """Whether covariances count a car and a van one beside the other where the class is open."""
    return options.strategy.name is StrategyName.MIXTURE and options.shape.joint


def is_any_fleets(model: VehicleModel, options: Options) -> bool:
    """Whether a vehicle may be of another fleet than its prior's: none is given, nor is that one assumed."""
    return not (model.fleet_given or options.shape.own_fleet)


def fleet_prior(model: VehicleModel) -> gtsam.PriorFactorVector:
    """What is known of the mean size of a fleet S that is not given."""
    return spread_prior(S(), model.fleet_spread)
