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

from collections.abc import Mapping

import gtsam
import numpy as np
from numpy.typing import NDArray

import factors
from factors import L, LinearShape, M, O, P
from fgrecon.core.category import Category, Face
from fgrecon.core.options import Options
from fgrecon.solve.vehicle.model import VehicleModel

__all__ = ["Terms", "VehiclePart"]

Array = NDArray[np.float64]
Terms = Mapping[str, list[gtsam.NonlinearFactor]]
"""Factors by the name of their energy term."""

_NOTHING = 1e-9  # metres; a residual that never exceeds this is none
_SMALLEST_OFFSET = 1e-4  # metres; a standard deviation of zero would make the system singular


class VehiclePart:
    """Variables and terms of one vehicle's shape.

    Attributes:
        model: The prepared prior.
        options: Settings.
        number: Number of the vehicle in the keys.
        shape: The keypoints as a function of lambda and the offsets.
        coefficients: Key of lambda, or its value where it is held.
        terms: Factors by energy term.
    """

    def __init__(self, model: VehicleModel, options: Options, number: int = 0, *, held: Held | None = None) -> None:
        """Prepare the part.

        Args:
            model: The prepared prior.
            options: Settings.
            number: Number of the vehicle in the keys.
            held: Lambda (N,) and offsets (K, 3) where the shape is a constant.
        """
        prior = model.prior
        self.model, self.options, self.number = model, options, number
        offsets: int | Array | None
        if held is None:
            self.coefficients: int | Array = L(number) if prior.dimension else np.zeros(0)
            offsets = O(number) if options.shape.free_offsets else None
        else:
            self.coefficients, offsets = held
        self._held = held
        self.shape = LinearShape(prior.mean, prior.basis, self.coefficients, offsets)
        self._planes: dict[int, NDArray[np.intp] | None] = {}  # keypoints to fit each plane to; None: the medial plane
        disabled = options.disabled_terms
        terms = self._terms() if self.shape.keys else {}
        self.terms: Terms = {name: term for name, term in terms.items() if term and name not in disabled}

    def insert(self, values: gtsam.Values, coefficients: Array, offsets: Array) -> None:
        """Add every variable to the values; planes are fitted to the keypoints."""
        if self.shape.coefficients_key is not None:
            values.insert(self.shape.coefficients_key, coefficients)
        if self.shape.offsets_key is not None:
            values.insert(self.shape.offsets_key, offsets.ravel())
        points = self.shape.points(values)
        for key, keypoints in self._planes.items():
            plane = _medial_plane() if keypoints is None else factors.fit_plane(points[keypoints])
            free = keypoints is not None and self.options.shape.plane_penalty is not None
            values.insert(key, plane.planeCoefficients() if free else plane)

    def read(self, values: gtsam.Values) -> Held:
        """Coefficients (N,) and offsets (K, 3) at the values."""
        if self._held is not None:
            return self._held
        key, offsets_key = self.shape.coefficients_key, self.shape.offsets_key
        coefficients = np.zeros(0) if key is None else values.atVector(key)
        offsets = np.zeros((self.shape.size, 3)) if offsets_key is None else values.atVector(offsets_key).reshape(-1, 3)
        return coefficients, offsets

    def _terms(self) -> dict[str, list[gtsam.NonlinearFactor]]:
        prior, options, size = self.model.prior, self.options.shape, self.model.size
        category = prior.category
        terms: dict[str, list[gtsam.NonlinearFactor]] = {}
        if self.shape.coefficients_key is not None:
            terms["coefficients"] = [factors.coefficients_prior(self.shape.coefficients_key, prior.dimension)]
        if self.shape.offsets_key is not None:
            spread = np.maximum(prior.offset_sigma, _SMALLEST_OFFSET)
            if "symmetry" not in self.options.disabled_terms:  # which makes one offset of the two of a pair
                spread = spread * np.where(category.mirror != np.arange(category.size), np.sqrt(2.0), 1.0)
            terms["offsets"] = [factors.offsets_prior(self.shape.offsets_key, spread)]
        terms["planarity"] = self._planarity(category)
        faces = [face.keypoints for face in category.faces if face.rectangular]
        rectangles = [factors.rectangularity_factor(self.shape, f, options.rectangularity_sigma) for f in faces]
        terms["rectangularity"] = [factor for factor in rectangles if not self._vanishes(factor)]
        terms["symmetry"] = self._symmetry(category)
        if size is not None:
            operator = category.dimension_operator
            terms["dimensions"] = [factors.dimensions_factor(self.shape, operator, size.mean, size.sigma)]
        if any(category.neighbours):
            adapted = not options.literal_laplacian
            factor = factors.laplacian_factor(
                self.shape,
                category.neighbours,
                options.laplacian_sigma,
                normalised=adapted,
                relative_to_mean=adapted,
            )
            terms["laplacian"] = [factor]
        return terms

    def _vanishes(self, factor: gtsam.CustomFactor) -> bool:
        """Whether a factor on the shape alone is zero for every lambda, as wheels that the prior has in a rectangle."""
        if self.shape.coefficients_key is None or self.shape.offsets_key is not None:
            return False
        for coefficients in np.vstack([np.zeros(self.shape.dims[0]), 3.0 * np.eye(self.shape.dims[0])]):
            values = gtsam.Values()
            values.insert(self.shape.coefficients_key, coefficients)
            if np.abs(factor.unwhitenedError(values)).max() > _NOTHING:
                return False
        return True

    @property
    def _always_symmetric(self) -> bool:
        return self.model.prior.is_symmetric and self.shape.offsets_key is None

    def _planarity(self, category: Category) -> list[gtsam.NonlinearFactor]:
        """Each face's planarity, and the direction of the ground-parallel ones."""
        if "planarity" in self.options.disabled_terms:
            return []
        term: list[gtsam.NonlinearFactor] = []
        for index, face in enumerate(category.faces):
            if self._always_symmetric and not face.ground_parallel and _is_mirrored(face, category):
                continue  # planar for every lambda, and in no particular direction
            key = P(self.number, index)
            self._planes[key] = np.array(face.keypoints)
            term += self._face(face, key)
        return term

    def _face(self, face: Face, key: int) -> list[gtsam.NonlinearFactor]:
        options, indices = self.options.shape, face.keypoints
        sigma, mu, parallel = options.planarity_sigma, options.plane_penalty, options.parallel_sigma
        term: list[gtsam.NonlinearFactor]
        if mu is None:
            term = [factors.planarity_factor(self.shape, indices, key, sigma)]
            return [*term, factors.ground_parallel_factor(key, parallel)] if face.ground_parallel else term
        term = [factors.penalty_planarity_factor(self.shape, indices, key, sigma, mu=mu)]
        return [*term, factors.penalty_ground_parallel_factor(key, parallel)] if face.ground_parallel else term

    def _symmetry(self, category: Category) -> list[gtsam.NonlinearFactor]:
        pairs = category.symmetric_pairs
        if self._always_symmetric or not pairs or "symmetry" in self.options.disabled_terms:
            return []
        key = M(self.number)
        self._planes[key] = None
        middle = np.flatnonzero(category.mirror == np.arange(category.size))
        return [factors.symmetry_factor(self.shape, pairs, key, self.options.shape.symmetry_sigma, on_plane=middle)]


Held = tuple[Array, Array]
"""Lambda (N,) and offsets (K, 3)."""


def _is_mirrored(face: Face, category: Category) -> bool:
    """Whether a face consists of two mirrored pairs: such a quad is planar in every symmetric shape."""
    return len(face.keypoints) == 4 and {int(category.mirror[i]) for i in face.keypoints} == set(face.keypoints)


def _medial_plane() -> gtsam.OrientedPlane3:
    """The plane z = 0 of the object frame."""
    return gtsam.OrientedPlane3(np.array([0.0, 0.0, 1.0, 0.0]))
