"""Photographs as they would look from further away.

People photograph cars from one car's length, street cameras see them from two to ten: from nearby, the rear hides the
mirrors and the sides that a street camera sees beside it. The shape behind a photograph tells how far away each of its
pixels is, so that the photograph can be laid over the shape and seen again from a distance, in the same direction and
at the same size (a dolly zoom). What the photograph does not show is taken from the car's other side, or from what is
next to it; mirrors, which models hardly have and cameras right behind a car do not see, are put on the shape, and
drawn where the photograph shows neither.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import MIRROR
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.simulation.render import Fragments, rasterise
from fgrecon_research.training.keypoints.labels import ShapeFit, surface_of
from fgrecon_research.training.keypoints.posed_cars import PosedCar

Pixels = NDArray[np.uint8]

_BEHIND = 0.02  # by so much of the car's diagonal a hidden point lies behind what hides it
_DISTANCES = 1.5, 8.0  # diagonals of the car: 7 to 40 metres
_LEAST = 1.2  # factor from which another photograph is worth while
_MADE_UP = 0.1  # largest share of the car that is guessed
_TRIES = 3
_SMOOTH = 3.0  # standard deviation in pixels of the smoothing of the background's displacement
_STUB = np.array([0.010, 0.014, 0.022])  # half of a mirror along, up and across the car, in its diagonals
_STUB_SHADE = 0.1, 1.0  # brightness of a drawn mirror, of the car's own
_NEAR = 7  # pixels around a keypoint of which one has to be shown, for its label to be believed


@dataclass(frozen=True, eq=False)
class SolidCar:
    """The shape behind a photograph, in the unit of the pose."""

    vertices: Array  # (V, 3) of the surface
    faces: NDArray[np.integer]  # (F, 3) its triangles
    mirrors: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (P, 3) where mirrors stand out of the surface
    shade: float = 0.5  # brightness of those that the photograph does not show, of the car's own


@dataclass(frozen=True)
class DistantView:
    """A photograph seen again."""

    image: Pixels  # (H, W, 3) RGB
    mask: Pixels  # (H, W) 255 on the car
    car: PosedCar  # the photograph with the camera that would take this image; its `size` is that of the image
    scale: float  # pixels of this image per pixel of the photograph, at the car's middle
    made_up: float  # share of the car that the photograph shows from neither side
    # (H, W) where the image is what the photograph shows of the car's shape, or a drawn mirror
    valid: NDArray[np.bool_]

    def believes(self, keypoints: Array) -> NDArray[np.bool_]:
        """(K,) which keypoints (K, 2) in pixels lie where the image shows the car as it is."""
        width, height = self.car.size
        column, row = np.clip(np.rint(keypoints).astype(int), 0, [width - 1, height - 1]).T
        near = cv2.dilate(self.valid.astype(np.uint8), np.ones((_NEAR, _NEAR), dtype=np.uint8))
        return near[row, column] > 0


def random_distant_view(
    image: Pixels, mask: Pixels, car: PosedCar, fit: ShapeFit, prior: ShapePrior, side: int, rng: np.random.Generator
) -> DistantView | None:
    """The photograph seen again from a random distance; None where it was taken from afar or would show too little.

    Args:
        image: (H, W, 3) RGB.
        mask: (H, W) 255 on the car.
        car: Camera and pose, in pixels of this image.
        side: Longest side of the new image, pixels.
    """
    surface = surface_of(prior)
    low, high = np.log(_DISTANCES)
    factor = float(np.exp(rng.uniform(low, high)) / np.linalg.norm(car.translation))
    mirrors = prior.keypoints(fit.coefficients, fit.offsets)[prior.category.off_faces]
    shade = float(rng.uniform(*_STUB_SHADE))
    solid = SolidCar(surface.vertices(fit.coefficients), surface.faces, mirrors, shade)
    for _ in range(_TRIES):
        if factor < _LEAST:
            return None
        distant = distant_view(image, mask, car, solid, factor, side)
        if distant.made_up <= _MADE_UP:
            return distant
        factor = 1.0 + (factor - 1.0) / 2.0
    return None


def dolly_zoom(car: PosedCar, vertices: Array, factor: float, side: int) -> PosedCar:
    """The car from `factor` times the distance, in the same direction, filling an image of that longest side.

    Args:
        vertices: (V, 3) of the car's surface, in the unit of the pose.
        factor: At least 1.
        side: Longest side in pixels of the image; its outline leaves as much around the surface as the photograph's.
    """
    before = car.project(vertices)
    moved = car.zoomed(factor)
    after = moved.project(vertices)
    low = after.min(axis=0) + (car.box[:2] - before.min(axis=0))
    high = after.max(axis=0) + (car.box[2:] - before.max(axis=0))
    scale = side / float((high - low).max())
    width, height = np.maximum(np.rint((high - low) * scale), 1).astype(int)
    return moved.resized(scale, (int(width), int(height)), low)


def distant_view(
    image: Pixels,
    mask: Pixels,
    car: PosedCar,
    solid: SolidCar,
    factor: float,
    side: int,
) -> DistantView:
    """The photograph seen again from `factor` times the distance.

    Args:
        image: (H, W, 3) RGB.
        mask: (H, W) 255 on the car.
        car: Camera and pose, in pixels of this image.
        factor: At least 1.
        side: Longest side of the new image, pixels.
    """
    far = dolly_zoom(car, solid.vertices, factor, side)
    body = len(solid.vertices)
    vertices, faces = _with_stubs(solid)
    seen, towards = _seen(far, vertices, faces)
    points = seen.interpolate(vertices, towards)
    depth = _depth(_seen(car, vertices, faces)[0], car.size)
    places, other = car.project(points), car.project(points * MIRROR)
    shown, mirrored = _shown(car, points, places, depth), _shown(car, points * MIRROR, other, depth)
    valid = shown | mirrored
    if not valid.any():
        return DistantView(image, mask, car, 1.0, 1.0, np.zeros(mask.shape, dtype=np.bool_))
    places = np.where((~shown & mirrored)[:, None], other, places)
    at = _sources(seen, places, valid, far.size)
    new = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outline = cv2.remap(mask, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    outline[seen.rows[~shown], seen.columns[~shown]] = 255
    drawn = ~valid & (towards[seen.face, 0] >= body)
    new[seen.rows[drawn], seen.columns[drawn]] = solid.shade * np.median(
        new[seen.rows[valid], seen.columns[valid]], axis=0
    )
    true = np.zeros(outline.shape, dtype=np.bool_)
    true[seen.rows, seen.columns] = valid | drawn
    scale = float(far.matrix[0, 0] / car.matrix[0, 0] / factor)
    made_up = 1.0 - float((valid | drawn).mean())
    return DistantView(np.asarray(new, dtype=np.uint8), np.asarray(outline, dtype=np.uint8), far, scale, made_up, true)


def _with_stubs(solid: SolidCar) -> tuple[Array, NDArray[np.integer]]:
    """The surface, and an ellipsoid around each mirror."""
    corner, triangle = _ball()
    count = len(solid.vertices) + len(corner) * np.arange(len(solid.mirrors))
    stubs = (solid.mirrors[:, None] + _STUB * corner).reshape(-1, 3)
    faces = np.concatenate([solid.faces, *(triangle + first for first in count)])
    return np.concatenate([solid.vertices, stubs]), faces


def _ball(around: int = 12, rings: int = 5) -> tuple[Array, NDArray[np.intp]]:
    """Vertices and outward triangles of a sphere of radius 1: two poles, and rings between."""
    turn = 2.0 * np.pi * np.arange(around) / around
    tilt = (np.pi * np.arange(1, rings + 1) / (rings + 1))[:, None]
    ring = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt) + 0.0 * turn], axis=-1)
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], ring.reshape(-1, 3), [[0.0, 0.0, -1.0]]])
    grid = 1 + around * np.arange(rings)[:, None] + np.arange(around)
    following = np.roll(grid, -1, axis=1)
    last = np.full(around, len(vertices) - 1)
    upper = np.stack([grid[:-1], grid[1:], following[:-1]], axis=-1).reshape(-1, 3)
    lower = np.stack([following[:-1], grid[1:], following[1:]], axis=-1).reshape(-1, 3)
    caps = [np.stack([0 * last, grid[0], following[0]], axis=-1), np.stack([last, following[-1], grid[-1]], axis=-1)]
    return vertices, np.concatenate([upper, lower, *caps])


def _sources(seen: Fragments, places: Array, valid: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.float32]:
    """(H, W, 2) pixel of the photograph that each of the new image shows."""
    row, column = np.mgrid[: size[1], : size[0]].astype(np.float64)
    grid = np.stack([column, row], axis=-1)
    shift, known, covered = np.zeros_like(grid), np.zeros(row.shape, dtype=bool), np.zeros(row.shape, dtype=bool)
    shift[seen.rows, seen.columns] = places - grid[seen.rows, seen.columns]
    known[seen.rows, seen.columns], covered[seen.rows, seen.columns] = valid, True
    # Beyond the surface the photograph moves as its edge does; on it, what nothing shows looks like what is beside it.
    nearest = tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))
    smooth = np.stack([cv2.GaussianBlur(shift[nearest][..., i], (0, 0), _SMOOTH) for i in range(2)], axis=-1)
    taken = grid + np.where(known[..., None], shift, smooth)
    taken = np.where((covered & ~known)[..., None], (grid + shift)[nearest], taken)
    return np.asarray(taken, dtype=np.float32)


def _seen(car: PosedCar, vertices: Array, faces: NDArray[np.integer]) -> tuple[Fragments, NDArray[np.integer]]:
    """What each pixel shows of the surface, and the triangles that this names: those that face the camera."""
    camera = vertices @ car.rotation.T + car.translation
    corner = camera[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    towards = faces[np.einsum("fi,fi->f", normal, corner[:, 0]) < 0.0]  # no other is seen; drawing takes most time
    return rasterise(camera, towards, car.matrix, car.size), towards


def _depth(fragments: Fragments, size: tuple[int, int]) -> Array:
    """(H, W) depth of the surface, the largest of 3 x 3 pixels; 0 where there is none."""
    depth = np.zeros((size[1], size[0]))
    depth[fragments.rows, fragments.columns] = fragments.depth
    return np.asarray(cv2.dilate(depth, np.ones((3, 3), dtype=np.uint8)), dtype=np.float64)


def _shown(car: PosedCar, points: Array, pixels: Array, depth: Array) -> NDArray[np.bool_]:
    """(M,) which of the points (M, 3) at pixels (M, 2) the photograph shows, by the depth of its surface."""
    height, width = depth.shape
    at = np.rint(pixels).astype(int)
    inside = ((at >= 0) & (at < [width, height])).all(axis=1)
    column, row = np.clip(at, 0, [width - 1, height - 1]).T
    behind = points @ car.rotation[2] + car.translation[2] - depth[row, column]
    return inside & (behind <= _BEHIND)
