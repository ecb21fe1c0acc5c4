"""What a graph holds of a vehicle in one image: its pose, and the terms that are about what is seen there.

                    keypoints, box, cheirality
    L(v), O(v) --------------------------------- X(v,t) --- height, upright (the ground)

With the mixture all of it is one factor for the solver, which has the robust loss inside and is told what changes. With
other strategies all keypoints are one stacked factor, whose noise model carries their weights and which is built again
when they change; where the strategy is an m-estimator every keypoint has a factor of its own, since GTSAM's robust
noise models weigh whole factors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray

import factors
from factors import F, ProjectionKernel, RobustLoss, X
from factors.box import projected_extents
from factors.ground import ground_rows
from factors.mixture import Form
from factors.noise import SMALLEST_WEIGHT
from factors.observation_factor import BoxRows, GroundRows, ObservationRows, observation_factor
from fgrecon.core.camera import Camera
from fgrecon.core.robust import StrategyName
from fgrecon.solve.graph.vehicle_part import VehiclePart
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.proposals.terms import Hypotheses

__all__ = ["ObservationPart", "Weights"]

Array = NDArray[np.float64]

_SMALLEST_EDGE = 1e-6  # a box edge of less weight says nothing


@dataclass(frozen=True)
class _Assessed:
    """What the compiled kernel makes of a state, kept since weights and energies are wanted one after the other.

    Attributes:
        values: The state.
        visibility: (K,) visibility it was assessed with.
        looked: Whether that is the visibility of its pose.
        densities: (K,) of right points and (K,) of wrong ones.
        keypoints: (K,) weights.
        box: (4,) weights of the box's edges.
        energies: Of keypoints and box, nats.
        loss: What `factors.mixture.Form.LOSS` makes of both, nats.
    """

    values: gtsam.Values
    visibility: Array
    looked: bool
    densities: tuple[Array, Array]
    keypoints: Array
    box: Array
    energies: tuple[float, float]
    loss: float

    def answers(self, visibility: Array | None) -> bool:
        """Whether it was assessed with a visibility, or with None with that of its pose."""
        return self.looked if visibility is None else visibility is self.visibility


@dataclass(frozen=True)
class Weights:
    """What iteratively re-weighted least squares holds fixed of one observation during a solve.

    Attributes:
        keypoints: (K,) weights of the keypoints.
        visibility: (K,) visibility that they were computed with.
        box: (4,) weights of the box edges.
        depth: Depth that the ground's uncertainty belongs to, metres.
    """

    keypoints: Array
    visibility: Array
    box: Array
    depth: float


class ObservationPart:
    """Pose variable and terms of one vehicle in one image.

    Attributes:
        problem: What is given.
        vehicle: The vehicle.
        image: Number of the image in the keys.
        share: Factor on the energy of all its terms.
        pose_key: Key of camera_T_object, or None where it is a constant.
        kernel: Projection of the keypoints.
        compiled: The compiled rows; None where there are none, or the focal length is a variable.
    """

    def __init__(
        self,
        problem: Problem,
        vehicle: VehiclePart,
        pose: gtsam.Pose3,
        *,
        pose_free: bool,
        image: int = 0,
        share: float = 1.0,
        focal_free: bool = False,
    ) -> None:
        """Prepare the part.

        Args:
            problem: What is given.
            vehicle: The vehicle's part of the same graph.
            pose: camera_T_object, the constant where it is not free.
            pose_free: Whether the pose is a variable.
            image: Number of the image in the keys.
            share: Share of its information that the observation has for the graph: less than 1 where other images of
                the vehicle err alike.
            focal_free: Whether the focal length is a variable, common to all vehicles of the image.
        """
        self.problem, self.vehicle, self.image, self.share = problem, vehicle, image, share
        self.pose_key = X(vehicle.number, image) if pose_free else None
        self._pose = pose
        bound = pose if self.pose_key is None else self.pose_key
        focal = F(image) if focal_free else None
        self.kernel = ProjectionKernel(vehicle.shape, problem.camera.matrix, bound, focal)
        self.compiled = problem.energy.compiled if focal is None else None
        self._box_kernel = None
        self._factor: gtsam.CustomFactor | None = None
        self._last: _Assessed | None = None
        if problem.energy.box is not None:
            box = problem.energy.box
            self._box_kernel = ProjectionKernel(
                vehicle.enclosed(box.mean, box.basis), problem.camera.matrix, bound, focal
            )
        self.stacked = self._stacked()

    @cached_property
    def _noise(self) -> tuple[float, Array | None]:
        """Standard deviation of the keypoints, pixels, and where they are not isotropic their covariances (K, 2, 2)."""
        covariances = keypoint_covariances(self.problem.observation, self.problem.options.keypoints)
        isotropic = self.problem.observation.covariance is None
        return float(np.sqrt(covariances[0, 0, 0])), None if isotropic else covariances

    @property
    def is_robust(self) -> bool:
        """Whether the factors that are solved have the robust loss inside, so that one solve finds its minimum."""
        return self.stacked is not None

    def _stacked(self) -> ObservationRows | None:
        """All terms in one factor, where the strategy is the mixture."""
        energy = self.problem.energy
        if energy.keypoints.strategy.name is not StrategyName.MIXTURE or not self.kernel.keys:
            return None
        box, ground = energy.box, energy.ground
        return ObservationRows(
            self.kernel,
            energy.keypoints.pixels,
            energy.keypoints.triangles,
            box=None
            if box is None or self._box_kernel is None
            else BoxRows(self._box_kernel, box.edges, box.used, box.sigma, box.outlier, box.softness),
            ground=None
            if ground is None or self.pose_key is None
            else GroundRows(ground.ground.normal, ground.ground.distance, ground.ground.tilt_sigma),
            compiled=self.compiled,
            share=self.share,
        )

    def solved(self, weights: Weights, form: Form = Form.NEWTON) -> list[gtsam.NonlinearFactor]:
        """The factors of all terms as the solver gets them.

        With the mixture they are one and the same factor whatever the weights: it is told of visibility and depth.

        Args:
            weights: The weights; of the mixture those are used that `form` says.
            form: How the mixture is handed to the solver.
        """
        rows = self.stacked
        if rows is None:
            return [factor for term in self.terms(weights).values() for factor in term]
        term, ground = self.problem.energy.keypoints, self.problem.energy.ground
        rows.form, rows.edge_weights = form, weights.box
        if form is Form.WEIGHTED:
            rows.right = weights.keypoints
        elif self._last is not None and self._last.visibility is weights.visibility:
            rows.right, rows.wrong = self._last.densities
        else:
            rows.right, rows.wrong = term.strategy.densities(term.evidence, weights.visibility)
        if ground is not None:
            rows.height_sigma = ground.ground.height_sigma_at_depth(weights.depth)
        if self._factor is None:
            self._factor = observation_factor(rows)
        return [self._factor]

    def pose(self, values: gtsam.Values) -> gtsam.Pose3:
        """camera_T_object at the values."""
        return self._pose if self.pose_key is None else values.atPose3(self.pose_key)

    def reweigh(self, values: gtsam.Values, before: Weights, progress: float, *, hold: bool = False) -> Weights:
        """Weights at the values.

        Args:
            values: Where.
            before: The weights until now.
            progress: 0 at the first update, 1 at the last.
            hold: Keep visibility and the ground's uncertainty as they are.
        """
        term, box = self.problem.energy.keypoints, self.problem.energy.box
        if self.compiled is not None:
            seen = self._assess(values, before.visibility if hold else None)
            depth = before.depth if hold else float(self.kernel.pose(values)[2, 3])
            return Weights(seen.keypoints, seen.visibility, seen.box, depth)
        pose = self.pose(values)
        visibility, depth = before.visibility, before.depth
        if not hold:
            visibility, depth = self.problem.energy.visibility(pose.matrix()[None])[0], float(pose.z())
        weights = term.strategy.weights(
            self._squares(values), term.evidence, visibility, previous=before.keypoints, progress=progress
        )
        edges = before.box if box is None else box.weights(self._edges(values))[0]
        return Weights(weights, visibility, edges, depth)

    def graph_weights(self, weights: Weights) -> Array:
        """(K,) weights in the noise models: without an m-estimator's share, which the graph has itself."""
        term = self.problem.energy.keypoints
        if term.strategy.loss is None:
            return weights.keypoints
        return term.strategy.initial_weights(term.evidence, weights.visibility)

    def terms(self, weights: Weights, share: float | None = None) -> dict[str, list[gtsam.NonlinearFactor]]:
        """All factors by energy term; with another share of their information where one is given."""
        share = self.share if share is None else share
        terms: dict[str, list[gtsam.NonlinearFactor]] = {}
        if self.kernel.keys:  # else a constant shape at a fixed pose
            terms["reprojection"] = self._reprojection(share * self.graph_weights(weights))
            terms["cheirality"] = [factors.cheirality_factor(self.kernel)]
        terms["box"] = self._box(share * weights.box)
        terms["ground"] = self._ground(weights.depth, share)
        return {name: term for name, term in terms.items() if term}

    def energies(self, values: gtsam.Values, weights: Weights) -> dict[str, float]:
        """Energy of each term, nats: of keypoints and box the robust one that the weights stand for."""
        term, box, ground = self.problem.energy.keypoints, self.problem.energy.box, self.problem.energy.ground
        if self.compiled is not None:
            robust, edges = self._assess(values, weights.visibility).energies
        else:
            robust = float(term.strategy.evaluate(self._squares(values), term.evidence, weights.visibility)[1])
            edges = 0.0 if box is None else float(box.energy(self._edges(values))[0])
        told = {"reprojection": self.share * robust, "cheirality": 0.0}
        if box is not None:
            told["box"] = self.share * edges
        if ground is not None and self.pose_key is not None:
            sigma = ground.ground.height_sigma_at_depth(weights.depth)
            told["ground"] = self.share * (self._off_ground(values, sigma) + math.log(sigma))
        if self.problem.energy.direction is not None:
            told["direction"] = self.share * float(self.problem.energy.direction.energy(self._hypothesis(values))[0])
        return told

    def loss(self, values: gtsam.Values, weights: Weights) -> float:
        """Error of the factor that `solved` told of the weights, nats: at the values where these were made for nothing.

        It is what a step is judged by, and differs from the energy by what does not change as long as visibility does
        not.
        """
        assert self._factor is not None
        if self.compiled is None:
            return float(self._factor.error(values))
        loss = self._assess(values, weights.visibility).loss
        ground = self.problem.energy.ground
        if ground is not None and self.pose_key is not None:
            loss += self._off_ground(values, ground.ground.height_sigma_at_depth(weights.depth))
        return self.share * loss

    def _off_ground(self, values: gtsam.Values, sigma: float) -> float:
        """Half the squared deviation from the ground, whose height is known to sigma metres there."""
        assert self.problem.energy.ground is not None
        plane, pose = self.problem.energy.ground.ground, self.kernel.pose(values)
        rows, _ = ground_rows(plane.normal, plane.distance, pose[:3, :3], pose[:3, 3])
        lean = rows[1:] / plane.tilt_sigma
        return 0.5 * float((rows[0] / sigma) ** 2 + lean @ lean)

    def projections(self, values: gtsam.Values) -> Array:
        """(K, 2) projected keypoints, pixels."""
        return self.kernel.evaluate(values).pixels

    def _assess(self, values: gtsam.Values, visibility: Array | None) -> _Assessed:
        """Weights and energies by the compiled kernel, with a visibility or with that of the pose."""
        last = self._last
        if last is not None and last.values is values and last.answers(visibility):
            return last
        shape, compiled = self.vehicle.shape, self.compiled
        assert compiled is not None
        seen = np.empty(shape.size) if visibility is None else visibility
        keypoints, right, wrong, box, robust, edges, loss = compiled.assess(
            self.kernel.pose(values), shape.coefficients(values), shape.offsets(values), seen, visibility is None
        )
        energies = robust, edges
        self._last = _Assessed(values, seen, visibility is None, (right, wrong), keypoints, box, energies, loss)
        return self._last

    def _squares(self, values: gtsam.Values) -> Array:
        """(K,) squared Mahalanobis distances of the keypoints' residuals."""
        term = self.problem.energy.keypoints
        residual = self.kernel.evaluate(values).pixels - term.pixels
        squares: Array = np.square(term.whitener @ residual[..., None]).sum(axis=(1, 2))
        return squares

    def _edges(self, values: gtsam.Values) -> Array:
        """(1, 4) whitened residuals of the box's edges."""
        box, kernel = self.problem.energy.box, self._box_kernel
        assert box is not None
        assert kernel is not None
        return ((projected_extents(kernel, values, box.softness)[0] - box.edges) / box.sigma)[None]

    def camera(self, values: gtsam.Values) -> Camera:
        """The camera at the values."""
        if self.kernel.focal_key is None:
            return self.problem.camera
        return replace(self.problem.camera, matrix=self.kernel.matrix(values))

    def _hypothesis(self, values: gtsam.Values) -> Hypotheses:
        matrix = self.pose(values).matrix()
        return Hypotheses(matrix[None, :3, :3], matrix[None, :3, 3], self.vehicle.read(values)[0][None])

    def _reprojection(self, weights: Array) -> list[gtsam.NonlinearFactor]:
        pixels = self.problem.observation.keypoints
        sigma, covariances = self._noise
        if self.problem.options.strategy.loss is not None:
            noises = [
                factors.keypoint_noise(
                    weight,
                    sigma,
                    covariance=None if covariances is None else covariances[i],
                    robust=self._loss(weight),
                )
                for i, weight in enumerate(weights.tolist())
            ]
            return list(factors.reprojection_factors(self.kernel, pixels, noises))
        if not (self.problem.observation.measured & (weights >= SMALLEST_WEIGHT)).any():
            return []
        return [factors.stacked_reprojection_factor(self.kernel, pixels, weights, sigma, covariances=covariances)]

    def _loss(self, weight: float) -> RobustLoss | None:
        """The m-estimator of a keypoint, with the energy w rho(d) of the proposals.

        GTSAM applies rho to the whitened norm sqrt(w) d; every loss has rho(c s) = c^2 rho(s) where its constant is
        scaled by c as well.
        """
        if weight <= 0.0:
            return None
        loss = self.problem.options.strategy.robust_loss
        return RobustLoss(loss.loss, loss.constant * weight**0.5)

    def _box(self, weights: Array) -> list[gtsam.NonlinearFactor]:
        box = self.problem.energy.box
        if box is None or self._box_kernel is None or not self._box_kernel.keys:
            return []
        used = box.used & (weights > _SMALLEST_EDGE)
        if not used.any():
            return []
        noise = gtsam.noiseModel.Diagonal.Sigmas(box.sigma / np.sqrt(weights[used]))
        edges = used.tolist()
        return [factors.box_factor(self._box_kernel, box.edges, noise, softness=box.softness, edges=edges)]

    def _ground(self, depth: float, share: float) -> list[gtsam.NonlinearFactor]:
        term = self.problem.energy.ground
        if term is None or self.pose_key is None:
            return []
        ground = term.ground
        height = ground.height_sigma_at_depth(depth) / share**0.5
        tilt = ground.tilt_sigma / share**0.5
        return [
            factors.ground_height_factor(self.pose_key, ground.normal, ground.distance, height),
            factors.upright_factor(self.pose_key, ground.normal, tilt),
        ]
