"""What a graph holds of a vehicle once, in however many images it is seen: its shape, and the terms about it.

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

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from threading import get_ident

import gtsam
import numpy as np
from numpy.typing import NDArray

import factors
from factors import L, LinearShape, M, O, P
from factors.keys import S
from factors.marginals import Marginal, marginal_factor
from factors.native import native
from factors.shape_terms import ShapeTerms
from fgrecon.core.category import Category, Face
from fgrecon.core.options import Options
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.vehicle.model import VehicleModel

__all__ = ["Terms", "VehiclePart", "fleet_prior", "is_any_fleets", "vehicle_part"]

Array = NDArray[np.float64]
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
            model: The prepared prior.
            options: Settings.
            number: Number of the vehicle in the keys.
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
        self._makers = self._present() if self.shape.keys else {}
        self._made: dict[str, list[gtsam.NonlinearFactor]] = {}
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
        return {name: self._term(name) for name in self._makers}

    def _term(self, name: str) -> list[gtsam.NonlinearFactor]:
        if name not in self._made:  # on use: what the solver gets is stacked
            self._made[name] = self._makers[name]()
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
            plane = factors.fit_plane(self.shape.points(values)[keypoints])
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

    @cached_property
    def counted_once(self) -> Sequence[gtsam.NonlinearFactor]:
        """The same factors for covariances, where the vehicle's size is as uncertain as the traffic's and no less.

        The prior on lambda tells sizes and so does the fleet, and the minimum is nearer the truth with both. But the
        spread of the traffic is that of real vehicles, which the two together make too small. So lambda has the prior
        that gives sizes this spread, and is as it was where sizes do not depend on it.
        """
        key = self.shape.coefficients_key
        if key is None or not {"coefficients", "dimensions"} <= self._makers.keys():
            return self._solved
        stack = self._stacked(sized=False)
        slices: Collection[str] = () if stack is None else stack.slices
        names = [name for name in self._makers if name not in {"coefficients", "dimensions", *slices}]
        own = [factor for name in names for factor in self._term(name)]
        prior = _prior(key, self.model.traffic_spread)
        return [prior, *own] if stack is None else [stack.factor(), prior, *own]

    def _about_fleet(self, key: int) -> gtsam.CustomFactor:
        """N(0, I) of lambda about the mean of a fleet S that is larger than the prior's by so much."""
        count, at = self.model.prior.dimension, gtsam.Values()
        at.insert(key, np.zeros(count))
        at.insert(S(), np.zeros(3))
        off_mean = np.hstack([np.eye(count), -self.model.by_size])
        return marginal_factor(Marginal((key, S()), (count, 3), at, off_mean, np.zeros(count)))

    def energies(self, values: gtsam.Values) -> Iterator[tuple[str, float]]:
        """Name and energy of each term at the values, nats."""
        if self._stack is not None:
            yield from self._stack.energies(values)
        for name in self._others:
            yield name, sum(factor.error(values) for factor in self._term(name))

    @property
    def _others(self) -> list[str]:
        """Terms that are not in the stack."""
        stacked: Collection[str] = () if self._stack is None else self._stack.slices
        return [name for name in self._makers if name not in stacked]

    def _stacked(self, *, sized: bool = True) -> ShapeTerms | None:
        """Symmetry, rectangularity and dimensions, as far as they are there and wanted, in the compiled kernel."""
        kernel, options, size = native("factors._shape"), self.options.shape, self.model.size
        category, terms = self.model.prior.category, self._makers
        symmetric, sized = "symmetry" in terms, sized and "dimensions" in terms and size is not None
        if kernel is None or not (symmetric or sized or "rectangularity" in terms):
            return None
        return ShapeTerms(
            kernel,
            self.shape,
            pairs=category.symmetric_pairs if symmetric else (),
            middle=_middle(category) if symmetric else (),
            plane_key=M(self.number) if symmetric else None,
            pair_sigma=options.symmetry_sigma,
            quads=self._rectangles if "rectangularity" in terms else (),
            quad_sigma=options.rectangularity_sigma,
            operator=category.dimension_operator if sized else None,
            size=size.mean if sized and size is not None else None,
            size_sigma=size.told if sized and size is not None else None,
        )

    def _present(self) -> dict[str, Callable[[], list[gtsam.NonlinearFactor]]]:
        """What makes the factors of each term that there is."""
        category, disabled = self.model.prior.category, self.options.disabled_terms
        present: dict[str, Callable[[], list[gtsam.NonlinearFactor]]] = {}
        if self.shape.coefficients_key is not None:
            present["coefficients"] = self._coefficients
        if self.shape.offsets_key is not None:
            present["offsets"] = self._offsets
        self._faces = [] if "planarity" in disabled else self._bent_faces(category)
        self._planes |= {P(self.number, i): np.array(category.faces[i].keypoints) for i in self._faces}
        if self._faces:
            present["planarity"] = lambda: [f for i in self._faces for f in self._face(category.faces[i], i)]
        faces = [face.keypoints for face in category.faces if face.rectangular]
        self._rectangles = [face for face in faces if not self._vanishes(face)]
        if self._rectangles:
            present["rectangularity"] = lambda: [self._rectangle(face) for face in self._rectangles]
        if category.symmetric_pairs and not self._always_symmetric and "symmetry" not in disabled:
            self._planes[M(self.number)] = None
            present["symmetry"] = self._symmetry
        if self.model.size is not None:
            present["dimensions"] = self._dimensions
        if any(category.neighbours):
            present["laplacian"] = self._laplacian
        return {name: maker for name, maker in present.items() if name not in disabled}

    def _coefficients(self) -> list[gtsam.NonlinearFactor]:
        assert self.shape.coefficients_key is not None
        if self.of_fleet:
            return [self._about_fleet(self.shape.coefficients_key)]
        if is_any_fleets(self.model, self.options):
            return [_prior(self.shape.coefficients_key, self.model.any_fleet_spread)]
        return [factors.coefficients_prior(self.shape.coefficients_key, self.model.prior.dimension)]

    def _offsets(self) -> list[gtsam.NonlinearFactor]:
        assert self.shape.offsets_key is not None
        category = self.model.prior.category
        spread = np.maximum(self.model.prior.offset_sigma, SETTINGS.smallest_offset_sigma_metres)
        if "symmetry" not in self.options.disabled_terms:  # which makes one offset of the two of a pair
            spread = spread * np.where(category.mirror != np.arange(category.size), np.sqrt(2.0), 1.0)
        return [factors.offsets_prior(self.shape.offsets_key, spread)]

    def _rectangle(self, face: tuple[int, ...]) -> gtsam.CustomFactor:
        return factors.rectangularity_factor(self.shape, face, self.options.shape.rectangularity_sigma)

    def _dimensions(self) -> list[gtsam.NonlinearFactor]:
        size = self.model.size
        assert size is not None
        operator = self.model.prior.category.dimension_operator
        return [factors.dimensions_factor(self.shape, operator, size.mean, size.told)]

    def _laplacian(self) -> list[gtsam.NonlinearFactor]:
        options, adapted = self.options.shape, not self.options.shape.literal_laplacian
        factor = factors.laplacian_factor(
            self.shape,
            self.model.prior.category.neighbours,
            options.laplacian_sigma,
            normalised=adapted,
            relative_to_mean=adapted,
        )
        return [factor]

    def _vanishes(self, face: tuple[int, ...]) -> bool:
        """Whether a face is a rectangle for every lambda, as wheels that the prior has in one."""
        if self.shape.coefficients_key is None or self.shape.offsets_key is not None:
            return False
        factor = self._rectangle(face)
        for coefficients in np.vstack([np.zeros(self.shape.dims[0]), 3.0 * np.eye(self.shape.dims[0])]):
            values = gtsam.Values()
            values.insert(self.shape.coefficients_key, coefficients)
            if np.abs(factor.unwhitenedError(values)).max() > SETTINGS.vanishing_residual_metres:
                return False
        return True

    @property
    def _always_symmetric(self) -> bool:
        return self.model.prior.is_symmetric and self.shape.offsets_key is None

    def _bent_faces(self, category: Category) -> list[int]:
        """Faces whose planarity and direction say something: not those that are planar for every lambda anyway."""
        return [
            index
            for index, face in enumerate(category.faces)
            if not self._always_symmetric or face.ground_parallel or not _is_mirrored(face, category)
        ]

    def _face(self, face: Face, index: int) -> list[gtsam.NonlinearFactor]:
        options, indices, key = self.options.shape, face.keypoints, P(self.number, index)
        sigma, mu, parallel = options.planarity_sigma, options.plane_penalty, options.parallel_sigma
        term: list[gtsam.NonlinearFactor]
        if mu is None:
            term = [factors.planarity_factor(self.shape, indices, key, sigma)]
            return [*term, factors.ground_parallel_factor(key, parallel)] if face.ground_parallel else term
        term = [factors.penalty_planarity_factor(self.shape, indices, key, sigma, mu=mu)]
        return [*term, factors.penalty_ground_parallel_factor(key, parallel)] if face.ground_parallel else term

    def _symmetry(self) -> list[gtsam.NonlinearFactor]:
        category, sigma = self.model.prior.category, self.options.shape.symmetry_sigma
        pairs, middle = category.symmetric_pairs, _middle(category)
        return [factors.symmetry_factor(self.shape, pairs, M(self.number), sigma, on_plane=middle)]


ShapeValues = tuple[Array, Array]
"""Lambda (N,) and offsets (K, 3)."""


def vehicle_part(model: VehicleModel, options: Options, number: int, *, of_fleet: bool = False) -> VehiclePart:
    """The part of a vehicle whose shape is free; remembered, since every vehicle of a fleet has the same."""
    return _remembered(model, options, number, of_fleet, get_ident())


@lru_cache(maxsize=16)
def _remembered(model: VehicleModel, options: Options, number: int, of_fleet: bool, thread: int) -> VehiclePart:  # noqa: ARG001
    """One for each thread: a part keeps what it evaluated last."""
    return VehiclePart(model, options, number, of_fleet=of_fleet)


def _is_mirrored(face: Face, category: Category) -> bool:
    """Whether a face consists of two mirrored pairs: such a quad is planar in every symmetric shape."""
    return len(face.keypoints) == 4 and {int(category.mirror[i]) for i in face.keypoints} == set(face.keypoints)


def _middle(category: Category) -> NDArray[np.intp]:
    """Keypoints that are their own mirror image."""
    return np.flatnonzero(category.mirror == np.arange(category.size))


@lru_cache(maxsize=16)
def _medial_plane(key: int) -> gtsam.Values:
    """The plane z = 0 of the object frame as values, which GTSAM takes over without looking for their type."""
    values = gtsam.Values()
    values.insert(key, gtsam.OrientedPlane3(np.array([0.0, 0.0, 1.0, 0.0])))
    return values


def _prior(key: int, spread: Array) -> gtsam.PriorFactorVector:
    """N(0, spread) of lambda."""
    return gtsam.PriorFactorVector(key, np.zeros(len(spread)), gtsam.noiseModel.Gaussian.Covariance(spread))


def is_any_fleets(model: VehicleModel, options: Options) -> bool:
    """Whether a vehicle may be of another fleet than its prior's: none is told, and nobody says that it is that one."""
    return not (model.fleet_told or options.shape.own_fleet)


def fleet_prior(model: VehicleModel) -> gtsam.PriorFactorVector:
    """What is known of the mean size of a fleet S that nobody told."""
    return gtsam.PriorFactorVector(S(), np.zeros(3), gtsam.noiseModel.Gaussian.Covariance(model.fleet_spread))
