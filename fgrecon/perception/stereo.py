"""Depth from a pair of images: OpenCV's semi-global matcher, and how sure its disparities are.

left, right ---- rectified, where they are not ---- matched both ways ---- disparity ---- depth of the left pixels

A point at depth z has the disparity f b / z, f the focal length in pixels and b the baseline in metres, so that an
error of e pixels is one of e z^2 / (f b) metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import Evidence, StereoPair, as_evidence
from fgrecon.core.lens import OPENCV
from fgrecon.perception.keypoints.detect import as_rgb8

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class StereoSettings:
    """How pairs are matched. Where nothing else is said, OpenCV's usual numbers, not tuned."""

    nearest_m: float = 3.0  # nothing nearer is looked for
    block_px: int = 5  # side of the blocks that are compared; 3 to 9 do alike on KITTI
    least_uniqueness_percent: int = 10  # by which the best match is better than the next
    speckle_px: int = 100  # smaller islands of disparities are left out
    speckle_range: int = 2  # disparities within an island
    both_ways_px: int = 1  # by which matches from right to left may differ
    disparity_sigma_px: float = 0.4
    """Standard deviation of a disparity, of one pixel to the next: 0.4 to 0.9 px from 10 to 50 m by the LiDAR points of
    the cars in KITTI's drives 0000 and 0001. Chosen with the next by the places of the cars in 0001."""
    offset_sigma_px: float = 0.3
    """The same of an error that all disparities of a pair share: by these points they are 0.3 to 0.8 px too small."""


SETTINGS = StereoSettings()
_RECTIFIED = 0.02  # share of the baseline by which the right camera may be above, below, before or behind the left one
_LEVEL = 1e-3  # by so much rotation matrices and shares of intrinsics may differ in a rectified pair
_STEPS = 16.0  # of a disparity in OpenCV's whole numbers


def with_depths(evidence: Sequence[Evidence], image: NDArray[Any], camera: Camera) -> tuple[Evidence, ...]:
    """Evidence with the depth map of each pair whose left image (H, W, 3) this is, in the place of the pair.

    Raises:
        InvalidInputError: It is no evidence, or the images of a pair differ in size.
    """
    given = as_evidence(evidence)
    return tuple(stereo_depth(image, camera, one) if isinstance(one, StereoPair) else one for one in given)


def stereo_depth(left: NDArray[Any], camera: Camera, pair: StereoPair) -> DepthMap:
    """The depth of each pixel of a left image, NaN where no match is sure, and the error that all of them share.

    Args:
        left: (H, W, 3) RGB, or grey; 8 or 16 bits.

    Raises:
        InvalidInputError: The images differ in size or not at all, or a lens is a fisheye.
    """
    images = as_rgb8(left), as_rgb8(pair.image)
    if images[0].shape != images[1].shape:
        raise InvalidInputError("right", f"shape {images[1].shape}", f"Give an image of shape {images[0].shape}.")
    if np.array_equal(*images):
        raise InvalidInputError("right", "the left image again", "Give the right image of the pair.")
    motion, right = pair.right_T_left, pair.camera
    if {camera.distortion_model, right.distortion_model} != {OPENCV}:
        fix = "Rectify the pair (cv2.fisheye) and give its pinhole cameras."
        raise InvalidInputError("right", "a fisheye", fix)
    if _is_rectified(camera, right, motion):
        focal, shift = camera.matrix[0, 0], right.matrix[0, 2] - camera.matrix[0, 2]
        product = -float(motion[0, 3]) * focal
        disparity = _disparity(*images, product) + shift
        depth = product / np.where(disparity > 0.0, disparity, np.nan)
    else:
        depth, product = _unrectified(images, camera, pair)
    sigma = SETTINGS.disparity_sigma_px * depth**2 / product
    shared = SETTINGS.offset_sigma_px / product
    return DepthMap(depth, sigma, relative_sigma=0.0, shared_sigma=shared, sensor=_rig(camera, right, motion))


def _rig(camera: Camera, right: Camera, motion: Array) -> str:
    """A name of the two cameras, by their calibration."""
    lenses = [np.zeros(0) if one.distortion is None else one.distortion for one in (camera, right)]
    numbers = np.concatenate([camera.matrix.ravel(), right.matrix.ravel(), motion.ravel(), *lenses])
    return f"stereo {sha256(numbers.tobytes()).hexdigest()[:12]}"


def _is_rectified(camera: Camera, right: Camera, motion: Array) -> bool:
    if camera.distortion is not None or right.distortion is not None:
        return False
    aside = np.abs(motion[1:3, 3]).max() <= _RECTIFIED * abs(motion[0, 3])
    first, second = camera.matrix.copy(), right.matrix.copy()
    first[0, 2] = second[0, 2] = 0.0  # the principal points may be apart along the rows
    return bool(
        aside and np.allclose(motion[:3, :3], np.eye(3), atol=_LEVEL) and np.allclose(first, second, rtol=_LEVEL)
    )


def _disparity(left: Image, right: Image, product: float) -> Array:
    """(H, W) disparities of a rectified pair, NaN where no match is sure.

    Args:
        product: Focal length times baseline, pixels times metres.
    """
    import cv2  # on use: importing fgrecon must not import OpenCV

    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
    width = left.shape[1]
    largest = int(min(product / SETTINGS.nearest_m, width / 2.0) // _STEPS + 1) * int(_STEPS)
    area = SETTINGS.block_px**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=largest,
        blockSize=SETTINGS.block_px,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=SETTINGS.both_ways_px,
        uniquenessRatio=SETTINGS.least_uniqueness_percent,
        speckleWindowSize=SETTINGS.speckle_px,
        speckleRange=SETTINGS.speckle_range,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # Columns that the right image does not show are added at the left edge: OpenCV matches none so near to it.
    padded = [cv2.copyMakeBorder(one, 0, 0, largest, 0, cv2.BORDER_REPLICATE) for one in grey]
    steps = np.asarray(matcher.compute(*padded))[:, largest:].astype(np.float64)
    return np.where(steps > 0.0, steps / _STEPS, np.nan)


def _unrectified(images: tuple[Image, Image], camera: Camera, pair: StereoPair) -> tuple[Array, float]:
    """(H, W) depths of the left pixels of any pair, and focal length times baseline of the rectified one."""
    import cv2

    height, width = images[0].shape[:2]
    motion, right = pair.right_T_left, pair.camera
    lenses = [np.zeros(5) if one.distortion is None else one.distortion for one in (camera, right)]
    turns_projections = cv2.stereoRectify(
        *(camera.matrix, lenses[0], right.matrix, lenses[1], (width, height), motion[:3, :3], motion[:3, 3:]),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0.0,
    )
    turns, projections = turns_projections[:2], turns_projections[2:4]
    flat = []
    for image, one, lens, turn, projection in zip(images, (camera, right), lenses, turns, projections, strict=True):
        maps = cv2.initUndistortRectifyMap(one.matrix, lens, turn, projection, (width, height), cv2.CV_32FC1)
        flat.append(np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), dtype=np.uint8))
    product = -float(projections[1][0, 3])
    disparity = _disparity(flat[0], flat[1], product)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    found = cv2.undistortPoints(pixels, camera.matrix, lenses[0], R=turns[0], P=projections[0])[:, 0]
    column, row = np.rint(found).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    matched = np.full(len(found), np.nan)
    matched[inside] = disparity[row[inside], column[inside]]
    rectified = Camera(projections[0][:, :3])
    points = rectified.rays(found) * (product / matched)[:, None]
    depth: Array = (points @ turns[0])[:, 2].reshape(height, width)  # back in the left camera's frame
    return depth, product
