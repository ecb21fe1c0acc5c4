"""The factor graph of one vehicle in one image.

    prior ---- L(v) ----+------------------+---------------+--------------+
    N(0, I)  (lambda)   |                  |               |              |
                   reprojection_i     planarity_f      symmetry      dimensions, Laplacian,
                   box, cheirality         |               |         rectangularity
                        |               P(v,f)           M(v)
    ground, ------- X(v,t)                 |
    upright          (pose)         ground-parallel

Every keypoint has a reprojection factor of its own, whose noise model carries its IRLS weight. With free offsets, O(v)
joins L(v) in every shape term and has a prior of its own. In the shape stage the pose is a constant.

With a prior that is exactly symmetric and without offsets, symmetry holds for every lambda, and so does the planarity
of every quad made of two mirrored pairs: those terms are constant zero and are left out.
"""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from numpy.typing import NDArray

import factors
from factors import L, LinearShape, M, O, P, ProjectionKernel, RobustLoss, X
from fgrecon.core.camera import Ground
from fgrecon.core.category import Category, Face
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances

__all__ = ["Terms", "VehicleGraph", "build", "energies"]

Array = NDArray[np.float64]
Terms = Mapping[str, list[gtsam.NonlinearFactor]]
"""Factors by the name of their energy term."""

_SMALLEST_OFFSET = 1e-4  # metres; a standard deviation of zero would make the system singular
_SMALLEST_WEIGHT = 1e-6  # a box edge of less weight says nothing


class VehicleGraph:
    """Builds the graph for given weights; everything that does not depend on them is built once.

    Attributes:
        problem: What is given.
        shape: The keypoints as a function of lambda and the offsets.
        kernel: Their projection.
        pose_key: Key of the pose, or None where it is a constant.
    """

    def __init__(
        self,
        problem: Problem,
        pose: gtsam.Pose3,
        *,
        pose_free: bool,
        vehicle: int = 0,
        frame: int = 0,
        shape_terms: bool = True,
    ) -> None:
        """Prepare the graph.

        Args:
            problem: What is given.
            pose: camera_T_object: the constant where it is not free; its depth also sets the ground's uncertainty.
            pose_free: Whether the pose is a variable.
            vehicle: Number of the vehicle in the keys.
            frame: Number of the frame in the keys.
            shape_terms: Whether to have the terms of the shape alone; of the frames of one vehicle one has them.
        """
        prior, options = problem.model.prior, problem.options.shape
        self.problem = problem
        self.pose_key = X(vehicle, frame) if pose_free else None
        self._pose = pose
        self._vehicle = vehicle
        coefficients = L(vehicle) if prior.dimension else np.zeros(0)
        self.shape = LinearShape(prior.mean, prior.basis, coefficients, O(vehicle) if options.free_offsets else None)
        self._bound_pose = pose if self.pose_key is None else self.pose_key
        self.kernel = ProjectionKernel(self.shape, problem.camera.matrix, self._bound_pose)
        self._covariances = keypoint_covariances(problem.observation, problem.options.keypoints)
        self._box_kernel = None
        box = problem.energy.box
        if box is not None:
            box_shape = LinearShape(box.mean, box.basis, coefficients)
            self._box_kernel = ProjectionKernel(box_shape, problem.camera.matrix, self._bound_pose)
        self._planes: dict[int, NDArray[np.intp] | None] = {}  # keypoints to fit each plane to; None: the medial plane
        self._static = self._static_terms(shape_terms=shape_terms)

    def terms(self, weights: Array, box_weights: Array) -> Terms:
        """All factors by energy term, for keypoint weights (K,) and box edge weights (4,)."""
        terms = {"reprojection": self._reprojection(weights), **self._static}
        box = self.problem.energy.box
        if box is not None and self._box_kernel is not None and self._box_kernel.keys:
            used = box.used & (box_weights > _SMALLEST_WEIGHT)
            if used.any():
                sigmas = box.sigma / np.sqrt(box_weights[used])
                noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
                edges = used.tolist()
                factor = factors.box_factor(self._box_kernel, box.edges, noise, softness=box.softness, edges=edges)
                terms["box"] = [factor]
        return terms

    def values(self, pose: gtsam.Pose3, coefficients: Array, offsets: Array) -> gtsam.Values:
        """Values of every variable; planes are fitted to the keypoints."""
        values = gtsam.Values()
        if self.pose_key is not None:
            values.insert(self.pose_key, pose)
        if self.shape.coefficients_key is not None:
            values.insert(self.shape.coefficients_key, coefficients)
        if self.shape.offsets_key is not None:
            values.insert(self.shape.offsets_key, offsets.ravel())
        points = self.shape.points(values)
        for key, keypoints in self._planes.items():
            plane = _medial_plane() if keypoints is None else factors.fit_plane(points[keypoints])
            free = keypoints is not None and self.problem.options.shape.plane_penalty is not None
            values.insert(key, plane.planeCoefficients() if free else plane)
        return values

    def read(self, values: gtsam.Values) -> tuple[gtsam.Pose3, Array, Array]:
        """Pose, coefficients (N,) and offsets (K, 3) at the values."""
        pose = self._pose if self.pose_key is None else values.atPose3(self.pose_key)
        key, offsets_key = self.shape.coefficients_key, self.shape.offsets_key
        coefficients = np.zeros(0) if key is None else values.atVector(key)
        offsets = np.zeros((self.shape.size, 3)) if offsets_key is None else values.atVector(offsets_key).reshape(-1, 3)
        return pose, coefficients, offsets

    def _reprojection(self, weights: Array) -> list[gtsam.NonlinearFactor]:
        if not self.kernel.keys:  # a constant shape at a fixed pose
            return []
        noises = [
            factors.keypoint_noise(weight, 1.0, covariance=covariance, robust=self._loss(weight))
            for weight, covariance in zip(weights.tolist(), self._covariances, strict=True)
        ]
        return list(factors.reprojection_factors(self.kernel, self.problem.observation.keypoints, noises))

    def _loss(self, weight: float) -> RobustLoss | None:
        """The m-estimator of a keypoint, with the energy w rho(d) of the pose stage.

        GTSAM applies rho to the whitened norm sqrt(w) d; every loss has rho(c s) = c^2 rho(s) where its constant is
        scaled by c as well.
        """
        strategy = self.problem.options.strategy
        if strategy.loss is None or weight <= 0.0:
            return None
        loss = strategy.robust_loss
        return RobustLoss(loss.loss, loss.constant * weight**0.5)

    def _static_terms(self, *, shape_terms: bool) -> dict[str, list[gtsam.NonlinearFactor]]:
        """The factors that no weight changes."""
        terms: dict[str, list[gtsam.NonlinearFactor]] = {}
        if self.kernel.keys:
            terms["cheirality"] = [factors.cheirality_factor(self.kernel)]
        if shape_terms and self.shape.keys:
            terms |= self._shape_terms()
        if self.pose_key is not None and self.problem.ground is not None:
            terms["ground"] = self._ground_factors(self.pose_key, self.problem.ground)
        disabled = self.problem.options.disabled_terms
        return {name: term for name, term in terms.items() if term and name not in disabled}

    def _shape_terms(self) -> dict[str, list[gtsam.NonlinearFactor]]:
        prior, options, size = self.problem.model.prior, self.problem.options.shape, self.problem.model.size
        category = prior.category
        terms: dict[str, list[gtsam.NonlinearFactor]] = {}
        if self.shape.coefficients_key is not None:
            terms["coefficients"] = [factors.coefficients_prior(self.shape.coefficients_key, prior.dimension)]
        if self.shape.offsets_key is not None:
            spread = np.maximum(prior.offset_sigma, _SMALLEST_OFFSET)
            terms["offsets"] = [factors.offsets_prior(self.shape.offsets_key, spread)]
        terms["planarity"] = self._planarity(category)
        terms["rectangularity"] = [
            factors.rectangularity_factor(self.shape, face.keypoints, options.rectangularity_sigma)
            for face in category.faces
            if face.rectangular
        ]
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

    @property
    def _always_symmetric(self) -> bool:
        return self.problem.model.prior.is_symmetric and self.shape.offsets_key is None

    def _planarity(self, category: Category) -> list[gtsam.NonlinearFactor]:
        """Each face's planarity, and the direction of the ground-parallel ones."""
        if "planarity" in self.problem.options.disabled_terms:
            return []
        term: list[gtsam.NonlinearFactor] = []
        for index, face in enumerate(category.faces):
            if self._always_symmetric and not face.ground_parallel and _is_mirrored(face, category):
                continue  # planar for every lambda, and in no particular direction
            key = P(self._vehicle, index)
            self._planes[key] = np.array(face.keypoints)
            term += self._face(face, key)
        return term

    def _face(self, face: Face, key: int) -> list[gtsam.NonlinearFactor]:
        options, indices = self.problem.options.shape, face.keypoints
        sigma, mu, parallel = options.planarity_sigma, options.plane_penalty, options.parallel_sigma
        term: list[gtsam.NonlinearFactor]
        if mu is None:
            term = [factors.planarity_factor(self.shape, indices, key, sigma)]
            return [*term, factors.ground_parallel_factor(key, parallel)] if face.ground_parallel else term
        term = [factors.penalty_planarity_factor(self.shape, indices, key, sigma, mu=mu)]
        return [*term, factors.penalty_ground_parallel_factor(key, parallel)] if face.ground_parallel else term

    def _symmetry(self, category: Category) -> list[gtsam.NonlinearFactor]:
        pairs = category.symmetric_pairs
        if self._always_symmetric or not pairs or "symmetry" in self.problem.options.disabled_terms:
            return []
        key = M(self._vehicle)
        self._planes[key] = None
        middle = np.flatnonzero(category.mirror == np.arange(category.size))
        sigma = self.problem.options.shape.symmetry_sigma
        return [factors.symmetry_factor(self.shape, pairs, key, sigma, on_plane=middle)]

    def _ground_factors(self, pose_key: int, ground: Ground) -> list[gtsam.NonlinearFactor]:
        sigma = float(ground.height_sigma_at(self._pose.translation()[2]))
        return [
            factors.ground_height_factor(pose_key, ground.normal, ground.distance, sigma),
            factors.upright_factor(pose_key, ground.normal, ground.tilt_sigma),
        ]


def build(terms: Terms) -> gtsam.NonlinearFactorGraph:
    """One graph of all terms."""
    graph = gtsam.NonlinearFactorGraph()
    for term in terms.values():
        for factor in term:
            graph.add(factor)
    return graph


def energies(terms: Terms, values: gtsam.Values) -> dict[str, float]:
    """Energy of each term at the values, nats."""
    return {name: sum(factor.error(values) for factor in term) for name, term in terms.items()}


def _is_mirrored(face: Face, category: Category) -> bool:
    """Whether a face consists of two mirrored pairs: such a quad is planar in every symmetric shape."""
    return len(face.keypoints) == 4 and {int(category.mirror[i]) for i in face.keypoints} == set(face.keypoints)


def _medial_plane() -> gtsam.OrientedPlane3:
    """The plane z = 0 of the object frame."""
    return gtsam.OrientedPlane3(np.array([0.0, 0.0, 1.0, 0.0]))
