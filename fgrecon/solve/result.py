"""From the state at which the optimisation ended to the result, and how far to trust it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.deferred import Deferred
from fgrecon.core.detection import calibrated_facing, facing_probability
from fgrecon.core.geometry import transform, view_azimuth
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative, GraphFactor, Iteration, Reconstruction, Status, rotation_y
from fgrecon.core.size_prior import LONGEST, SHORTEST
from fgrecon.core.status import Regions
from fgrecon.core.text import counted
from fgrecon.solve.box_check import box_excess
from fgrecon.solve.graph.covariance import Covariances, Spread, factorise, read_covariances
from fgrecon.solve.graph.graph import Graph, GraphObservation
from fgrecon.solve.graph.history import iterations
from fgrecon.solve.graph.multi_start import MultiStartResult
from fgrecon.solve.graph.observation_part import ObservationPart, Weights
from fgrecon.solve.graph.optimise import Optimum
from fgrecon.solve.graph.structure import graph_factors
from fgrecon.solve.pose_probability import facing_by_energies, with_probabilities
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.proposals.problem import Problem, keypoint_covariances
from fgrecon.solve.vehicle.visibility import clearance, occluder, probability
from fgrecon.solve.weakness import weaknesses

__all__ = ["Counted", "count", "history_of", "results", "weakened"]

_SURE_FACING = 0.8
"""Less is ambiguous: 80 % of the cars that are turned round on KITTI's video, and 6 % of the others."""
_ABSURD = 5.0  # times longer, wider or higher than the prior's mean, or as many times less: no such vehicle
_LOOSE = np.deg2rad(30.0)  # a rotation known no better than this is not determined
_SMALL_TURN = 10  # degrees: of a pose that is turned by less it is told how far away it is


@dataclass(frozen=True)
class Counted:
    """What is known at the end of an optimisation.

    Attributes:
        values: All variables.
        weights: Those with which each observation counts for covariances.
        marginals: Of the variables, sizes counted once; None where a direction is not determined, or there is no end.
    """

    values: gtsam.Values
    weights: Sequence[Weights]
    marginals: gtsam.Marginals | Spread | None


def count(graph: Graph, optimum: Optimum, at_once: Collection[int] | None = None) -> Counted:
    """What is known at the end of an optimisation of a graph.

    Args:
        graph: The graph.
        optimum: Its end.
        at_once: Indices of the observations whose covariances are wanted by one factorisation (`Spread`), which is
            quicker for frames of one vehicle; None for those of all by `gtsam.Marginals`.
    """
    values = graph.values(optimum.state)
    weights = [_common(part, w) for part, w in zip(graph.observations, optimum.state.weights, strict=True)]
    marginals: gtsam.Marginals | Spread | None = None
    if optimum.failure is None:
        built = graph.for_covariances(weights)
        asked = None if at_once is None else _asked(graph, at_once)
        marginals = factorise(built, values) if asked is None else Spread.of(built, values, asked)
    return Counted(values, weights, marginals)


def _asked(graph: Graph, some: Collection[int]) -> set[int]:
    """The variables whose covariances results need: the poses of some observations, and all shapes."""
    poses = {part.pose_key for i, part in enumerate(graph.observations) if part.pose_key is not None and i in some}
    return poses | {key for vehicle in graph.vehicles.values() for key in vehicle.shape.keys}


def results(
    seen: Sequence[GraphObservation],
    starts: Sequence[PoseEstimate],
    adjusted: MultiStartResult,
    milliseconds: dict[str, float],
    extra: Sequence[gtsam.NonlinearFactor] = (),
    only: Collection[int] | None = None,
    facing: Sequence[float | None] | None = None,
    counted: Counted | None = None,
) -> list[Reconstruction]:
    """The result of each observation.

    Args:
        seen: The observations.
        starts: Their proposals.
        adjusted: Where the graph's optimisation ended.
        milliseconds: Wall time by stage.
        extra: Factors of the caller's own.
        only: Indices of the observations whose results are wanted; None for all.
        facing: How probable the facing of each is where more than its directions tells; None where only they do.
        counted: What `count` says of the graph, where that is known already.
    """
    graph, optimum = adjusted.graph, adjusted.optimum
    if not seen[0].problem.options.shape.joint:  # covariances count pose and shape together, whichever came last
        graph = Graph(seen, optimum.state, pose_free=True, extra=extra)
    weights = optimum.state.weights
    known = count(graph, optimum) if counted is None else counted
    alone = len(seen) == 1
    keep = seen[0].problem.options.keep_history
    structure: Sequence[GraphFactor] = ()
    if keep and alone and optimum.failure is None:
        structure = Deferred(lambda: graph_factors(graph, weights))
    found: list[Reconstruction] = []
    shapes: dict[int, NDArray[np.float64]] = {}
    for i, (part, start) in enumerate(zip(graph.observations, starts, strict=True)):
        if only is not None and i not in only:
            continue
        if optimum.failure is not None:
            energies = {}
        elif alone:
            energies = optimum.energies
        else:
            energies = part.energies(known.values, weights[i])
        history = history_of(start, adjusted, i, alone=alone) if keep else ()
        uncertainty = read_covariances(part, known.weights[i], known.values, known.marginals, shapes)
        others, told = adjusted.alternatives[i], None if facing is None else facing[i]
        found.append(_result(part, optimum, i, others, told, uncertainty, energies, history, structure, milliseconds))
    return found


def _common(part: ObservationPart, weights: Weights) -> Weights:
    """The weights with which keypoints and box count for covariances: a detector's errors go together."""
    by_keypoints, by_box = part.problem.common_factor, part.problem.box_common_factor
    return replace(weights, keypoints=weights.keypoints / by_keypoints, box=weights.box / by_box)


def history_of(start: PoseEstimate, adjusted: MultiStartResult, index: int, *, alone: bool) -> Sequence[Iteration]:
    """Every step of an observation, made when it is looked at."""
    return Deferred(lambda: (*start.history, *iterations(adjusted.stages, index, alone=alone)))


def _result(
    part: ObservationPart,
    optimum: Optimum,
    index: int,
    alternatives: tuple[Alternative, ...],
    told: float | None,
    uncertainty: Covariances | None,
    energies: dict[str, float],
    history: Sequence[Iteration],
    structure: Sequence[GraphFactor],
    milliseconds: dict[str, float],
) -> Reconstruction:
    problem, prior, camera = part.problem, part.problem.model.prior, part.camera(optimum.values)
    weights = optimum.state.weights[index]
    coefficients, offsets = optimum.state.shapes[part.vehicle.number]
    camera_T_object = optimum.state.poses[index].matrix()
    wireframe = prior.keypoints(coefficients, offsets)
    in_camera = transform(camera_T_object, wireframe)
    surface = occluder(prior)
    vertices = surface.vertices(coefficients)
    centre = -camera_T_object[:3, :3].T @ camera_T_object[:3, 3]
    box_size = prior.category.box_size(wireframe)
    facing = _facing(part, camera_T_object) if told is None else told
    relative = box_size / problem.model.dimension_mean
    status, message = _status(
        camera_T_object, box_size, relative, facing, alternatives, uncertainty, problem.options, optimum
    )
    if np.isnan(facing) and part.share == 1.0 and np.isfinite(camera_T_object).all() and np.isfinite(optimum.gain):
        facing = facing_by_energies(camera_T_object, alternatives)
    others = with_probabilities(camera_T_object, coefficients, alternatives, facing)
    reasons: tuple[str, ...] = ()
    if status.determined:
        seen = problem.observation, weights.keypoints, problem.camera, camera_T_object
        reasons = weaknesses(*seen, coefficients, box_size, problem.ground)
    sigma = np.sqrt(np.sqrt(np.linalg.det(keypoint_covariances(problem.observation, problem.options.keypoints))))
    with np.errstate(divide="ignore"):
        sigmas = sigma / np.sqrt(weights.keypoints)
    found = Reconstruction(
        status=status,
        message=message,
        category=prior.category.name,
        prior=prior.name,
        keypoint_names=prior.category.keypoints,
        camera_T_object=camera_T_object,
        coefficients=coefficients,
        offsets=offsets,
        wireframe=wireframe,
        wireframe_uv=camera.distort(camera.project(in_camera)),
        edges=np.array(prior.category.edges, dtype=np.int64).reshape(-1, 2),
        box_size=box_size,
        weights=weights.keypoints,
        sigmas=sigmas,
        visibility=probability(clearance(vertices, surface.faces, wireframe, centre)),
        pose_covariance=None if uncertainty is None else uncertainty.pose,
        coefficients_covariance=None if uncertainty is None else uncertainty.coefficients,
        keypoint_covariance=None if uncertainty is None else uncertainty.keypoints,
        energies=energies,
        alternatives=others,
        history=history,
        milliseconds=milliseconds,
        surface_vertices=None if prior.surface is None else vertices,
        surface_faces=None if prior.surface is None else surface.triangles,
        faces={face.name: face.keypoints for face in prior.category.faces},
        symmetric_pairs=np.array(prior.category.symmetric_pairs, dtype=np.int64).reshape(-1, 2),
        graph=structure,
        graph_iterations=optimum.iterations,
        graph_gain=optimum.gain,
        facing_probability=facing,
        size_covariance=None if uncertainty is None else uncertainty.size,
        regions=_regions(problem),
        box_excess=box_excess(problem, camera_T_object, coefficients, camera) if status.determined else float("nan"),
    )
    return weakened(found, reasons)


def _regions(problem: Problem) -> Regions:
    if problem.assumed:
        return Regions.ASSUMED
    return Regions.FITTED if problem.options.keypoints.fitted else Regions.SHIPPED


def weakened(result: Reconstruction, reasons: Sequence[str], status: Status = Status.WEAK) -> Reconstruction:
    """The result with further reasons to be weak, or ambiguous, which it is where it had converged."""
    if not reasons:
        return result
    told = (*result.reasons, *reasons)
    if not result.status.settled:
        return replace(result, reasons=told)
    text = "; ".join(told if status is Status.WEAK else reasons)
    return replace(result, status=status, message=f"{text[0].upper()}{text[1:]}.", reasons=told)


def _facing(part: ObservationPart, camera_T_object: NDArray[np.float64]) -> float:
    """How probable the facing is by the observation's directions; NaN where there are none, or other images decide."""
    directions = part.problem.observation.azimuth
    if directions is None or part.share < 1.0 or not np.isfinite(camera_T_object).all():
        return float("nan")
    azimuth = float(view_azimuth(camera_T_object[:3, :3], camera_T_object[:3, 3]))
    detector = part.problem.options.keypoints
    return calibrated_facing(facing_probability(directions, azimuth), detector.facing_bias, detector.facing_slope)


def _status(
    camera_T_object: NDArray[np.float64],
    box_size: NDArray[np.float64],
    relative_size: NDArray[np.float64],
    facing: float,
    alternatives: tuple[Alternative, ...],
    uncertainty: Covariances | None,
    options: Options,
    optimum: Optimum,
) -> tuple[Status, str]:
    if optimum.failure is not None:
        return Status.FAILED, f"The graph's solve failed ({optimum.failure}); this is the state before."
    if uncertainty is None:
        return Status.DEGENERATE, "The keypoints with any weight leave pose or shape undetermined."
    if optimum.unfinished is not None:
        return Status.DEGENERATE, f"The solver was stopped {optimum.unfinished}: near a minimum, not at one."
    possible = box_size.min() > SHORTEST and box_size.max() < LONGEST
    if not (relative_size > 1.0 / _ABSURD).all() or not (relative_size < _ABSURD).all() or not possible:
        length, width, height = box_size.tolist()
        return Status.DEGENERATE, f"No vehicle measures {length:.2f} x {width:.2f} x {height:.2f} m."
    if camera_T_object[2, 3] <= 0.0:
        return Status.DEGENERATE, f"The vehicle's origin is behind the camera ({camera_T_object[2, 3]:.2f} m)."
    turned = uncertainty.pose[:3, :3]
    if np.trace(turned) > _LOOSE**2 and (turn := float(np.sqrt(np.linalg.eigvalsh(turned)[-1]))) > _LOOSE:
        return Status.DEGENERATE, f"The orientation is known to {np.rad2deg(turn):.0f} degrees only (1 sigma)."
    close = [a for a in alternatives if a.excess <= options.ambiguity_margin]
    if close:
        turn = rotation_y(close[0].camera_T_object) - rotation_y(camera_T_object)
        degrees = round(abs(np.rad2deg(float(wrap_angle(turn)))))
        told = f"turned by {counted(degrees, 'degree')}"
        if degrees < _SMALL_TURN:
            metres = np.linalg.norm(close[0].camera_T_object[:3, 3] - camera_T_object[:3, 3])
            told = f"{metres:.2f} m and {counted(degrees, 'degree')} away"
        return Status.AMBIGUOUS, f"A pose {told} is only {close[0].excess:.1f} nats worse."
    if facing < _SURE_FACING:
        return Status.AMBIGUOUS, f"The detector's directions leave {100 * (1 - facing):.0f} % for the other facing."
    return Status.CONVERGED, "The pose search and the graph found one pose and a minimum there."
