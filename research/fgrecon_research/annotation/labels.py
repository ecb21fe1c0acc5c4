"""Annotations as labels that files hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import rotation_y
from fgrecon.io.coco_keypoints import LabelledImage, VehicleLabel, VehicleLabels
from fgrecon_research.annotation.annotation import Annotation


def vehicle_labels(
    annotations: Iterable[tuple[str, Annotation]], category: Category, info: Mapping[str, str], terms: str = ""
) -> VehicleLabels:
    """The labels of annotated vehicles.

    Returns:
        The labels; without triangles where the surfaces do not share them.

    Raises:
        InvalidInputError: An image's size is not known.
    """
    made = [(one, _label(drive, one)) for drive, one in annotations]
    faces = made[0][0].faces if made else np.zeros((0, 3), dtype=np.int64)
    alike = all(np.array_equal(faces, one.faces) for one, _ in made)  # hulls of different sizes are not
    return VehicleLabels(
        category=category.name,
        keypoints=category.keypoints,
        skeleton=category.edges,
        vehicles=tuple(label for _, label in made),
        faces=faces.astype(np.int64) if alike else None,
        info=info,
        terms=terms,
    )


def _label(drive: str, one: Annotation) -> VehicleLabel:
    if one.camera.image_size is None:
        raise InvalidInputError("annotation.camera.image_size", None, "Give the camera its image's size.")
    corners = transform(one.camera_T_object, box_corners(one.size))
    ahead = corners[:, 2] > MIN_DEPTH
    pixels = np.full((len(corners), 2), np.nan)
    pixels[ahead] = one.camera.distort(one.camera.project(corners[ahead]))
    return VehicleLabel(
        image=LabelledImage(one.frame.image, one.camera.image_size, one.camera.matrix, drive, one.frame.number),
        track=one.track,
        kind=one.kind,
        box=one.box,
        keypoints=one.keypoints,
        probability=one.visible,
        covariance=one.covariance,
        corners=pixels,
        location=one.camera_T_object[:3, 3],
        rotation_y=rotation_y(one.camera_T_object),
        size=one.size,
        azimuth=one.azimuth,
        agreement=one.agreement,
        silhouette=silhouette(one),
        vertices=one.vertices,
        boxed=one.boxed,
    )


# The part of an image in which a vehicle can be seen, as polygons.


_SIDE = 256  # cells along the longer side of what is drawn
_AROUND = 1.2  # of the box: surfaces stick out of boxes that are not tight
_SMALLEST = 12.0  # cells: smaller pieces are crumbs of what covers the vehicle
_DIGITS = 1.0  # cells by which a polygon may leave the outline


def silhouette(car: Annotation) -> tuple[Array, ...]:
    """Where the vehicle's surface is seen, but for what nearer ones hide and what lies beyond the image.

    Returns:
        Polygons (N, 2) in pixels; none where nothing of it is seen. Holes are filled.
    """
    x1, y1, x2, y2 = car.box
    side = _AROUND * max(x2 - x1, y2 - y1)
    corner = np.array([(x1 + x2 - side) / 2, (y1 + y2 - side) / 2])
    scale = _SIDE / side

    def drawn(vertices: Array, faces: NDArray[np.integer]) -> NDArray[np.uint8]:
        mask = np.zeros((_SIDE, _SIDE), dtype=np.uint8)
        before = faces[(vertices[:, 2] > MIN_DEPTH)[faces].all(axis=1)]
        with np.errstate(divide="ignore", invalid="ignore"):
            homogeneous = vertices @ car.camera.matrix.T
            cells = (homogeneous[:, :2] / homogeneous[:, 2:] - corner) * scale - 0.5
        for triangle in np.clip(np.rint(cells[before] * 16), -1e6, 1e6).astype(np.int32):  # sixteenths of a cell
            cv2.fillConvexPoly(mask, triangle, (255,), shift=4)
        return mask

    mask = drawn(car.vertices, car.faces)
    for solid in car.before:
        mask[drawn(solid.vertices, solid.faces) > 0] = 0
    if car.camera.image_size is not None:
        pixels = corner + (np.arange(_SIDE)[:, None] + 0.5) / scale
        inside = (pixels >= -0.5) & (pixels < np.array(car.camera.image_size) - 0.5)
        mask[~inside[:, 1]] = 0
        mask[:, ~inside[:, 0]] = 0
    outlines: Any = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    large = [o for o in outlines if cv2.contourArea(o) >= _SMALLEST]
    simple = [cv2.approxPolyDP(outline, epsilon=_DIGITS, closed=True)[:, 0] for outline in large]
    return tuple(corner + (polygon + 0.5) / scale for polygon in simple if len(polygon) > 2)
