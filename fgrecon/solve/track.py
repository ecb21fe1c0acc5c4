"""One vehicle over several images: a pose for each, and one shape for all.

    frame 0: reprojection_i, box, cheirality --- X(0,0) --- ground, upright
                        |
    frame 1: reprojection_i, box, cheirality --- X(0,1) --- ground, upright
                        |           ...
    frame t: reprojection_i, box, cheirality --- X(0,t) --- ground, upright
                        |
                    L(0), O(0) ---- priors, symmetry, dimensions, ...

Every image is searched for its pose alone (`fgrecon.solve.proposals`); then the graph of all poses and the shared shape
is solved by the loop that solves a single image. The terms of the shape appear once. Images of one vehicle err alike,
and count for its shape accordingly (`ShapeOptions.common_error`). Of motion nothing is assumed but that images in order
seldom show the heading of the vehicle flipped from one to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_list
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.evidence import Evidence, VehicleClass
from fgrecon.core.history import Deferred
from fgrecon.core.input_warnings import InputWarnings, warn_of
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.core.text import most_frequent
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.solve.contradiction import with_contradictions, with_mirrored_gain
from fgrecon.solve.depth_scale import with_scales
from fgrecon.solve.either_class import either_class, mean_weights
from fgrecon.solve.fitted_class import with_fitted_classes
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.graph.records import graph_factors, joint_steps
from fgrecon.solve.image_facing import single_pose
from fgrecon.solve.inputs import SolveSetup, as_cameras, as_extra_factors, check_frames, evidence_of, observe
from fgrecon.solve.proposals.pose_search import PoseEstimate
from fgrecon.solve.result import results
from fgrecon.solve.road_plane import ground_by_points
from fgrecon.solve.solve_settings import FITTED_CLASS
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.vehicle.model import VehicleModel

if TYPE_CHECKING:
    import gtsam


@single_threaded
def reconstruct_track(
    observations: Sequence[Observation | None],
    cameras: Camera | ArrayLike | Sequence[Camera],
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
    in_order: bool = True,
    evidence: Sequence[Sequence[Evidence]] | None = None,
) -> TrackReconstruction:
    """Recover the poses and the one shape of a vehicle that several images show.

    Args:
        observations: Its keypoints in each image; None where there are none.
        cameras: The camera, or its matrix (3, 3), or (fx, fy, cx, cy); or a camera for each image.
        prior: Shape prior, or its name, or the path of its file.
        ground: Ground plane in every camera's frame; a number is the height in metres of a level camera.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; one so tight that it is a single vehicle's says its
            shape as well (`fgrecon.solve.vehicle.conditioning`). None takes sizes from the shape prior.
        options: Settings; `joint` must be set.
        extra_factors: The caller's own factors on the poses X(0, t), t the index of the observation, lambda L(0) and,
            with free offsets, O(0); see `fgrecon.reconstruct`.
        in_order: Whether the images were taken one after the other: then its heading is seldom flipped from one to
            the next, and an image that takes its front for its rear is outvoted by its neighbours.
        evidence: What other sensors say of the vehicle in each image, such as `fgrecon.Points` of a scan each; None
            where they say nothing.

    Returns:
        The result; images without a pose are in `refused`.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: No image determines a pose.
    """
    setup = SolveSetup.of(prior, size_prior, options, ground, joint=True)
    factors = as_extra_factors(extra_factors)
    observations = as_list("observations", observations)
    each = as_cameras(cameras, len(observations))
    observations = _with_evidence(observations, each, evidence, setup.ground)

    started = perf_counter()
    warnings = InputWarnings()
    parts, starts, refused = _posed(observations, each, setup, warnings)
    posed = perf_counter()
    adjusted = minimise_from_proposals(parts, starts, factors, in_order=in_order)
    milliseconds = {"pose": (posed - started) * 1e3, "joint": (perf_counter() - posed) * 1e3}
    frames = _with_either_class(results(parts, starts, adjusted, {}, factors), parts, setup)
    alone = minimise_from_proposals(parts, starts, in_order=in_order).ended if factors else None
    frames = with_contradictions(frames, adjusted.ended, alone)
    frames = [with_mirrored_gain(one, part.problem) for part, one in zip(parts, frames, strict=True)]
    for part, one in zip(parts, frames, strict=True):
        warnings.add_result(f"image {part.image}", part.problem.observation, one, "the vehicle")
    warn_of(warnings, stacklevel=3)
    status, message = _status(frames, refused)
    optimum = adjusted.optimum
    keep = setup.options.keep_history and optimum.failure is None
    return TrackReconstruction(
        status=status,
        message=message,
        numbers=tuple(one.image for one in parts),
        frames=tuple(frames),
        refused=refused,
        energies=optimum.energies,
        history=Deferred(lambda: joint_steps(adjusted.stages)) if keep else (),
        graph=Deferred(lambda: graph_factors(adjusted.graph, optimum.state.weights)) if keep else (),
        milliseconds=milliseconds,
    )


def _with_either_class(
    frames: Sequence[Reconstruction], parts: Sequence[GraphObservation], setup: SolveSetup
) -> list[Reconstruction]:
    """The results with covariances for all classes, where that of the vehicle is open.

    Images of one vehicle say much the same of it: some of the track are solved, each takes what the nearest says.
    """
    classes = setup.classes_of([part.problem.observation for part in parts])
    known = [i for i, one in enumerate(frames) if one.uncertainty.pose_covariance is not None]
    places = np.linspace(0, len(known) - 1, min(len(known), FITTED_CLASS.solved_images)).round().astype(int)
    images = np.array(known, dtype=int)[places]
    solved = [
        either_class(parts[i].problem, frames[i].camera_T_object, frames[i].shape.coefficients, setup, classes)
        for i in images
    ]
    weights, found = mean_weights(solved), list(frames)
    for i in known:
        nearest = solved[int(np.abs(images - i).argmin())]
        found[i] = frames[i] if nearest is None else nearest.added_to(frames[i], weights)
    return found


def _with_evidence(
    observations: list[Observation | None],
    cameras: Sequence[Camera],
    evidence: Sequence[Sequence[Evidence]] | None,
    ground: Ground | None,
) -> list[Observation | None]:
    if evidence is None:
        return observations
    if len(evidence) != len(observations):
        value = f"{len(evidence)} for {len(observations)} images"
        raise InvalidInputError("evidence", value, "Give a sequence for each image.")
    sensed = [evidence_of(tuple(some), camera) for some, camera in zip(evidence, cameras, strict=True)]
    for some, camera, one in zip(sensed, cameras, observations, strict=True):
        check_frames(some, camera, ground, [] if one is None else [one])
    return [None if o is None else o.with_evidence(some) for o, some in zip(observations, sensed, strict=True)]


def _posed(
    observations: Sequence[Observation | None], cameras: Sequence[Camera], setup: SolveSetup, warnings: InputWarnings
) -> tuple[list[GraphObservation], list[PoseEstimate], dict[int, str]]:
    """The images that have a pose, their proposals, and why others have none; `warnings` gets what is wrong."""
    looked: dict[int, tuple[Observation, Camera, SolveSetup]] = {}
    parts: list[GraphObservation] = []
    starts: list[PoseEstimate] = []
    refused: dict[int, str] = {}
    bad: InvalidInputError | None = None
    for number, (given, camera) in enumerate(zip(observations, cameras, strict=True)):
        if given is None:
            refused[number] = "no keypoints"
            continue
        try:
            observation, warning = observe(given, camera, setup)
            warnings.add(f"image {number}", warning)
            scaled = with_scales([observation], camera, setup)[0]
            own = setup
            if scaled.evidence:
                off = setup.options.disabled_terms
                own = replace(setup, ground=ground_by_points(scaled.evidence, setup.ground, camera, off))
            looked[number] = scaled, camera, own
        except (DegenerateProblemError, InvalidInputError) as error:
            bad = error if bad is None and isinstance(error, InvalidInputError) else bad
            refused[number] = str(error)
    model = _model([*looked.values()], setup)
    for number, (observation, camera, own) in looked.items():
        try:
            problem, start = single_pose(observation, camera, model, own)
        except (DegenerateProblemError, InvalidInputError) as error:
            bad = error if bad is None and isinstance(error, InvalidInputError) else bad
            refused[number] = str(error)
            continue
        parts.append(GraphObservation(problem, image=number))
        starts.append(start)
    if not parts and bad is not None:
        raise bad
    if not parts:
        raise DegenerateProblemError("observations", "no pose in any image", "Give more, or better spread, keypoints.")
    return parts, starts, refused


def _model(looked: Sequence[tuple[Observation, Camera, SolveSetup]], setup: SolveSetup) -> VehicleModel:
    """The vehicle's model: by what somebody says of its class, and where that is open by its images.

    What is said of it with some images holds in those that say nothing.
    """
    classes = setup.classes_of([one for one, _, _ in looked])
    fitted: list[Observation] = []
    for observation, camera, own in looked:
        of_class = observation
        if classes is not None and setup.classes_of([observation]) is None:
            of_class = observation.with_evidence([VehicleClass(classes)])
        fitted += with_fitted_classes([of_class], camera, own, own.ground)
    return setup.model_of(fitted, [camera for _, camera, _ in looked])


def _status(results: list[Reconstruction], refused: Mapping[int, str]) -> tuple[Status, str]:
    """The worst of the frames, `weak` where half of them are; how many images there are, and how many are weak."""
    count = f"{len(results)} images share one shape" if len(results) > 1 else "1 image determines the shape"
    left_out = f", {len(refused)} {'was' if len(refused) == 1 else 'were'} refused" if refused else ""
    for status in (Status.FAILED, Status.DEGENERATE, Status.AMBIGUOUS):
        members = [result for result in results if result.status is status]
        if members:
            where = f"{len(members)} of {len(results)} are {status.value}"
            return status, f"{count}{left_out}; {where}: {members[0].message}"
    weak = [result for result in results if result.status is Status.WEAK]
    why = ""
    if weak:
        (reason, number), *_ = most_frequent(reason for result in weak for reason in result.reasons)
        why = f"{len(weak)} of {len(results)} {'is' if len(weak) == 1 else 'are'} weak, {number} since {reason}"
    if 2 * len(weak) >= len(results):
        return Status.WEAK, f"{count}{left_out}; {why}."
    return Status.CONVERGED, f"{count}{left_out}; the joint optimisation found a minimum{why and f', {why}'}."
