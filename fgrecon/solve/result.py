"""The result of an optimisation's final state, with its uncertainty and status."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import MIN_DEPTH, Camera
from fgrecon.core.checks import own
from fgrecon.core.depth_map import DepthMap, middle_of
from fgrecon.core.detection import calibrated_facing, pose_facing_probability
from fgrecon.core.geometry import transform
from fgrecon.core.history import Deferred
from fgrecon.core.input_warnings import DEPTHS_ELSEWHERE
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.observation import Observation
from fgrecon.core.options import KeypointOptions
from fgrecon.core.reconstruction import (
    Alternative,
    Diagnostics,
    GraphFactor,
    Iteration,
    Pose,
    Reconstruction,
    Shape,
    Status,
    Uncertainty,
    rotation_y,
)
from fgrecon.core.result_fields import Regions
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.core.size_prior import LONGEST, SHORTEST
from fgrecon.core.text import counted
from fgrecon.solve.box_check import box_excess
from fgrecon.solve.graph.covariance import Covariances, Spread, covariance_of, marginals_of, read_covariances
from fgrecon.solve.graph.graph import Graph, GraphObservation
from fgrecon.solve.graph.multi_start import MultiStartResult
from fgrecon.solve.graph.observation_part import ObservationPart, Weights
from fgrecon.solve.graph.optimise import Optimum
from fgrecon.solve.graph.records import factors_of, graph_factors, iterations
from fgrecon.solve.pose_probability import facing_by_energies, with_probabilities
from fgrecon.solve.proposals.point_term import DEPTH_NAME, POINTS, POINTS_NAME
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.proposals.scaled_depth import ScaledDepth
from fgrecon.solve.solve_settings import STATUS
from fgrecon.solve.vehicle.visibility import clearance, occluder, probability
from fgrecon.solve.weakness import too_large_box, weakened, weaknesses


@dataclass(frozen=True)
class Marginalised:
    """What is known at the end of an optimisation."""

    values: gtsam.Values  # all variables
    weights: Sequence[Weights]  # those with which each observation counts for covariances
    # of the variables, sizes counted once; None where a direction is not determined, or there is no end
    marginals: Spread | None


def marginalise(graph: Graph, optimum: Optimum, at_once: Collection[int] | None = None) -> Marginalised:
    """What is known at the end of an optimisation of a graph.

    Args:
        optimum: Its end.
        at_once: Indices of the observations whose covariances are needed by one factorisation (`Spread`), which is
            quicker for frames of one vehicle; None for those of all by `gtsam.Marginals`.
    """
    values = graph.values(optimum.state)
    weights = common_weights(graph, optimum.state.weights)
    if optimum.failure is not None:
        return Marginalised(values, weights, None)
    graph.look(values)
    keys: set[int] | None = None
    if at_once is not None:
        keys = _keys_of(graph, at_once) | graph.shared.known.keys()
    return Marginalised(values, weights, marginals_of(graph, values, weights, keys))


def _keys_of(graph: Graph, indices: Collection[int]) -> set[int]:
    """Of the poses of some observations, and of all shapes."""
    parts = [part for i, part in enumerate(graph.observations) if i in indices]
    keys = {part.pose_key for part in parts if part.pose_key is not None}
    return keys | {key for vehicle in graph.vehicles.values() for key in vehicle.shape.keys}


def common_weights(graph: Graph, weights: Sequence[Weights]) -> list[Weights]:
    """The weights with which keypoints and boxes count for covariances: a detector's errors go together."""
    return [_common(part, one) for part, one in zip(graph.observations, weights, strict=True)]


def _common(part: ObservationPart, weights: Weights) -> Weights:
    by_keypoints, by_box = part.problem.common_factor, part.problem.box_common_factor
    return replace(weights, keypoints=weights.keypoints / by_keypoints, box=weights.box / by_box)


def results(
    parts: Sequence[GraphObservation],
    starts: Sequence[PoseEstimate],
    adjusted: MultiStartResult,
    milliseconds: dict[str, float],
    extra: Sequence[gtsam.NonlinearFactor] = (),
    only: Collection[int] | None = None,
    facing: Sequence[float | None] | None = None,
    marginalised: Marginalised | None = None,
) -> list[Reconstruction]:
    """The result of each observation.

    Args:
        starts: Their proposals.
        adjusted: Where the graph's optimisation ended.
        milliseconds: Wall time by stage.
        extra: Factors of the caller's own.
        only: Indices of the observations whose results are requested; None for all.
        facing: How probable the facing of each is where more than its directions says; None where only they do.
        marginalised: What `marginalise` says of the graph, where that is known already.
    """
    graph, optimum = adjusted.graph, adjusted.optimum
    options = parts[0].problem.options
    if not options.shape.joint:  # covariances count pose and shape together, whichever came last
        graph = Graph(parts, optimum.state, pose_free=True, extra=extra)
    weights = optimum.state.weights
    known = marginalise(graph, optimum) if marginalised is None else marginalised
    single, failed = len(parts) == 1, optimum.failure is not None
    values = optimum.values if graph is adjusted.graph else known.values
    found: list[Reconstruction] = []
    shapes: dict[int, Array] = {}
    without: dict[str, Spread | None] = {}  # what is known without a kind of evidence
    indices = [i for i in range(len(parts)) if only is None or i in only]
    if known.marginals is not None:
        keys = None if only is None else _keys_of(graph, only)
        for name in sorted({name for i in indices for name in graph.names_of(i)}):
            without[name] = marginals_of(graph, known.values, known.weights, keys, silent=name)
    for i in indices:
        part, start = graph.observations[i], starts[i]
        uncertainty = read_covariances(part, known.weights[i], known.values, known.marginals, shapes)
        points, point_weights = graph.points_of(i)
        gained = {} if uncertainty is None else _gained(graph, i, uncertainty, without)
        if uncertainty is not None and len(points):
            uncertainty = uncertainty.with_unseen_underside(POINTS.underside_sigma_m)
        end = _End(part, optimum, i, adjusted.alternatives[i], None if facing is None else facing[i], uncertainty)
        diagnostics = {
            "energies": {} if failed else optimum.energies if single else graph.energies_of(i, values, weights[i]),
            "history": pose_history(start, adjusted, i, single=single) if options.keep_history else (),
            "graph": _structure(graph, i, weights) if options.keep_history and not failed else (),
            "milliseconds": milliseconds,
            "points": points,
            "point_weights": point_weights,
            "own_shares": _own_shares(graph, i, values),
            "evidence": gained,
            **_shared_errors(graph, known, i),
        }
        found.append(_result(end, diagnostics))
    return found


def _structure(graph: Graph, index: int, weights: Sequence[Weights]) -> Sequence[GraphFactor]:
    """The factors about an observation, made when they are looked at; none where others show its vehicle as well."""
    if len(graph.observations) == 1:
        return Deferred(lambda: graph_factors(graph, weights))
    return Deferred(lambda: factors_of(graph, index, weights)) if graph.shares_nothing(index) else ()


def _gained(
    graph: Graph, index: int, uncertainty: Covariances, without: Mapping[str, Spread | None]
) -> dict[str, float]:
    """By how many times each kind of evidence makes a position's standard deviation smaller.

    Nothing of a kind that the observation has not, or where there is no covariance without it.
    """
    part, found = graph.observations[index], {}
    for name in graph.names_of(index):
        before = None if part.pose_key is None else covariance_of(without.get(name), part.pose_key)
        if before is not None:
            found[name] = float(np.sqrt(np.trace(before[3:, 3:]) / np.trace(uncertainty.pose[3:, 3:])))
    return found


def _own_shares(graph: Graph, index: int, values: gtsam.Values) -> dict[str, float]:
    """By what measured points, the share of those in the middle of an observation's 2D box that are the vehicle's."""
    part, found = graph.observations[index], dict[str, float]()
    box, intrinsics = part.problem.observation.place, part.camera(values).matrix
    for name in sorted(graph.names_of(index) & {POINTS_NAME, DEPTH_NAME}):
        points, weights = graph.points_of(index, name)
        assert box is not None  # else there would be no points
        pixels = (points @ intrinsics.T)[:, :2] / np.maximum(points[:, 2:], MIN_DEPTH)
        low, high = np.split(middle_of(box), 2)
        own = weights[((pixels > low) & (pixels < high)).all(axis=1)] >= POINTS.used_weight
        if len(own) >= POINTS.least_in_middle:
            found[name] = float(own.mean())
    return found


def _shared_errors(graph: Graph, known: Marginalised, index: int) -> dict[str, Array]:
    """Scale and shift (Q, 2) of each depth map, and errors (S, 6) of sensors' places, that an observation shares.

    Each with their covariances.
    """
    found: dict[str, list[Array]] = {}
    for key in graph.shared.of(graph.observations[index]):
        if known.values.exists(key):
            variables, shared = known.values.atVector(key), graph.shared.known[key]
            covariance = covariance_of(known.marginals, key)
            unsure = np.full(2 * (len(variables),), np.nan) if covariance is None else covariance
            names = "place_errors", "place_covariances"
            if isinstance(shared, ScaledDepth):
                scale, shift, unsure = shared.calibrated(variables, unsure)
                names, variables = ("depth_scales", "depth_covariances"), np.array([scale, shift])
            for name, value in zip(names, (variables, unsure), strict=True):
                found.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in found.items()}


def pose_history(
    start: PoseEstimate, adjusted: MultiStartResult, index: int = 0, *, single: bool = True
) -> Sequence[Iteration]:
    """Every step of an observation, made when it is looked at."""
    return Deferred(lambda: (*start.history, *iterations(adjusted.stages, index, alone=single)))


@dataclass(frozen=True)
class _End:
    """Where an observation has ended."""

    part: ObservationPart  # the observation in its graph
    optimum: Optimum  # the end of the graph
    index: int  # of the observation
    alternatives: tuple[Alternative, ...]  # its other poses
    # how probable its facing is where more than its directions says; None where only they do
    given_facing: float | None
    uncertainty: Covariances | None  # its covariances; None where they cannot be had

    @property
    def pose(self) -> Array:
        """(4, 4) camera_T_object."""
        return np.asarray(self.optimum.state.poses[self.index].matrix())

    @property
    def weights(self) -> Array:
        """(K,) of the keypoints."""
        return self.optimum.state.weights[self.index].keypoints

    @property
    def shape(self) -> tuple[Array, Array]:
        """Lambda (N,) and offsets (K, 3)."""
        return self.optimum.state.shapes[self.part.vehicle.number]

    @property
    def facing(self) -> float:
        """How probable the facing is; NaN where nothing says, or other images decide."""
        if self.given_facing is not None:
            return self.given_facing
        if self.part.share < 1.0 or not np.isfinite(self.pose).all():
            return float("nan")
        return _image_facing(self.part.problem, self.pose)


def _image_facing(problem: Problem, camera_T_object: Array) -> float:
    """How probably a pose (4, 4) faces the right way by the directions of its image; NaN without any."""
    directions, detector = problem.observation.azimuth, problem.options.keypoints
    if directions is None:
        return float("nan")
    probability = pose_facing_probability(directions, camera_T_object)
    return calibrated_facing(probability, detector.facing_bias, detector.facing_slope)


def _result(end: _End, diagnostics: dict[str, Any]) -> Reconstruction:
    problem, camera = end.part.problem, end.part.camera(end.optimum.values)
    prior, category = problem.model.prior, problem.model.prior.category
    (coefficients, offsets), camera_T_object, uncertainty = end.shape, end.pose, end.uncertainty
    wireframe = prior.keypoints(coefficients, offsets)
    box_size = category.box_size(wireframe)
    (status, message), facing = _status(end, box_size), end.facing
    excess = box_excess(problem, end.pose, coefficients, camera) if status.determined else float("nan")
    if np.isnan(facing) and end.part.share == 1.0 and np.isfinite([*camera_T_object.flat, end.optimum.gain]).all():
        facing = facing_by_energies(camera_T_object, end.alternatives)
    found = Reconstruction(
        status=status,
        message=message,
        pose=Pose.with_later(
            {"wireframe_uv": partial(_projected, camera, camera_T_object, wireframe)},
            camera_T_object=camera_T_object,
        ),
        shape=Shape.with_later(
            {} if prior.surface is None else _surface(prior.surface, coefficients),
            **_model(prior),
            coefficients=coefficients,
            offsets=offsets,
            wireframe=wireframe,
            box_size=box_size,
        ),
        uncertainty=Uncertainty(
            pose_covariance=None if uncertainty is None else uncertainty.pose,
            coefficients_covariance=None if uncertainty is None else uncertainty.coefficients,
            keypoint_covariance=None if uncertainty is None else uncertainty.keypoints,
            alternatives=with_probabilities(camera_T_object, coefficients, end.alternatives, facing),
            facing_probability=facing,
            size_covariance=None if uncertainty is None else uncertainty.size,
            regions=_regions(problem),
        ),
        diagnostics=Diagnostics.with_later(
            {
                "sigmas": partial(_sigmas, problem.observation, problem.options.keypoints, end.weights),
                "visibility": partial(_visibility, prior, camera_T_object, coefficients, wireframe),
            },
            weights=end.weights,
            graph_iterations=end.optimum.iterations,
            graph_gain=end.optimum.gain,
            box_excess=excess,
            left_out=(*problem.observation.left_out, *_depths_elsewhere(problem, camera_T_object)),
            **diagnostics,
        ),
    )
    if not status.determined:
        return found
    return weakened(found, (*_reasons(end, box_size, diagnostics["point_weights"]), *too_large_box(excess)))


def _depths_elsewhere(problem: Problem, camera_T_object: Array) -> Iterator[str]:
    """What to say of depth maps in metres by which a vehicle is where it is not."""
    observation, metres = problem.observation, camera_T_object[2, 3]
    for one in observation.evidence:
        if isinstance(one, DepthMap) and observation.place is not None and metres > MIN_DEPTH:
            times = one.times_too_far(observation.place, metres)
            if times is not None:
                yield f"{DEPTHS_ELSEWHERE}, its pixels there are {times:.2g} times as far as the vehicle."


def _reasons(end: _End, box_size: Array, point_weights: Array) -> tuple[str, ...]:
    """Why a pose is weak."""
    problem, category = end.part.problem, end.part.problem.model.prior.category
    reasons = weaknesses(
        problem.observation,
        end.weights,
        problem.camera,
        end.pose,
        end.shape[0],
        box_size,
        problem.ground,
        float(point_weights.sum()),
    )
    if (size := problem.model.size) is not None and size.coarse is not None:
        coarse = "a cuboid" if category.name == size.coarse else f"a stretched {category.name}'s"
        reasons = (*reasons, f"the shape of a {' or '.join(size.classes)} is {coarse}")
    return reasons


@lru_cache(maxsize=16)
def _model(prior: ShapePrior) -> Mapping[str, Any]:
    """What the shapes of all results of a prior have in common."""
    category = prior.category
    return {
        "category": category.name,
        "prior": prior.name,
        "keypoint_names": category.keypoints,
        "edges": own(np.array(category.edges, dtype=np.int64).reshape(-1, 2)),
        "faces": {face.name: face.keypoints for face in category.faces},
        "symmetric_pairs": own(np.array(category.symmetric_pairs, dtype=np.int64).reshape(-1, 2)),
    }


def _surface(surface: Surface, coefficients: Array) -> dict[str, Callable[[], Any]]:
    vertices = partial(surface.vertices, coefficients)
    return {"surface_vertices": vertices, "surface_faces": partial(getattr, surface, "triangles")}


def _projected(camera: Camera, camera_T_object: Array, points: Array) -> Array:
    return camera.distort(camera.project(transform(camera_T_object, points)))


def _sigmas(observation: Observation, options: KeypointOptions, weights: Array) -> Array:
    sigma = np.sqrt(np.sqrt(np.linalg.det(keypoint_covariances(observation, options))))
    with np.errstate(divide="ignore"):
        sigmas: Array = sigma / np.sqrt(weights)
    return sigmas


def _visibility(prior: ShapePrior, camera_T_object: Array, coefficients: Array, wireframe: Array) -> Array:
    surface, centre = occluder(prior), -camera_T_object[:3, :3].T @ camera_T_object[:3, 3]
    return probability(clearance(surface.vertices(coefficients), surface.faces, wireframe, centre))


def _regions(problem: Problem) -> Regions:
    if problem.assumed:
        return Regions.ASSUMED
    return Regions.FITTED if problem.options.keypoints.fitted else Regions.SHIPPED


def with_gains(result: Reconstruction, gained: Mapping[str, float]) -> Reconstruction:
    """The result with what further kinds of evidence took off."""
    if not gained:
        return result
    evidence = {**result.diagnostics.evidence, **gained}
    return replace(result, diagnostics=replace(result.diagnostics, evidence=evidence))


def with_facing_over_time(result: Reconstruction, problem: Problem) -> Reconstruction:
    """A frame's result with a facing by all frames, ambiguous unless that is sure or the image by itself says the same.

    Frames of one vehicle err together, and what they leave to the other facing is less than what it is.

    Args:
        problem: What the frame's image shows, as it was given.
    """
    facing, alone = result.facing_probability, _image_facing(problem, result.camera_T_object)
    if facing >= STATUS.sure_facing or alone >= STATUS.ambiguous_facing:
        return result
    left = f"all frames leave {100 * (1 - facing):.0f} % for the other facing, and this one alone does not tell"
    return weakened(result, (left,), Status.AMBIGUOUS)


def _status(end: _End, box_size: Array) -> tuple[Status, str]:
    optimum, uncertainty, pose = end.optimum, end.uncertainty, end.pose
    problem, facing = end.part.problem, end.facing
    if optimum.failure is not None:
        return Status.FAILED, f"The graph's solve failed ({optimum.failure}); this is the state before."
    if uncertainty is None:
        return Status.DEGENERATE, "The keypoints with any weight leave pose or shape undetermined."
    if optimum.unfinished is not None:
        return Status.DEGENERATE, f"The solver was stopped {optimum.unfinished}: near a minimum, not at one."
    ratio, most = box_size / problem.model.dimension_mean, STATUS.size_ratio
    possible = box_size.min() > SHORTEST and box_size.max() < LONGEST
    if not (ratio > 1.0 / most).all() or not (ratio < most).all() or not possible:
        length, width, height = box_size.tolist()
        return Status.DEGENERATE, f"No vehicle measures {length:.2f} x {width:.2f} x {height:.2f} m."
    if pose[2, 3] <= 0.0:
        return Status.DEGENERATE, f"The vehicle's origin is behind the camera ({pose[2, 3]:.2f} m)."
    rotation, loose = uncertainty.pose[:3, :3], STATUS.rotation_sigma_rad
    if np.trace(rotation) > loose**2 and (turn := float(np.sqrt(np.linalg.eigvalsh(rotation)[-1]))) > loose:
        known = f"known to {np.rad2deg(turn):.0f} degrees only (1 sigma)" if turn < np.pi else "not known at all"
        return Status.DEGENERATE, f"The orientation is {known}."
    close = [a for a in end.alternatives if a.excess <= problem.options.ambiguity_margin]
    if close:
        turn = rotation_y(close[0].camera_T_object) - rotation_y(pose)
        degrees = round(abs(np.rad2deg(float(wrap_angle(turn)))))
        other = f"turned by {counted(degrees, 'degree')}"
        if degrees < STATUS.small_turn_deg:
            metres = np.linalg.norm(close[0].camera_T_object[:3, 3] - pose[:3, 3])
            other = f"{metres:.2f} m and {counted(degrees, 'degree')} away"
        return Status.AMBIGUOUS, f"A pose {other} is only {close[0].excess:.1f} nats worse."
    if facing < STATUS.ambiguous_facing:
        return Status.AMBIGUOUS, f"The detector's directions leave {100 * (1 - facing):.0f} % for the other facing."
    return Status.CONVERGED, "The pose search and the graph found one pose and a minimum there."
