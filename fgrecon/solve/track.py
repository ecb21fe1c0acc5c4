"""One vehicle over several images: a pose for each, and one shape for all.

    frame 0: reprojection_i, box, cheirality --- X(0,0) --- ground, upright
                        |
    frame 1: reprojection_i, box, cheirality --- X(0,1) --- ground, upright
                        |           ...
    frame t: reprojection_i, box, cheirality --- X(0,t) --- ground, upright
                        |
                       L(0) (lambda) ---- prior N(0, I), planarity, dimensions, Laplacian, ...

Every image is searched for its pose alone (`fgrecon.solve.proposals`); then one graph over all poses and the shared
shape is solved under weights that are updated as for a single image. The terms of the shape appear once, so that many
images outweigh the prior where they agree. Nothing is assumed about motion: images may be any views of one vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors import check_in_front
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import GraphFactor, Iteration, Reconstruction, Status
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.core.track_reconstruction import JointStep, TrackReconstruction
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import EARLY_TOLERANCE, FINAL_TOLERANCE, SETTLED, ShapeEstimate
from fgrecon.solve.graph.covariance import factorise, read_covariances
from fgrecon.solve.graph.graph import Terms, VehicleGraph
from fgrecon.solve.graph.solver import minimise
from fgrecon.solve.graph.state import State, graph_weights, iteration, reweigh, robust_energies
from fgrecon.solve.graph.structure import graph_factors
from fgrecon.solve.pipeline import ground_plane, observe
from fgrecon.solve.proposals.adjust import PoseEstimate, adjust_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.result import build_result
from fgrecon.solve.vehicle.model import prepare

__all__ = ["JointStep", "TrackReconstruction", "reconstruct_track"]

Array = NDArray[np.float64]

_OF_A_FRAME = ("reprojection", "box", "cheirality", "ground")
"""Terms that every frame has of its own; the others are the shape's."""


@dataclass
class _Frame:
    """One image on its way through the joint optimisation."""

    number: int
    problem: Problem
    start: PoseEstimate
    graph: VehicleGraph
    state: State
    terms: Terms
    history: list[Iteration]


def reconstruct_track(
    observations: Sequence[Observation | None],
    cameras: Camera | Sequence[Camera],
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizePrior | str | None = None,
    options: Options | None = None,
) -> TrackReconstruction:
    """Recover the poses and the one shape of a vehicle that several images show.

    Args:
        observations: Its keypoints in each image; None where there are none.
        cameras: The camera, or one for each image.
        prior: Shape prior, or its name, or the path of its file.
        ground: Ground plane in every camera's frame; a number is the height in metres of a level camera.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; one so tight that it is a single vehicle's tells its
            shape as well (`fgrecon.solve.vehicle.conditioning`). None takes sizes from the shape prior.
        options: Settings; `joint` must be set.

    Returns:
        The result; images without a pose are in `refused`.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: No image determines a pose.
    """
    options = Options() if options is None else options
    if not options.shape.joint:
        raise InvalidInputError("options.shape.joint", value=False, fix="Let pose and shape move: joint=True.")
    shape_prior = load_prior(prior)
    plane = ground_plane(ground)
    fleet = None if size_prior is None else named_size_prior(size_prior)
    model = prepare(shape_prior, fleet, options.shape.basis_vectors)
    each = [cameras] * len(observations) if isinstance(cameras, Camera) else list(cameras)
    if len(each) != len(observations):
        raise InvalidInputError("cameras", f"{len(each)} for {len(observations)} images", "Give one for each image.")

    started = perf_counter()
    frames: list[_Frame] = []
    refused: dict[int, str] = {}
    for number, (given, camera) in enumerate(zip(observations, each, strict=True)):
        if given is None:
            refused[number] = "no keypoints"
            continue
        seen = observe(given, camera, shape_prior, options)
        try:
            problem = Problem.of(seen, camera, model, plane, options)
            start = adjust_pose(problem)
        except DegenerateProblemError as error:
            refused[number] = str(error)
            continue
        frames.append(_frame(number, problem, start, first=not frames))
    if not frames:
        raise DegenerateProblemError("observations", "no pose in any image", "Give more, or better spread, keypoints.")
    posed = perf_counter()
    history: list[JointStep] = []
    values, failure = _solve(frames, options, history)
    milliseconds = {"pose": (posed - started) * 1e3, "joint": (perf_counter() - posed) * 1e3}
    return _result(frames, refused, values, history, failure, milliseconds)


def _frame(number: int, problem: Problem, start: PoseEstimate, *, first: bool) -> _Frame:
    pose = gtsam.Pose3(start.camera_T_object)
    graph = VehicleGraph(problem, pose, pose_free=True, frame=number, shape_terms=first)
    offsets = np.zeros((len(start.weights), 3))
    state = State(pose, start.coefficients, offsets, start.weights, start.visibility, np.ones(4))
    return _Frame(number, problem, start, graph, state, {}, list(start.history))


def _start(frames: list[_Frame]) -> gtsam.Values:
    """All poses, and the mean of the shapes that the images were found with."""
    coefficients = np.mean([frame.start.coefficients for frame in frames], axis=0)
    first = frames[0]
    values = first.graph.values(first.state.pose, coefficients, first.state.offsets)
    for frame in frames[1:]:
        assert frame.graph.pose_key is not None
        values.insert(frame.graph.pose_key, frame.state.pose)
    return values


def _solve(frames: list[_Frame], options: Options, history: list[JointStep]) -> tuple[gtsam.Values, str | None]:
    """IRLS updates over the joint graph; states, terms and histories of the frames follow.

    Returns:
        The values, and why the optimisation gave up, or None.
    """
    values = _start(frames)
    for frame in frames:
        _follow(frame, values)
    updates = max(options.strategy.updates, 1)
    try:
        for frame in frames:
            check_in_front(frame.graph.kernel, values)
        for update in range(updates):
            change = max([_reweigh(frame, values, update / max(updates - 1, 1)) for frame in frames])
            last = update == updates - 1 or (update > 0 and change < SETTLED and not options.strategy.anneals)
            solution = minimise(
                _graph(frames),
                values,
                relative_tolerance=FINAL_TOLERANCE if last else EARLY_TOLERANCE,
                record=options.keep_history,
            )
            for step, iterate in enumerate(solution.path):
                history.append(_record(frames, update, step, iterate))
            values = solution.values
            for frame in frames:
                _follow(frame, values)
            if last:
                break
    except DegenerateProblemError as error:
        return values, str(error)
    return values, None if solution.converged else f"no minimum in {solution.iterations} iterations"


def _follow(frame: _Frame, values: gtsam.Values) -> None:
    frame.state.pose, frame.state.coefficients, frame.state.offsets = frame.graph.read(values)


def _reweigh(frame: _Frame, values: gtsam.Values, progress: float) -> float:
    """Update a frame's weights and factors; the largest change of a weight."""
    state, before = frame.state, frame.state.weights
    reweigh(state, frame.problem.energy, frame.graph, values, progress)
    weights = graph_weights(frame.problem.energy, state.weights, state.visibility)
    frame.terms = frame.graph.terms(weights, state.box_weights)
    return float(np.abs(state.weights - before).max())


def _graph(frames: list[_Frame]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for frame in frames:
        for term in frame.terms.values():
            for factor in term:
                graph.add(factor)
    return graph


def _record(frames: list[_Frame], update: int, step: int, values: gtsam.Values) -> JointStep:
    """Add a step to the history of every frame; the step of the whole."""
    total: dict[str, float] = {}
    poses = []
    for frame in frames:
        state = frame.state
        at = iteration("joint", update, step, frame.graph, values, state.weights, frame.terms, frame.problem.energy)
        _add(total, at.energies)
        frame.history.append(_own(at))
        poses.append(at.camera_T_object)
    return JointStep(update, step, np.array(poses), at.coefficients, total)


def _own(step: Iteration) -> Iteration:
    """A step with the energies of its frame alone."""
    own = {name: energy for name, energy in step.energies.items() if name in _OF_A_FRAME}
    return Iteration(**{**vars(step), "energies": own})


def _add(total: dict[str, float], energies: Mapping[str, float]) -> None:
    for name, energy in energies.items():
        total[name] = total.get(name, 0.0) + energy


def _result(
    frames: list[_Frame],
    refused: Mapping[int, str],
    values: gtsam.Values,
    history: list[JointStep],
    failure: str | None,
    milliseconds: dict[str, float],
) -> TrackReconstruction:
    marginals = None if failure is not None else factorise(_graph(frames), values)
    total: dict[str, float] = {}
    results = []
    for frame in frames:
        state = frame.state
        energies = robust_energies(frame.graph, values, frame.terms, frame.problem.energy) if frame.terms else {}
        _add(total, energies)
        estimate = ShapeEstimate(
            pose=state.pose,
            coefficients=state.coefficients,
            offsets=state.offsets,
            weights=state.weights,
            visibility=state.visibility,
            box_weights=state.box_weights,
            energies={name: energy for name, energy in energies.items() if name in _OF_A_FRAME},
            history=tuple(frame.history[len(frame.start.history) :]),
            failure=failure,
        )
        uncertainty = None if marginals is None else read_covariances(frame.graph, marginals)
        results.append(build_result(frame.problem, frame.start, estimate, uncertainty, (), {}))
    status, message = _status(results, refused)
    graph = _structure(frames) if frames[0].problem.options.keep_history and failure is None else ()
    numbers = tuple(frame.number for frame in frames)
    return TrackReconstruction(
        status, message, numbers, tuple(results), refused, total, tuple(history), graph, milliseconds
    )


def _status(results: list[Reconstruction], refused: Mapping[int, str]) -> tuple[Status, str]:
    """The worst of the frames, and how many images there are."""
    count = f"{len(results)} images share one shape"
    left_out = f", {len(refused)} were refused" if refused else ""
    for status in (Status.FAILED, Status.DEGENERATE, Status.AMBIGUOUS):
        members = [result for result in results if result.status is status]
        if members:
            where = f"{len(members)} of {len(results)} are {status.value}"
            return status, f"{count}{left_out}; {where}: {members[0].message}"
    return Status.CONVERGED, f"{count}{left_out}; the joint optimisation found a minimum."


def _structure(frames: list[_Frame]) -> tuple[GraphFactor, ...]:
    """The joint graph, with one factor for the keypoints of each frame."""
    factors: list[GraphFactor] = []
    for frame in frames:
        weights = graph_weights(frame.problem.energy, frame.state.weights, frame.state.visibility)
        members = graph_factors(frame.graph, frame.terms, weights)
        seen = [factor for factor in members if factor.term == "reprojection"]
        if seen:
            factors.append(GraphFactor("reprojection", f"{len(seen)} keypoints", seen[0].variables))
        factors += [factor for factor in members if factor.term != "reprojection"]
    return tuple(factors)
