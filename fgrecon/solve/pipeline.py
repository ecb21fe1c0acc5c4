"""From keypoints to pose and shape: the stages in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.evidence import Evidence
from fgrecon.core.input_warnings import InputWarnings, warn_of
from fgrecon.core.observation import KeypointsLike
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.solve.contradiction import with_contradictions, with_mirrored_gain
from fgrecon.solve.depth_scale import with_scales
from fgrecon.solve.either_class import with_either_class
from fgrecon.solve.fitted_class import with_fitted_classes
from fgrecon.solve.graph.graph import GraphObservation
from fgrecon.solve.graph.multi_start import minimise_from_proposals
from fgrecon.solve.image_facing import single_pose
from fgrecon.solve.inputs import (
    SolveSetup,
    as_extra_factors,
    as_initial,
    calibrated,
    check_frames,
    evidence_of,
    observe,
)
from fgrecon.solve.result import results
from fgrecon.solve.road_plane import ground_by_points
from fgrecon.solve.threads import single_threaded

if TYPE_CHECKING:
    import gtsam


@single_threaded
def reconstruct(
    keypoints: KeypointsLike,
    intrinsics: Camera | ArrayLike,
    *,
    confidence: ArrayLike | None = None,
    box: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    distortion: ArrayLike | None = None,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    initial: Box3D | float | None = None,
    options: Options | None = None,
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
    evidence: Sequence[Evidence] = (),
) -> Reconstruction:
    """Recover the pose and the shape of one vehicle from its keypoints in one image.

    Args:
        keypoints: (K, 2) pixels (u, v) in the prior's keypoint order; NaN where one was not detected. Or (u, v) or
            (u, v, confidence) by the keypoint's name. Or an `Observation`, which holds the next three as well.
        intrinsics: Camera matrix (3, 3), or (fx, fy, cx, cy), or a `Camera`.
        confidence: (K,) in [0, 1]; None where the detector gives none.
        box: (4,) 2D box x1, y1, x2, y2 in pixels, or None; of the outline, unless `options.box` says otherwise.
        covariance: (K, 2, 2) covariance of each keypoint in square pixels, or None.
        distortion: OpenCV distortion coefficients, or None.
        prior: Shape prior, or its name, or the path of its file.
        ground: Ground plane; a number is the height in metres of a level camera; None assumes nothing.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; one so tight that it is a single vehicle's says its
            shape as well (`fgrecon.solve.vehicle.conditioning`). None takes sizes from the shape prior.
        initial: 3D box to start from as well, or a guess of rotation_y in radians to trust within 45 degrees.
        options: Settings.
        extra_factors: The caller's own factors on the pose X(0, 0), lambda L(0) and, with free offsets, O(0)
            (`factors.keys`; `factors.guarded_factor` makes one from a callback). They are in every solve of the graph,
            in the covariances and in the history as term `extra`, but not in the search for proposals.
        evidence: What is known of the vehicle beside its keypoints, such as `fgrecon.VehicleClass("van")`, or
            `fgrecon.Points` of a scan. With a 2D box, and with points or a mask, it
            needs no keypoints.

    Returns:
        The reconstruction; its `status` says how far to trust it.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: The keypoints do not determine a pose.

    Warns:
        ContradictoryInputWarning: Keypoints, box, camera or result contradict one another.
    """
    setup = SolveSetup.of(prior, size_prior, options, ground)
    camera = calibrated("intrinsics", Camera.of(intrinsics, distortion))
    start, factors = as_initial(initial, setup.prior), as_extra_factors(extra_factors)
    given: dict[str, Any] = {"confidence": confidence, "box": box, "covariance": covariance}
    sensed = evidence_of(evidence, camera)
    observed = observe(keypoints, camera, setup, **given, evidence=sensed)
    if sensed:
        check_frames(sensed, camera, setup.ground, [observed.observation])
        setup = replace(setup, ground=ground_by_points(sensed, setup.ground, camera, setup.options.disabled_terms))
    if observed.warning is not None:
        warn_of(InputWarnings.of({"the vehicle": observed.warning}), stacklevel=3)

    started = perf_counter()
    observation, model = observed.observation, setup.model
    if setup.fits_classes or observation.evidence:
        (observation,) = with_fitted_classes([observation], camera, setup, setup.ground)
    if observation.evidence:
        model = setup.model_of([observation], [camera])
        (observation,) = with_scales([observation], camera, setup)
    problem, pose = single_pose(observation, camera, model, setup, start)
    posed = perf_counter()
    parts = [GraphObservation(problem)]
    adjusted = minimise_from_proposals(parts, [pose], factors)
    milliseconds = {"pose": (posed - started) * 1e3, "shape": (perf_counter() - posed) * 1e3}
    alone = minimise_from_proposals(parts, [pose]).ended if factors else None
    (result,) = with_contradictions(results(parts, [pose], adjusted, milliseconds, factors), adjusted.ended, alone)
    result = with_either_class(result, problem, setup, adjusted.optimum)
    result = with_mirrored_gain(result, problem)
    if observed.warning is None:
        warnings = InputWarnings()
        warnings.add_result("the vehicle", observed.observation, result)
        warn_of(warnings, stacklevel=3)
    return result
