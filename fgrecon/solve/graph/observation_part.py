"""Part of the graph about a vehicle in one image: its pose, and the terms of what is observed there.

                    keypoints, box, cheirality
    L(v), O(v) --------------------------------- X(v,t) --- height, upright (the ground)

All of it is one factor for the solver (`factors.observation_rows`). With the mixture it has the robust loss
inside and gets what changes; with other strategies it has the weights, and an m-estimator where the strategy is one.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np

from factors import F, LinearShape, ObservationRows, ProjectionKernel, X, observation_factor, term_factor
from factors.box import projected_extents
from factors.guard import CompiledRows
from factors.keypoint_rows import SMALLEST_WEIGHT
from factors.mixture import Form
from factors.native import native
from factors.system import packed_pose
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.robust import StrategyName
from fgrecon.solve.graph.vehicle_part import VehiclePart
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.terms import Hypotheses


@dataclass(frozen=True)
class Weights:
    """What iteratively re-weighted least squares holds fixed of one observation during a solve."""

    keypoints: Array  # (K,) weights of the keypoints
    visibility: Array  # (K,) visibility that they were computed with
    box: Array  # (4,) weights of the box edges
    depth: float  # depth that the ground's uncertainty belongs to, metres


@dataclass(frozen=True)
class _Assessed:
    """What the strategy makes of a state, kept since weights and energies are requested one after the other."""

    values: gtsam.Values  # the state
    visibility: Array  # (K,) visibility it was assessed with
    looked_up: bool  # whether that is the visibility of its pose
    keypoints: Array  # (K,) weights
    box: Array  # (4,) weights of the box's edges
    energies: tuple[float, float]  # of keypoints and box, nats

    def answers(self, visibility: Array | None) -> bool:
        """Whether it was assessed with a visibility, or with None with that of its pose."""
        return self.looked_up if visibility is None else visibility is self.visibility


class ObservationPart:
    """Pose variable and terms of one vehicle in one image.

    Attributes:
        problem: What is given.
        vehicle: The vehicle's part of the same graph.
        image: Number of the image in the keys.
        share: Factor on the energy of all its terms.
        pose_key: Key of camera_T_object, or None where it is a constant.
        focal_key: Key of the focal length, or None where that is one.
        keys: Keys of its variables: its pose, those of the shape, the focal length, as far as they are variables.
        compiled: The compiled rows of all terms with their variables; None where there are none, the focal length is a
            variable, or all are constants.
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
            pose: camera_T_object, the constant where it is not free.
            pose_free: Whether the pose is a variable.
            share: Share of its information that the observation has for the graph: less than 1 where other images of
                the vehicle err alike.
            focal_free: Whether the focal length is a variable, common to all vehicles of the image.
        """
        self.problem, self.vehicle, self.image, self.share = problem, vehicle, image, share
        self.pose_key = X(vehicle.number, image) if pose_free else None
        self._pose = pose
        self.focal_key = F(image) if focal_free else None
        self.keys = tuple([key for key in (self.pose_key, *vehicle.shape.keys, self.focal_key) if key is not None])
        self._compiled = problem.energy.compiled if self.focal_key is None else None
        self._strategy = problem.energy.keypoints.strategy
        self._mixture = self._strategy.name is StrategyName.MIXTURE
        self._last: _Assessed | None = None
        self._applied: tuple[Form, Array, Array, Array, float] | None = None  # what the rows have
        self.compiled: CompiledRows | None = None
        kernel = native("factors._energy")
        if self._compiled is not None and kernel is not None and self.keys:
            image = kernel.ImageRows(self._compiled, share, self.pose_key is not None)
            at = packed_pose(pose.matrix()) if self.pose_key is None else self.pose_key
            self.compiled = CompiledRows(image, (at, *vehicle.shape.bound))

    @cached_property
    def kernel(self) -> ProjectionKernel:
        """Projection of the keypoints."""
        return self._projection(self.vehicle.shape)

    def _projection(self, shape: LinearShape) -> ProjectionKernel:
        bound = self._pose if self.pose_key is None else self.pose_key
        return ProjectionKernel(shape, self.problem.camera.matrix, bound, self.focal_key)

    @cached_property
    def _outline(self) -> ProjectionKernel | None:
        """Projection of the points that the box encloses."""
        box = self.problem.energy.box
        return None if box is None else self._projection(self.vehicle.enclosed(box.mean, box.basis))

    @cached_property
    def rows(self) -> ObservationRows | None:
        """The rows of all terms as the factor has them; None where pose and shape are constants."""
        energy = self.problem.energy
        if not self.keys:
            return None
        rows = ObservationRows(
            self.kernel,
            energy.keypoints.rows,
            box=None if energy.box is None else energy.box.rows,
            outline=self._outline,
            ground=None if energy.ground is None or self.pose_key is None else energy.ground.rows,
            compiled=None if self.compiled is None else self.compiled.source,
            share=self.share,
            robust=None if self._strategy.loss is None else self._strategy.robust_loss,
        )
        if self._applied is not None:
            rows.form, rows.right, rows.wrong, rows.edge_weights, rows.height_sigma = self._applied
        return rows

    @property
    def is_robust(self) -> bool:
        """Whether the factor that is solved has the robust loss inside, so that one solve finds its minimum."""
        return self._mixture and bool(self.keys)

    @cached_property
    def factor(self) -> gtsam.CustomFactor | None:
        """The factor of all terms as the solver gets it, the same one whatever is applied to it; None of constants."""
        return None if self.rows is None else observation_factor(self.rows)

    def tell(self, weights: Weights, form: Form = Form.NEWTON) -> None:
        """Set the weights of the factor.

        Args:
            weights: The weights; of the mixture those are used that `form` says.
            form: How the mixture is handed to the solver; other strategies have `Form.WEIGHTED`.
        """
        if not self.keys:
            return
        term, ground = self.problem.energy.keypoints, self.problem.energy.ground
        form = form if self._mixture else Form.WEIGHTED
        if form is Form.WEIGHTED:
            right, wrong = self.graph_weights(weights), np.ones(len(weights.keypoints))
        else:
            right, wrong = self._strategy.densities(term.evidence, weights.visibility)
        sigma = 1.0 if ground is None else ground.ground.height_sigma_at_depth(weights.depth)
        if self.compiled is not None:
            self.compiled.source.form = int(form)
            self.compiled.source.tell(right, wrong, weights.box, sigma)
        self._applied = form, right, wrong, weights.box, sigma
        if (rows := vars(self).get("rows")) is not None:  # made when they are asked for
            rows.form, rows.right, rows.wrong, rows.edge_weights, rows.height_sigma = self._applied

    @property
    def judges(self) -> bool:
        """Whether the compiled rows find the weights themselves."""
        return self.is_robust and self.compiled is not None

    def see(self, weights: Weights, form: Form) -> None:
        """The same as `tell` for the compiled rows alone, where they judge."""
        assert self.compiled is not None
        self.compiled.source.form = int(form)
        self.compiled.source.see(weights.visibility, weights.box, weights.depth)

    def judged(self, found: Array, held: Weights | None) -> Weights:
        """Weights by what the compiled rows found at a point (`factors._energy.ImageRows.judge`).

        Args:
            found: What they found.
            held: The weights until now, where visibility and the ground's uncertainty were kept as they are there.
        """
        count = self.vehicle.shape.size
        weights, box = found[:count], found[-7:-3]
        if held is not None:
            return Weights(weights, held.visibility, box, held.depth)
        return Weights(weights, found[count:-7], box, float(found[-1]))

    def jacobian(self, values: gtsam.Values, weights: Weights) -> Array:
        """(rows, D) derivative of the factor's rows by its variables, one after the other, with weights."""
        self.tell(weights, Form.WEIGHTED)
        if self.compiled is None:
            assert self.factor is not None
            return self.factor.linearize(values).jacobian()[0]
        source, shape = self.compiled.source, self.vehicle.shape
        by_all = np.empty((source.rows, source.columns))
        at = packed_pose(self.pose(values).matrix()), shape.coefficients(values), shape.offsets(values)
        source.evaluate(at, np.empty(source.rows), by_all)
        free = [isinstance(variable, int) for variable in self.compiled.variables]
        return by_all if all(free) else by_all[:, np.repeat(free, [dim for _, dim, _ in source.takes])]

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
        here = self._assess(values, before.visibility if hold else None, before.keypoints, progress)
        depth = before.depth if hold else self.pose(values).z()
        return Weights(here.keypoints, here.visibility, here.box, depth)

    def graph_weights(self, weights: Weights) -> Array:
        """(K,) weights in the factor: without an m-estimator's share, which the factor has itself."""
        if self._strategy.loss is None:
            return weights.keypoints
        return self._strategy.initial_weights(self.problem.energy.keypoints.evidence, weights.visibility)

    def terms(self, weights: Weights) -> dict[str, list[gtsam.NonlinearFactor]]:
        """The same rows as a factor of their own for each energy term that says something under the weights."""
        if self.rows is None:
            return {}
        self.tell(weights, Form.WEIGHTED)
        rows, box = copy(self.rows), self.problem.energy.box
        silent = set()
        if not (rows.right >= SMALLEST_WEIGHT).any():
            silent.add("reprojection")
        if box is not None and not (box.rows.used & (weights.box >= SMALLEST_WEIGHT)).any():
            silent.add("box")
        return {name: [term_factor(rows, name)] for name in rows.terms if name not in silent}

    def energies(self, values: gtsam.Values, weights: Weights) -> dict[str, float]:
        """Energy of each term, nats: of keypoints and box the robust one that the weights stand for."""
        energy = self.problem.energy
        keypoints, box = self._assess(values, weights.visibility).energies
        terms = {"reprojection": self.share * keypoints, "cheirality": 0.0}
        if energy.box is not None:
            terms["box"] = self.share * box
        if energy.ground is not None and self.pose_key is not None:
            sigma = energy.ground.ground.height_sigma_at_depth(weights.depth)
            terms["ground"] = self.share * (self._off_ground(values, sigma) + math.log(sigma))
        if energy.direction is not None:
            terms["direction"] = self.share * float(energy.direction.energy(self._hypothesis(values))[0])
        return terms

    def _off_ground(self, values: gtsam.Values, sigma: float) -> float:
        """Half the squared deviation from the ground, whose height is known to sigma metres there."""
        assert self.problem.energy.ground is not None
        pose = self.pose(values).matrix()
        return self.problem.energy.ground.rows.energy(pose[:3, :3], pose[:3, 3], sigma)

    def projections(self, values: gtsam.Values) -> Array:
        """(K, 2) projected keypoints, pixels."""
        return self.kernel.evaluate(values).pixels

    def _assess(
        self, values: gtsam.Values, visibility: Array | None, previous: Array | None = None, progress: float = 1.0
    ) -> _Assessed:
        """Weights and energies of the strategy, with a visibility or with that of the pose."""
        last = self._last
        if self._mixture and last is not None and last.values is values and last.answers(visibility):
            return last
        if self._compiled is not None:
            shape, visible = self.vehicle.shape, np.empty(self.vehicle.shape.size) if visibility is None else visibility
            weights, _, _, edges, *energies = self._compiled.assess(
                self.pose(values).matrix(),
                shape.coefficients(values),
                shape.offsets(values),
                visible,
                visibility is None,
            )
        else:
            energy, term, box = self.problem.energy, self.problem.energy.keypoints, self.problem.energy.box
            visible = energy.visibility(self.pose(values).matrix()[None])[0] if visibility is None else visibility
            squares = np.square(term.rows.residual(self.kernel.evaluate(values).pixels)).sum(axis=1)
            weights, robust = term.strategy.evaluate(
                squares, term.evidence, visible, previous=previous, progress=progress
            )
            edges, box_energy = np.zeros(4), np.zeros(())
            if box is not None and self._outline is not None:
                extents = projected_extents(self._outline, values, box.rows.softness)[0]
                edges, _, box_energy = box.rows.assess(box.rows.residual(extents))
            energies = [float(robust), float(box_energy)]
        self._last = _Assessed(values, visible, visibility is None, weights, edges, (energies[0], energies[1]))
        return self._last

    def camera(self, values: gtsam.Values) -> Camera:
        """The camera at the values."""
        if self.focal_key is None:
            return self.problem.camera
        return replace(self.problem.camera, matrix=self.kernel.matrix(values))

    def _hypothesis(self, values: gtsam.Values) -> Hypotheses:
        matrix = self.pose(values).matrix()
        return Hypotheses(matrix[None, :3, :3], matrix[None, :3, 3], self.vehicle.read(values)[0][None])
