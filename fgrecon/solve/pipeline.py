"""From keypoints to pose and shape: the stages in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.category import Category
from fgrecon.core.checks import as_finite, as_list, as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.options import Options, checked_options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.facing import face_together, faced_pose
from fgrecon.solve.graph.adjust import adjust
from fgrecon.solve.graph.graph import Seen
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.result import results
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.vehicle.model import prepare

if TYPE_CHECKING:
    import gtsam

__all__ = ["ground_plane", "observe", "own_factors", "reconstruct"]

Array = NDArray[np.float64]

_UNDONE, _ANYWHERE = 1.0, 1e7  # pixels
_FEWEST = 3  # keypoints that a pose needs


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
    size_prior: SizePrior | str | None = None,
    initial: Box3D | float | None = None,
    options: Options | None = None,
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
) -> Reconstruction:
    """Recover the pose and the shape of one vehicle from its keypoints in one image.

    Args:
        keypoints: (K, 2) pixels (u, v) in the prior's keypoint order; NaN where a keypoint was not found. Or (u, v) or
            (u, v, confidence) by the keypoint's name. Or an `Observation`, which holds the next three as well.
        intrinsics: Camera matrix (3, 3), or (fx, fy, cx, cy), or a `Camera`.
        confidence: (K,) in [0, 1]; None where the detector gives none.
        box: (4,) 2D box x1, y1, x2, y2 in pixels, or None; of the outline, unless `options.box` says otherwise.
        covariance: (K, 2, 2) covariance of each keypoint in square pixels, or None.
        distortion: OpenCV distortion coefficients, or None.
        prior: Shape prior, or its name, or the path of its file.
        ground: Ground plane; a number is the height in metres of a level camera; None assumes nothing.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; one so tight that it is a single vehicle's tells its
            shape as well (`fgrecon.solve.vehicle.conditioning`). None takes sizes from the shape prior.
        initial: 3D box to start from as well, or a guess of rotation_y in radians to trust within 45 degrees.
        options: Settings.
        extra_factors: Factors of one's own on the pose X(0, 0), lambda L(0) and, with free offsets, O(0)
            (`factors.keys`; `factors.guarded_factor` makes one from a callback). They are in every solve of the graph,
            in the covariances and in the history as term `extra`, but not in the search for proposals.

    Returns:
        The reconstruction; its `status` tells how far to trust it.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
        DegenerateProblemError: The keypoints do not determine a pose.
    """
    options = checked_options(options)
    extra_factors = own_factors(extra_factors)
    shape_prior = load_prior(prior)
    camera = known_camera("intrinsics", Camera.of(intrinsics, distortion))
    plane = ground_plane(ground)
    start = _initial(initial)
    fleet = None if size_prior is None else named_size_prior(size_prior)
    observation = observe(
        keypoints, camera, shape_prior, options, confidence=confidence, box=box, covariance=covariance
    )
    model = prepare(shape_prior, fleet, options.shape.basis_vectors)

    started = perf_counter()
    # Where a start is given, which way it faces is said already.
    (told,) = face_together([observation], camera, shape_prior, options) if start is None else [observation]
    problem, pose = faced_pose(Problem.of(told, camera, model, plane, options), observation, start)
    posed = perf_counter()
    seen = [Seen(problem)]
    adjusted = adjust(seen, [pose], extra_factors)
    milliseconds = {"pose": (posed - started) * 1e3, "shape": (perf_counter() - posed) * 1e3}
    return results(seen, [pose], adjusted, milliseconds, extra_factors)[0]


def own_factors(given: Sequence[gtsam.NonlinearFactor]) -> Sequence[gtsam.NonlinearFactor]:
    """Factors of one's own.

    Raises:
        InvalidInputError: They are no sequence of factors.
    """
    if isinstance(given, tuple) and not given:
        return given
    import gtsam

    return as_list("extra_factors", given, gtsam.NonlinearFactor)


def known_camera(field: str, camera: Camera) -> Camera:
    """The camera, for what takes its focal length as exact.

    Raises:
        InvalidInputError: The focal length is not known.
    """
    if camera.focal_sigma:
        fix = "`fgrecon.reconstruct_scene([observation], camera)` finds the focal length; or give one that is known."
        raise InvalidInputError(field, f"focal length known to {100 * camera.focal_sigma:.0f} %", fix)
    return camera


def ground_plane(ground: Ground | float | None) -> Ground | None:
    """The plane, or that of a level camera at a height in metres.

    Raises:
        InvalidInputError: It is neither a plane nor a positive number, or the camera is higher than 100 metres.
    """
    if ground is None:
        return None
    if isinstance(ground, Ground):
        return ground.told()
    return _level(float(as_finite("ground", ground, (), "Give a `Ground`, or the camera's height in metres.")))


@lru_cache(maxsize=16)  # thousands of vehicles stand on one ground
def _level(height: float) -> Ground:
    return Ground.level(height)


def _initial(initial: Box3D | float | None) -> Box3D | float | None:
    if initial is None or isinstance(initial, Box3D):
        return initial
    return float(as_finite("initial", initial, (), "Give a `Box3D`, or a guess of rotation_y in radians."))


def observe(
    keypoints: KeypointsLike,
    camera: Camera,
    prior: ShapePrior,
    options: Options,
    *,
    confidence: ArrayLike | None = None,
    box: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
) -> Observation:
    """The observation that is solved from: checked against the prior's category, and freed of lens distortion.

    Raises:
        InvalidInputError: An array has the wrong shape or values, something is given twice, or the box lies outside
            of the image.
    """
    category = prior.category
    given = {"confidence": confidence, "box": box, "covariance": covariance}
    if isinstance(keypoints, Observation):
        for field, value in given.items():
            if value is not None:
                raise InvalidInputError(field, "given twice", "The observation has it: give it there.")
        as_shape("keypoints", keypoints.keypoints, (category.size, 2), _fix(category))
        seen = keypoints
        if options.confidence_midpoint is not None:
            seen = replace(seen, confidence_midpoint=options.confidence_midpoint)
    else:
        if isinstance(keypoints, Mapping):
            keypoints, confidence = _by_name(keypoints, category, confidence)
        pixels = as_shape("keypoints", keypoints, (category.size, 2), _fix(category))
        seen = Observation.of(
            pixels,
            None if confidence is None else as_shape("confidence", confidence, (category.size,)),
            None if box is None else as_finite("box", box, (4,), "Give x1, y1, x2, y2 in pixels."),
            None if covariance is None else as_shape("covariance", covariance, (category.size, 2, 2)),
            options.confidence_midpoint,
        )
    _check_in_image(seen.box, camera)
    if "direction" in options.disabled_terms:
        seen = replace(seen, azimuth=None)  # neither the energy, nor neighbours or frames of a track, is to hear of it
    seen = seen.of_at_least(options.keypoints.least_confidence)
    return seen if camera.distortion is None else _ideal(seen, camera)


def _ideal(seen: Observation, camera: Camera) -> Observation:
    """The observation freed of lens distortion; a keypoint where no ray of such a lens arrives is not measured.

    Raises:
        InvalidInputError: The distortion cannot be undone at the box, or not at half of the measured keypoints.
    """
    ideal_box = None if seen.box is None else camera.undistort(seen.box.reshape(2, 2)).ravel()
    keypoints = camera.undistort(seen.keypoints)
    lost = seen.measured & ~_undone(seen.keypoints, keypoints, camera)
    keypoints[lost] = np.nan
    boxed = True
    if seen.box is not None and ideal_box is not None:
        boxed = bool(_undone(seen.box.reshape(2, 2), ideal_box.reshape(2, 2), camera).all())
        boxed = boxed and float((ideal_box[2:] - ideal_box[:2]).min()) >= 1.0
    left = keypoints[seen.measured & ~lost]
    gone = bool(lost.any()) and len(left) < max(_FEWEST, int(np.count_nonzero(lost)))
    all_one = len(left) > 1 and float(np.ptp(left, axis=0).max()) < 1.0 <= float(
        np.ptp(seen.keypoints[seen.measured], axis=0).max()
    )
    if not boxed or gone or all_one:
        fix = f"Give coefficients of this camera: they cannot be undone at the {'keypoints' if boxed else 'box'}."
        raise InvalidInputError("distortion", np.asarray(camera.distortion).tolist(), fix)
    return replace(seen, keypoints=keypoints, box=ideal_box)


def _undone(pixels: Array, ideal: Array, camera: Camera) -> NDArray[np.bool_]:
    """(M,) whether pixels without distortion are imaged where they came from."""
    found = np.asarray((np.abs(ideal) < _ANYWHERE).all(axis=1))  # not NaN
    found[found] = np.abs(camera.distort(ideal[found]) - pixels[found]).max(axis=1) < _UNDONE
    return found


def _check_in_image(box: Array | None, camera: Camera) -> None:
    """Refuse a box of which nothing is in the image, where its size is known; edges of one may lie outside."""
    if box is None or camera.image_size is None:
        return
    width, height = camera.image_size
    if box[2] <= -0.5 or box[3] <= -0.5 or box[0] >= width - 0.5 or box[1] >= height - 0.5:
        raise InvalidInputError("box", box.tolist(), f"Give a box in the image of {width} x {height} pixels.")


def _fix(category: Category) -> str:
    return f"Give {category.size} pixels (u, v) in the order of category {category.name}; NaN where not found."


def _by_name(
    keypoints: Mapping[str, ArrayLike], category: Category, confidence: ArrayLike | None
) -> tuple[Array, ArrayLike | None]:
    """Pixels (K, 2) in the category's order, NaN where none is given, and confidences from the third numbers."""
    rows = np.full((category.size, 3), np.nan)
    widths = set()
    for name, value in keypoints.items():
        index = category.index(name, "keypoints")
        row = as_shape(f"keypoints.{name}", value, (None,), "Give (u, v) or (u, v, confidence).")
        widths.add(len(row))
        if widths not in ({2}, {3}):
            fix = "Give (u, v) for every keypoint, or (u, v, confidence) for every one."
            raise InvalidInputError(f"keypoints.{name}", f"{len(row)} numbers", fix)
        rows[index, : len(row)] = row
    if widths != {3}:
        return rows[:, :2], confidence
    if confidence is not None:
        raise InvalidInputError("confidence", "given twice", "Give it here or as the third number of every keypoint.")
    return rows[:, :2], np.where(np.isnan(rows[:, 0]), 0.0, rows[:, 2])
