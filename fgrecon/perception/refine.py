"""From an image and another detector's 3D boxes to better ones: keypoints in each, and all vehicles in one scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import MIN_DEPTH, Camera, Ground
from fgrecon.core.checks import as_instance, as_list, as_rows, as_shape
from fgrecon.core.choices import BoxOrigin
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import Evidence
from fgrecon.core.geometry import box_around
from fgrecon.core.input_warnings import warn
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, BoxOptions, Options, checked_options
from fgrecon.core.refined_box import RefinedBox
from fgrecon.core.settings import one_of
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.perception.keypoints.detect import SMALLEST_BOX, as_rgb8, large_enough, shipped_cascade
from fgrecon.perception.protocols import KeypointDetector, find_keypoints
from fgrecon.solve.box_origin import contradicted_origin, on_bottom
from fgrecon.solve.detected import refined
from fgrecon.solve.inputs import as_ground
from fgrecon.solve.scene import reconstruct_scene


def refine_boxes(
    image: NDArray[Any] | str | Path,
    boxes: Sequence[Box3D],
    camera: Camera | ArrayLike,
    *,
    corners: ArrayLike | None = None,
    box_errors: BoxErrors | None = None,
    keypoint_detector: KeypointDetector | None = None,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
    box_origin: BoxOrigin | str = BoxOrigin.BOTTOM,
    evidence: Sequence[Evidence] = (),
) -> list[RefinedBox]:
    """Better 3D boxes of the vehicles in an image, by their keypoints.

    Keypoints are found in each 2D box; then all vehicles are solved together on one ground, with their 3D boxes as
    factors in the graph. A box that its keypoints say too little about, or contradict, stays as it is and says why.

    Args:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits; or the path of an image file.
        boxes: The 3D boxes of a detector, in the camera's frame.
        camera: The camera that took it, or its matrix (3, 3), or (fx, fy, cx, cy).
        corners: (N, 4) the detector's 2D boxes x1, y1, x2, y2 in pixels; NaN where it gives none, and None for all.
            Then the projection of the 3D box says where to look, and no more.
        box_errors: How far the 3D boxes are off; None for a monocular detector's.
        keypoint_detector: Finds the keypoints; None for the networks of the package. All boxes go to it in one call.
        prior: Shape prior, or its name, or the path of its file; of the category of the keypoint detector.
        ground: Ground plane; a number is the height in metres of a level camera; None: the boxes say about where it is.
        size_prior: Fleet or size prior for boxes without a size.
        options: Settings; None takes 2D boxes to enclose the projected 3D box, as KITTI's and nuScenes' do.
        box_origin: What the locations of `boxes` are: centres of their bottom faces, as `Box3D` has them, or of the
            boxes, which then have sizes. Results have bottom faces.
        evidence: What other sensors say of the vehicles, as in `fgrecon.reconstruct_image`.

    Returns:
        What became of each box, in order. None is refined where they stand half their height above a given ground, as
        boxes do that are given by their centres, or as much below it.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.

    Warns:
        ContradictoryInputWarning: The boxes seem to have another origin than `box_origin`.
    """
    errors = BoxErrors() if box_errors is None else as_instance("box_errors", box_errors, BoxErrors)
    origin = one_of(BoxOrigin, "box_origin", box_origin)
    boxes = on_bottom(as_list("boxes", boxes, Box3D), origin)
    if contradiction := contradicted_origin(boxes, as_ground(ground), origin):
        warn(contradiction, stacklevel=2)
        return [RefinedBox(box, box, f"Unchanged: {contradiction}") for box in boxes]
    if options is None:
        options = Options(box=BoxOptions(model=BoxModel.CUBOID), keep_history=False)
    settings = checked_options(options, joint=True)
    pixels = read_image(image) if isinstance(image, str | Path) else as_rgb8(image)
    seen_by = Camera.of(camera).with_size_of(pixels)
    where, own = _where(boxes, corners, seen_by, pixels)
    looked = np.flatnonzero(large_enough(where)).tolist()
    shape_prior = load_prior(prior)
    networks = shipped_cascade() if keypoint_detector is None else keypoint_detector
    found = find_keypoints(networks, pixels, where[looked], shape_prior.category) if len(looked) else []
    how: dict[str, Any] = {"prior": shape_prior, "ground": ground, "size_prior": size_prior, "options": settings}
    scene = reconstruct_scene(
        [_observed(one.evidence, own=bool(own[i])) for i, one in zip(looked, found, strict=True)],
        seen_by,
        boxes=[boxes[i] for i in looked],
        box_errors=errors,
        evidence=evidence,
        **how,
    )
    solved = {looked[n]: vehicle for n, vehicle in zip(scene.numbers, scene.vehicles, strict=True)}
    refused = {i: _too_small(i, where[i]) for i in range(len(boxes)) if i not in looked}
    refused |= {looked[n]: error for n, error in scene.refused.items()}
    return [refined(box, errors, solved.get(i), refused.get(i)) for i, box in enumerate(boxes)]


def _too_small(number: int, box: Array) -> FgreconError:
    fix = f"It takes at least {SMALLEST_BOX} pixels of it."
    return InvalidInputError(f"boxes[{number}]", f"{box.round(1).tolist()} in the image", fix)


def _where(
    boxes: Sequence[Box3D], corners: ArrayLike | None, camera: Camera, image: NDArray[np.uint8]
) -> tuple[Array, NDArray[np.bool_]]:
    """2D boxes (N, 4) within the image, and whether (N,) they are the detector's; else they are projected."""
    given = np.full((len(boxes), 4), np.nan)
    if corners is not None:
        given = as_shape("corners", as_rows("corners", corners, 4), given.shape)
    own: NDArray[np.bool_] = np.all(np.isfinite(given), axis=1)
    limits = np.array([image.shape[1], image.shape[0]] * 2) - 1.0
    where = np.array([g if o else _projected(b, camera) for b, g, o in zip(boxes, given, own, strict=True)])
    return np.clip(where.reshape(-1, 4), 0.0, limits), own


def _observed(observation: Observation, *, own: bool) -> Observation:
    """What counts as evidence: not a 2D box that is the 3D box's projection, which would say the same twice."""
    return observation if own else replace(observation, box=None)


def _projected(box: Box3D, camera: Camera) -> Array:
    """(4,) the projection of a 3D box, of what of it is in front of the camera."""
    corners = box.corners
    ahead = corners[corners[:, 2] > MIN_DEPTH]
    if not len(ahead):
        return np.zeros(4)
    pixels = camera.distort(camera.project(ahead))
    return box_around(pixels)
